"""MCAP files made record by record, so that each length, size and checksum in them can be wrong."""

import struct
from pathlib import Path

import yaml
from backports import zstd

MAGIC = b'\x89MCAP0\r\n'
CLOCK_DEFINITION = (
    'builtin_interfaces/Time clock\n' + '=' * 80 + '\nMSG: builtin_interfaces/Time\nint32 sec\nuint32 nanosec\n'
)
CLOCK = ('rosgraph_msgs/msg/Clock', CLOCK_DEFINITION)
SECOND = 10**9


def record(opcode: int, content: bytes) -> bytes:
    return struct.pack('<BQ', opcode, len(content)) + content


def text(value: str | bytes) -> bytes:
    data = value.encode() if isinstance(value, str) else value
    return struct.pack('<I', len(data)) + data


def message(channel: int, stamp_ns: int, data: bytes) -> bytes:
    return record(5, struct.pack('<HIQQ', channel, 0, stamp_ns, stamp_ns) + data)


def clock(stamp_ns: int) -> bytes:
    """A Clock message as CDR."""
    return b'\0\1\0\0' + struct.pack('<iI', *divmod(stamp_ns, SECOND))


def definitions(topic: str = '/clock', schema: tuple[str, str] = CLOCK, qos: str = '') -> bytes:
    found = record(3, struct.pack('<H', 1) + text(schema[0]) + text('ros2msg') + text(schema[1]))
    extra = text('offered_qos_profiles') + text(qos) if qos else b''
    return found + record(4, struct.pack('<HH', 1, 1) + text(topic) + text('cdr') + text(extra))


def chunk(
    plain: bytes,
    times: tuple[int, int],
    *,
    compression: str = 'zstd',
    packed: bytes | None = None,
    size: int = -1,
    crc: int = 0,
) -> bytes:
    """size: what the chunk claims to unpack to, -1 for the truth."""
    data = packed if packed is not None else (zstd.compress(plain) if compression == 'zstd' else plain)
    claimed = size if size >= 0 else len(plain)
    head = struct.pack('<QQQI', *times, claimed, crc) + text(compression)
    return record(6, head + struct.pack('<Q', len(data)) + data)


def message_index(count: int) -> bytes:
    """An index of `count` messages of channel 1, whose times and places nobody reads."""
    return record(7, struct.pack('<H', 1) + text(struct.pack('<QQ', SECOND, 0) * count))


def index_of(chunk_record: bytes, at: int, times: tuple[int, int], messages: bytes) -> bytes:
    """The chunk index record for `chunk_record` at byte `at`, which its message index follows."""
    (size,) = struct.unpack_from('<Q', chunk_record, 9 + 16)
    (length,) = struct.unpack_from('<I', chunk_record, 9 + 28)
    (packed,) = struct.unpack_from('<Q', chunk_record, 9 + 32 + length)
    body = struct.pack('<QQQQ', *times, at, len(chunk_record))
    body += text(struct.pack('<HQ', 1, at + len(chunk_record))) + struct.pack('<Q', len(messages))
    return record(8, body + text(chunk_record[9 + 32 : 9 + 32 + length]) + struct.pack('<QQ', packed, size))


def bag(
    folder: Path,
    chunks: list[tuple[bytes, tuple[int, int]]],
    *,
    topic: str = '/clock',
    schema: tuple[str, str] = CLOCK,
    qos: str = '',
    messages: int = 4,
    at: int = -1,
    files: list[str] | None = None,
    before: str = '',
    changes: dict | None = None,
) -> Path:
    """A bag of one MCAP file with these chunk records and their times; messages: the number that it promises. at: the
    place of the chunks that its index claims. before, changes: text before, and values in, its metadata.yaml."""
    folder.mkdir(parents=True)
    head = MAGIC + record(1, text('ros2') + text('test')) + definitions(topic, schema, qos)
    body, indices = head, b''
    shares = [messages // len(chunks)] * (len(chunks) - 1)
    for (chunk_record, times), share in zip(chunks, [*shares, messages - sum(shares)], strict=True):
        found = message_index(share)
        indices += index_of(chunk_record, len(body) if at < 0 else at, times, found)
        body += chunk_record + found
    body += record(15, struct.pack('<I', 0))
    last = max(times[1] for _, times in chunks)
    totals = struct.pack('<QHIIIIQQ', messages, 1, 1, 0, 0, len(chunks), chunks[0][1][0], last)
    statistics = record(11, totals + text(struct.pack('<HQ', 1, messages)))
    summary = definitions(topic, schema, qos) + indices + statistics
    footer = record(2, struct.pack('<QQI', len(body), 0, 0))
    name = f'{folder.name}.mcap'
    (folder / name).write_bytes(body + summary + footer + MAGIC)
    (folder / 'metadata.yaml').write_text(
        before + yaml.safe_dump(metadata(topic, schema[0], messages, files or [name], changes))
    )
    return folder


def metadata(topic: str, kind: str, messages: int, files: list[str], changes: dict | None) -> dict:
    about = {'name': topic, 'type': kind, 'serialization_format': 'cdr', 'offered_qos_profiles': []}
    body = {
        'version': 9,
        'storage_identifier': 'mcap',
        'relative_file_paths': files,
        'duration': {'nanoseconds': 3 * SECOND},
        'starting_time': {'nanoseconds_since_epoch': SECOND},
        'message_count': messages,
        'topics_with_message_count': [{'topic_metadata': about, 'message_count': messages}],
        'compression_format': '',
        'compression_mode': '',
        'custom_data': {},
    }
    return {'rosbag2_bagfile_information': body | (changes or {})}


def clocks(count: int = 4, channel: int = 1) -> bytes:
    """Message records of a clock, one a second from 1 s on."""
    return b''.join(message(channel, n * SECOND, clock(n * SECOND)) for n in range(1, count + 1))


TIMES = (SECOND, 4 * SECOND)


def good(folder: Path, **changes) -> Path:
    return bag(folder, [(chunk(clocks(), TIMES), TIMES)], **changes)
