"""Bags that lie about sizes, counts and places: one line each, within 10 s of CPU and 1 GiB of memory."""

import os
import socket
import struct
from binascii import crc32
from pathlib import Path

import apsw
import pytest
from backports import zstd
from bounded_process import run_bounded
from mcap_parts import CLOCK, SECOND, TIMES, bag, chunk, clock, clocks, good, message, record

GIB = 2**30
LAUGHS = '\n'.join(f'a{n}: &a{n} [' + ','.join([f'*a{n - 1}' if n else 'lol'] * 9) + ']' for n in range(9)) + '\n'


def zeros(size: int) -> bytes:
    """So many zeros, compressed."""
    machine, block = zstd.ZstdCompressor(level=1), bytes(2**26)
    parts = [machine.compress(block) for _ in range(size // len(block))]
    return b''.join([*parts, machine.flush()])


@pytest.fixture(scope='module')
def bomb() -> bytes:
    return zeros(5 * GIB)


def refused(folder: Path, verb: str, *what: str) -> None:
    """The verb says why it cannot use the bag, in one line that holds all of `what`."""
    out = ['--out', folder.parent / f'out_{verb}'] if verb in ('recover', 'cut') else []
    status, said, errors = run_bounded('bag', verb, folder, *out)
    assert status == 1
    lines = [line for line in (said if verb == 'doctor' else errors) if line.startswith('error: ')]
    assert len(lines) == 1, (said, errors)
    assert all(word in lines[0] for word in what), lines[0]
    assert not (folder.parent / f'out_{verb}').exists()


def test_the_files_of_these_tests_are_bags(tmp_path) -> None:
    status, said, errors = run_bounded('bag', 'info', good(tmp_path / 'good'))
    assert (status, errors) == (0, [])
    assert any('/clock' in line and ' 4 ' in line for line in said)


@pytest.mark.parametrize('verb', ['info', 'doctor', 'recover'])
@pytest.mark.parametrize('claimed', [5 * GIB, 100])
def test_a_chunk_that_unpacks_to_5_gib(tmp_path, bomb, verb, claimed) -> None:
    assert len(bomb) < 2**19
    made = chunk(b'', TIMES, packed=bomb, size=claimed)
    refused(bag(tmp_path / 'bomb', [(made, TIMES)]), verb, 'bomb')


def large(stamp_ns: int) -> tuple[bytes, tuple[int, int]]:
    """A chunk of one large message, and its times."""
    times = (stamp_ns, stamp_ns)
    return chunk(message(1, stamp_ns, bytes(2**26 - 100)), times), times


def test_many_chunks_that_unpack_to_much_together(tmp_path) -> None:
    made, _ = large(1)
    chunks = [large(n) if n < 20 else (made, (n, n)) for n in range(1, 100)]
    refused(bag(tmp_path / 'many', chunks, messages=99), 'info', 'implausibly many bytes')


def test_chunks_that_have_to_be_open_together(tmp_path) -> None:
    made = [(large(n)[0], (1, 7)) for n in range(1, 8)]
    refused(bag(tmp_path / 'together', made, messages=7), 'info', 'overlap in time')


def test_one_chunk_of_millions_of_messages(tmp_path) -> None:
    plain = message(1, SECOND, b'') * 2_000_000
    refused(bag(tmp_path / 'tiny', [(chunk(plain, TIMES), TIMES)], messages=2_000_000), 'info', 'messages')


@pytest.mark.parametrize('verb', ['info', 'doctor', 'recover'])
@pytest.mark.parametrize('claimed', [2**60, 2**31])
def test_a_chunk_that_claims_to_be_huge(tmp_path, verb, claimed) -> None:
    made = chunk(clocks(), TIMES, size=claimed)
    refused(bag(tmp_path / 'huge', [(made, TIMES)]), verb, 'huge')


def test_an_index_that_names_no_chunk(tmp_path) -> None:
    made = [(chunk(clocks(), TIMES), TIMES)]
    refused(bag(tmp_path / 'outside', made, at=2**40), 'info', 'outside')
    refused(bag(tmp_path / 'inside', made, at=3), 'info', 'no')


def test_a_wrong_checksum(tmp_path) -> None:
    refused(bag(tmp_path / 'sum', [(chunk(clocks(), TIMES, crc=12345), TIMES)]), 'info', 'checksum')
    made = chunk(clocks(), TIMES, crc=crc32(clocks()))
    assert run_bounded('bag', 'info', bag(tmp_path / 'right', [(made, TIMES)]))[0] == 0


@pytest.mark.parametrize('promised', [3, 5])
def test_a_bag_that_holds_another_number_of_messages_than_it_promises(tmp_path, promised) -> None:
    what = 'more messages' if promised == 3 else '1 messages are missing'
    refused(good(tmp_path / 'promise', messages=promised), 'info', what)


def test_a_message_outside_the_times_of_its_chunk_is_not_left_out_in_silence(tmp_path) -> None:
    refused(bag(tmp_path / 'late', [(chunk(clocks(), TIMES), (SECOND, 2 * SECOND))]), 'info', 'outside the times')


@pytest.mark.parametrize(
    ('schema', 'why'),
    [
        (('a/msg/B', 'a/B x\n' + '=' * 80 + '\nMSG: a/B\na/B y\n'), 'holds itself'),
        (('a/msg/B', 'a/C x\n'), 'cannot be used'),
        (('a/msg/B', 'uint8 x\n' * 20_000), 'a definition of'),
        (('a/msg/B', ''), 'does not define it'),
    ],
)
@pytest.mark.parametrize('verb', ['recover', 'cut'])
def test_a_type_that_cannot_be_built(tmp_path, verb, schema, why) -> None:
    plain = clocks()
    folder = bag(tmp_path / 'type', [(chunk(plain, TIMES), TIMES)], schema=schema, topic='/x')
    refused(folder, verb, 'left out /x', why)


def test_a_type_whose_code_would_be_endless_is_copied_without_decoding(tmp_path) -> None:
    schema = ('a/msg/B', 'a/C[2000000000] x\n' + '=' * 80 + '\nMSG: a/C\nint32 X=1\n')
    folder = bag(tmp_path / 'long', [(chunk(clocks(), TIMES), TIMES)], schema=schema, topic='/x')
    status, said, errors = run_bounded('bag', 'recover', folder, '--out', tmp_path / 'saved')
    assert status == 0
    assert errors == ['4 messages of unknown types were copied without decoding: /x']
    assert said == [f'{tmp_path / "saved"}: 4 messages of 1 topics, read again']


def test_an_array_that_claims_two_thousand_million_elements(tmp_path) -> None:
    lying = b'\0\1\0\0' + b'\xff' * 8 + b'\xff\xff\xff\x7f'
    made = chunk(message(1, SECOND, lying), TIMES)
    folder = bag(
        tmp_path / 'array',
        [(made, TIMES)],
        topic='/diagnostics',
        schema=('diagnostic_msgs/msg/DiagnosticArray', ''),
        messages=1,
    )
    refused(folder, 'events', 'not a diagnostic_msgs')
    refused(folder, 'recover', 'cannot be decoded')


def test_a_message_that_would_be_a_million_objects(tmp_path) -> None:
    count = 400_000
    data = b'\0\1\0\0' + bytes(8) + struct.pack('<II', 0, count) + bytes(40 * count)
    made = chunk(message(1, SECOND, data), TIMES)
    schema = ('diagnostic_msgs/msg/DiagnosticArray', '')
    folder = bag(tmp_path / 'objects', [(made, TIMES)], topic='/diagnostics', schema=schema, messages=1)
    refused(folder, 'events', 'no more than')


@pytest.mark.parametrize('verb', ['info', 'doctor'])
def test_a_metadata_file_of_a_thousand_million_laughs(tmp_path, verb) -> None:
    folder = good(tmp_path / 'laughs', before=LAUGHS)
    file = folder / 'metadata.yaml'
    file.write_text(file.read_text().replace('custom_data: {}', 'custom_data: {x: *a8}'))
    refused(folder, verb, 'aliases')


@pytest.mark.parametrize(
    ('before', 'why'),
    [('x: ' + '[' * 100_000 + '\n', 'laughs'), ('x: &a [*a]\n', 'holds itself'), ('#' * 2**21 + '\n', 'bytes')],
)
def test_a_metadata_file_that_is_nested_holds_itself_or_is_huge(tmp_path, before, why) -> None:
    refused(good(tmp_path / 'laughs', before=before), 'info', why)


def test_laughs_in_the_quality_of_a_topic(tmp_path) -> None:
    refused(good(tmp_path / 'qos', qos=LAUGHS + 'x: *a8'), 'info', 'aliases')


@pytest.mark.parametrize('names', [['/etc/passwd'], ['../good/good.mcap'], ['..'], [''], ['x.mcap'] * 2])
def test_files_elsewhere_are_not_read(tmp_path, names) -> None:
    good(tmp_path / 'good')
    refused(good(tmp_path / 'elsewhere', files=names), 'info', 'elsewhere')


def in_place_of(path: Path, kind: str) -> None:
    path.unlink()
    match kind:
        case 'fifo':
            os.mkfifo(path)
        case 'device':
            path.symlink_to('/dev/zero')
        case 'socket':
            where = Path.cwd()
            os.chdir(path.parent)
            socket.socket(socket.AF_UNIX).bind(path.name)
            os.chdir(where)
        case 'folder':
            path.mkdir()


@pytest.mark.parametrize('kind', ['fifo', 'device', 'socket', 'folder'])
@pytest.mark.parametrize('name', ['metadata.yaml', 'special.mcap'])
def test_what_is_no_regular_file_is_not_opened(tmp_path, kind, name) -> None:
    folder = good(tmp_path / 'special')
    in_place_of(folder / name, kind)
    refused(folder, 'info', 'special')
    if name == 'special.mcap':
        refused(folder, 'recover', 'special')


def test_a_file_that_is_five_gib_of_nothing(tmp_path) -> None:
    folder = good(tmp_path / 'sparse')
    file = folder / 'sparse.mcap'
    head = file.read_bytes()[:8]
    with file.open('wb') as stream:
        stream.write(head + struct.pack('<BQ', 1, 4 * GIB))
        stream.truncate(5 * GIB)
    refused(folder, 'info', 'sparse')


def test_a_search_for_records_in_noise_ends(tmp_path) -> None:
    folder = good(tmp_path / 'noise')
    file = folder / 'noise.mcap'
    data = file.read_bytes()
    # Looks like the beginning of a message, nine bytes each.
    file.write_bytes(data[:60] + (b'\x05' + struct.pack('<Q', 60)) * 4_000_000 + data[60:])
    refused(folder, 'recover', 'not a single message')


def test_a_nested_chunk_is_not_unpacked(tmp_path) -> None:
    plain = clocks(1)
    for _ in range(50):
        plain = chunk(plain, TIMES)
    refused(bag(tmp_path / 'nested', [(chunk(plain, TIMES), TIMES)]), 'recover', 'not a single message')


@pytest.mark.parametrize('mode', ['message', 'file'])
def test_messages_and_files_that_unpack_to_5_gib(tmp_path, bomb, mode) -> None:
    plain = b''.join(message(1, n * SECOND, bomb) for n in range(1, 5))
    changes = {'compression_mode': mode, 'compression_format': 'zstd'}
    folder = bag(tmp_path / 'packed', [(chunk(plain, TIMES), TIMES)], changes=changes)
    if mode == 'file':
        file = folder / 'packed.mcap'
        file.unlink()
        (folder / 'packed.mcap.zstd').write_bytes(bomb)
        meta = folder / 'metadata.yaml'
        meta.write_text(meta.read_text().replace('packed.mcap', 'packed.mcap.zstd'))
    refused(folder, 'info', 'packed')
    refused(folder, 'recover', 'packed')


@pytest.mark.parametrize(
    ('change', 'why'),
    [
        (
            'ALTER TABLE schema RENAME TO s2; CREATE VIEW schema AS '
            'WITH RECURSIVE n(i) AS (SELECT 1 UNION ALL SELECT i FROM n) '
            'SELECT count(*) AS schema_version FROM n',
            'views',
        ),
        (
            'CREATE TABLE t2 AS SELECT * FROM topics; DROP TABLE topics; ALTER TABLE t2 RENAME TO topics; '
            'INSERT INTO topics SELECT t.* FROM topics t, messages, messages, messages',
            'topics',
        ),
        ('UPDATE messages SET data = zeroblob(200000000)', 'damaged'),
        ("UPDATE messages SET data = 'text'", 'damaged'),
        ('UPDATE messages SET timestamp = 1.5', 'damaged'),
    ],
)
def test_databases_that_no_recorder_wrote(tmp_path, change, why) -> None:
    folder = database(tmp_path / 'base')
    connection = apsw.Connection(str(folder / 'base.db3'))
    connection.execute(change)
    connection.close()
    refused(folder, 'info', why)


def database(folder: Path) -> Path:
    from rosbags.rosbag2 import StoragePlugin, Writer
    from rosbags.typesys import Stores, get_typestore

    with Writer(folder, version=9, storage_plugin=StoragePlugin.SQLITE3) as writer:
        topic = writer.add_connection('/clock', CLOCK[0], typestore=get_typestore(Stores.ROS2_JAZZY))
        for n in range(1, 21):
            writer.write(topic, n * SECOND, clock(n * SECOND))
    return folder


def test_names_and_texts_from_a_bag_cannot_reach_the_terminal(tmp_path) -> None:
    evil = '/<b>\x1b[2J\x07[red]\u202e\n'
    changes = {'custom_data': {'note\x1b[31m': 'a\x1b]0;title\x07'}}
    folder = good(tmp_path / 'evil', topic=evil, changes=changes)
    for verb, out in (('info', []), ('doctor', []), ('recover', ['--out', tmp_path / 'new']), ('events', [])):
        _, said, errors = run_bounded('bag', verb, folder, *out)
        for line in (*said, *errors):
            assert line.isprintable(), (verb, line)
    assert any('\\x1b[2J\\x07[red]\\u202e\\n' in line for line in run_bounded('bag', 'info', folder)[1])
    status, _, errors = run_bounded('bag', 'cut', folder, '--topics', '/no\x1b[2J', '--out', tmp_path / 'cut')
    assert status == 1
    assert len(errors) == 1
    assert '\\x1b[2J' in errors[0]


def test_a_private_record_is_skipped(tmp_path) -> None:
    plain = clocks(2) + record(0x99, b'private') + clocks(4)[len(clocks(2)) :]
    folder = bag(tmp_path / 'private', [(chunk(plain, TIMES), TIMES)])
    said = run_bounded('bag', 'recover', folder, '--out', tmp_path / 'new')[1]
    assert said == [f'{tmp_path / "new"}: 4 messages of 1 topics, read again']
