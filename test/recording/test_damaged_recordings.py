"""What recover saves of damaged recordings, and what it says is lost; and that cut and merge keep account."""

import random
import struct
from collections import Counter
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from mcap.reader import make_reader
from mcap.writer import CompressionType, Writer
from mcap_parts import SECOND, TIMES, bag, chunk, clock, clocks, message
from recording_helpers import messages_of, raw_message

from msg_adapters.factory import RosbagsFactory
from msg_adapters.sensors import odometry_to_message
from raw2drive_ros.cli.main import main
from raw2drive_ros.contracts import topics
from raw2drive_ros.contracts.errors import BagError
from raw2drive_ros.contracts.public import OdometrySample
from raw2drive_ros.recording.bag_edit import cut, merge
from raw2drive_ros.recording.bag_reader import open_bag, search_bags
from raw2drive_ros.recording.bag_writer import BagWriter
from raw2drive_ros.recording.copying import Account, Copier, verify
from raw2drive_ros.recording.losses import Losses
from raw2drive_ros.recording.recover import recover

FACTORY = RosbagsFactory()
PERIOD_NS = 50_000_000
# Where the packed bytes of a chunk begin in its record.
PACKED = 53


def odometry(n: int) -> tuple[str, int, bytes]:
    stamp_ns = SECOND + n * PERIOD_NS
    message = odometry_to_message(FACTORY, OdometrySample(stamp_ns, float(n), 0.0, 0.0, 0.0, 0.0))
    return topics.ODOMETRY, stamp_ns, FACTORY.serialize(message, 'nav_msgs/msg/Odometry')


def drive(folder: Path, seconds: int = 10) -> Path:
    """A bag of odometry at 20 Hz and a route once a second, a chunk per second."""
    _, _, route = raw_message(topics.ROUTE, SECOND)
    with BagWriter(folder, {'note': 'whole'}) as writer:
        for n in range(seconds * 20):
            writer.write_raw(*odometry(n))
            if n % 20 == 0:
                writer.write_raw(topics.ROUTE, SECOND + n * PERIOD_NS, route)
            if n % 20 == 19:
                writer.flush()
    return folder


def chunks_of(file: Path):
    with file.open('rb') as stream:
        return make_reader(stream).get_summary().chunk_indexes


def hurt(bag_folder: Path, at: int, what: bytes) -> Path:
    file = next(bag_folder.glob('*.mcap'))
    data = bytearray(file.read_bytes())
    data[at : at + len(what)] = what
    file.write_bytes(data)
    return bag_folder


@pytest.mark.parametrize('length', [2**40, 7, 2**63])
def test_behind_a_broken_record_boundary_reading_goes_on(tmp_path, length) -> None:
    """The length of the fourth chunk's record is wrong: nothing behind it is where it should be."""
    folder = drive(tmp_path / 'bag')
    broken = chunks_of(next(folder.glob('*.mcap')))[3]
    hurt(folder, broken.chunk_start_offset + 1, struct.pack('<Q', length))
    found = recover(folder, tmp_path / 'saved')
    assert found.counts == {topics.ODOMETRY: 180, topics.ROUTE: 9}
    assert (found.damaged, found.breaks, found.truncated) == (0, 1, False)
    assert found.lost_s[topics.ODOMETRY] == pytest.approx(1.0, abs=0.01)
    assert found.lost_messages == {topics.ODOMETRY: 20, topics.ROUTE: 1}
    original = Counter(messages_of(drive(tmp_path / 'again')))
    assert Counter(messages_of(tmp_path / 'saved')) <= original


def test_the_command_says_what_is_lost_of_each_topic(tmp_path, capsys) -> None:
    folder = drive(tmp_path / 'bag')
    for broken in chunks_of(next(folder.glob('*.mcap')))[3:5]:
        hurt(folder, broken.chunk_start_offset + PACKED, bytes(16))
    assert main(['bag', 'recover', str(folder), '--out', str(tmp_path / 'saved')]) == 0
    said = capsys.readouterr()
    assert said.out == f'{tmp_path / "saved"}: 168 messages of 2 topics, read again\n'
    assert said.err.splitlines() == [
        '2 damaged chunks left out',
        f'lost of {topics.ROUTE}: 2.00 s, 2 messages',
        f'lost of {topics.ODOMETRY}: 2.00 s, 40 messages',
    ]


def test_the_chunk_that_introduces_the_topics_may_be_lost(tmp_path) -> None:
    """Later chunks do not repeat schemas and channels; the summary at the end does."""
    folder = drive(tmp_path / 'bag')
    first = chunks_of(next(folder.glob('*.mcap')))[0]
    hurt(folder, first.chunk_start_offset + PACKED, bytes(16))
    assert recover(folder, tmp_path / 'saved').counts == {topics.ODOMETRY: 180, topics.ROUTE: 9}


def test_messages_whose_definition_is_lost_are_counted(tmp_path) -> None:
    folder = drive(tmp_path / 'bag')
    file = next(folder.glob('*.mcap'))
    chunks = chunks_of(file)
    hurt(folder, chunks[0].chunk_start_offset + PACKED, bytes(16))
    file.write_bytes(file.read_bytes()[: chunks[-1].chunk_start_offset])
    with pytest.raises(BagError, match='left out 168 messages of unknown topics'):
        recover(folder, tmp_path / 'saved')
    assert not (tmp_path / 'saved').exists()


@pytest.mark.parametrize('chunked', [True, False])
def test_a_broken_message_record_loses_that_message(tmp_path, chunked) -> None:
    """Files without compression, in which each record can be found again."""
    file = tmp_path / 'open.mcap'
    writer = Writer(str(file), compression=CompressionType.NONE, use_chunking=chunked, enable_crcs=False)
    writer.start(profile='ros2')
    definition, _ = FACTORY.typestore.generate_msgdef('nav_msgs/msg/Odometry', ros_version=2)
    schema = writer.register_schema('nav_msgs/msg/Odometry', 'ros2msg', definition.encode())
    channel = writer.register_channel(topics.ODOMETRY, 'cdr', schema)
    rows = [odometry(n) for n in range(50)]
    for _, stamp_ns, data in rows:
        writer.add_message(channel, stamp_ns, data, stamp_ns)
    writer.finish()
    content = file.read_bytes()
    at = content.index(rows[20][2]) - 22 - 8
    file.write_bytes(content[:at] + struct.pack('<Q', 2**50) + content[at + 8 :])
    found = recover(file, tmp_path / 'saved')
    assert found.counts == {topics.ODOMETRY: 49}
    assert found.breaks == 1
    assert found.lost_s[topics.ODOMETRY] == pytest.approx(0.05, abs=0.001)
    kept = {(t, ns, data) for t, ns, data in rows} - {rows[20]}
    assert set(messages_of(tmp_path / 'saved')) == kept


@settings(deadline=None, max_examples=25, suppress_health_check=list(HealthCheck))
@given(st.integers(0, 9), st.floats(0.0, 0.999), st.binary(min_size=1, max_size=12))
def test_damage_in_one_chunk_costs_no_other_chunk(tmp_path_factory, number, where, what) -> None:
    tmp_path = tmp_path_factory.mktemp('hurt')
    folder = drive(tmp_path / 'bag')
    original = Counter(messages_of(folder))
    broken = chunks_of(next(folder.glob('*.mcap')))[number]
    hurt(folder, broken.chunk_start_offset + int(where * (broken.chunk_length - len(what))), what)
    found = recover(folder, tmp_path / 'saved')
    saved = Counter(messages_of(tmp_path / 'saved'))
    inside = Counter(
        {row: n for row, n in original.items() if broken.message_start_time <= row[1] <= broken.message_end_time}
    )
    assert original - inside <= saved
    lost = (original - saved).total()
    # Where the damage hits the packed bytes, a chunk without a checksum may unpack to other values.
    named = found.damaged or found.breaks or found.strange or found.account.refused
    assert lost == 0 or named or (saved - original).total() == lost


def test_messages_that_were_compressed_one_by_one_are_unpacked(tmp_path) -> None:
    from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin
    from rosbags.rosbag2 import Writer as RosbagsWriter

    writer = RosbagsWriter(tmp_path / 'bag', version=9, storage_plugin=StoragePlugin.MCAP)
    writer.set_compression(CompressionMode.MESSAGE, CompressionFormat.ZSTD)
    rows = [odometry(n) for n in range(40)]
    with writer:
        connection = writer.add_connection(topics.ODOMETRY, 'nav_msgs/msg/Odometry', typestore=FACTORY.typestore)
        for _, stamp_ns, data in rows:
            writer.write(connection, stamp_ns, data)
    # Without metadata.yaml, as a killed recorder leaves it.
    found = recover(next((tmp_path / 'bag').glob('*.mcap')), tmp_path / 'saved')
    assert found.counts == {topics.ODOMETRY: 40}
    assert messages_of(tmp_path / 'saved') == rows


def test_messages_that_cannot_be_decoded_are_left_out_and_counted(tmp_path, capsys) -> None:
    plain = clocks() + message(1, 4 * SECOND, b'\0\1\0\0\1') + message(1, 4 * SECOND, b'')
    folder = bag(tmp_path / 'bag', [(chunk(plain, TIMES), TIMES)], messages=6)
    account = Account()
    assert cut(folder, tmp_path / 'part', account=account) == {'/clock': 4}
    assert account.refused['/clock'].total() == 2
    assert merge([folder], tmp_path / 'merged').account.refused['/clock'].total() == 2
    for verb in ('recover', 'cut', 'merge'):
        assert main(['bag', verb, str(folder), '--out', str(tmp_path / verb)]) == 0
        said = capsys.readouterr()
        assert 'left out 2 messages of /clock: cannot be decoded as rosgraph_msgs/msg/Clock' in said.err
        assert said.out.endswith('4 messages of 1 topics, read again\n')


def test_a_topic_of_two_types_keeps_the_first(tmp_path) -> None:
    """Written into one connection, messages of the second type would be read as the first."""
    with BagWriter(tmp_path / 'new', {}) as writer:
        copier = Copier(writer, Account())
        with open_bag(bag(tmp_path / 'clock', [(chunk(clocks(), TIMES), TIMES)])) as reader:
            definition = reader.connections[0].msgdef
        assert copier.write('/x', SECOND, clock(SECOND), 'rosgraph_msgs/msg/Clock', definition)
        assert not copier.write('/x', SECOND, clock(SECOND), 'std_msgs/msg/Empty', definition)
        assert not copier.write('/x', -1, clock(SECOND), 'rosgraph_msgs/msg/Clock', definition)
    assert copier.account.refused['/x'].total() == 2
    verify(tmp_path / 'new', copier)


def test_what_was_written_is_compared_with_what_can_be_read(tmp_path) -> None:
    with BagWriter(tmp_path / 'new', {}) as writer:
        copier = Copier(writer, Account())
        with open_bag(bag(tmp_path / 'clock', [(chunk(clocks(), TIMES), TIMES)])) as reader:
            definition = reader.connections[0].msgdef
        copier.write('/x', SECOND, clock(SECOND), 'rosgraph_msgs/msg/Clock', definition)
        # As a full disk or a faulty writer would: what is on the disk is not what was handed over.
        writer.write_raw('/x', 2 * SECOND, clock(SECOND))
        copier.account.counts['/x'] += 1
    with pytest.raises(BagError, match='reading it again'):
        verify(tmp_path / 'new', copier)


def test_a_search_for_bags_says_what_it_leaves_out(tmp_path) -> None:
    for name in ('a', 'b', 'elsewhere/c'):
        drive(tmp_path / name, 1)
    (tmp_path / 'day').mkdir()
    (tmp_path / 'a').rename(tmp_path / 'day' / 'a')
    (tmp_path / 'day' / 'link').symlink_to(tmp_path / 'elsewhere')
    killed = BagWriter(tmp_path / 'day' / 'killed', {})
    killed.write_raw(*odometry(0))
    killed.flush()
    (tmp_path / 'other').symlink_to(tmp_path / 'day')
    search = search_bags([tmp_path / 'day', tmp_path / 'other'])
    assert search.bags == [tmp_path / 'day' / 'a']
    said = search.left_out()
    assert [line.split(':')[0] for line in said] == [
        '2 linked folders are not followed; name them to use their bags',
        '2 unfinished recordings left out; `raw2drive bag recover` makes bags of them',
        '1 bags were named twice, and are used once',
    ]
    assert search_bags([tmp_path / 'day' / 'link']).bags == [tmp_path / 'day' / 'link' / 'c']
    alone = BagWriter(tmp_path / 'alone' / 'killed', {})
    alone.write_raw(*odometry(0))
    alone.flush()
    with pytest.raises(BagError, match=r'no bags found under .*1 unfinished recordings'):
        search_bags([tmp_path / 'alone'])


def test_seconds_that_are_lost_are_those_across_damaged_places() -> None:
    losses, rng = Losses(), random.Random(1)
    for n in range(100):
        if n in (30, 60):
            losses.damaged()
        if not 60 <= n < 70:
            losses.message('/fast', n * PERIOD_NS + rng.randrange(1_000_000))
        if n % 50 == 0:
            losses.message('/rare', n * PERIOD_NS)
    losses.damaged(end_ns=99 * PERIOD_NS + 2 * SECOND)
    assert losses.seconds() == {'/fast': pytest.approx(0.5 + 1.95, abs=0.02)}
