"""rosbags' MCAP storage with bounds: no read, chunk or index of a file takes more memory or time than its size allows.

The index is held to what it promises: a message outside its chunk's times, or more or fewer messages than promised, is
an error and not an omission.
"""

from __future__ import annotations

import heapq
from collections import Counter
from collections.abc import Collection, Iterator, Sequence
from contextlib import suppress
from functools import lru_cache
from io import BytesIO
from itertools import pairwise
from operator import itemgetter
from struct import Struct, iter_unpack
from typing import Any

from mcap.data_stream import ReadDataStream
from mcap.records import Channel, Schema
from rosbags.interfaces import Connection, ConnectionExtRosbag2, MessageDefinition, MessageDefinitionFormat, Qos
from rosbags.rosbag2.metadata import parse_qos
from rosbags.rosbag2.storage_mcap import ChunkInfo, McapReader, Statistics

from raw2drive_ros.bounds import (
    MAX_CHUNK_BYTES,
    MAX_INDEX_BYTES,
    MAX_MESSAGE_BYTES,
    MAX_OPEN_BYTES,
    MAX_TOPICS,
    MAX_YAML_BYTES,
    Allowance,
    BoundedFile,
    TooLargeError,
    yaml_from,
)
from raw2drive_ros.recording.unpack import (
    CHANNEL,
    CHUNK,
    CHUNK_INDEX,
    FOOTER_BYTES,
    MESSAGE,
    MESSAGE_HEAD,
    RECORD,
    SCHEMA,
    STATISTICS,
    chunk_head,
    records_of,
    unpacked_chunk,
)

QOS_KEY = 'offered_qos_profiles'
FORMATS = {
    'ros2msg': MessageDefinitionFormat.MSG,
    'ros2idl': MessageDefinitionFormat.IDL,
    'omgidl': MessageDefinitionFormat.IDL,
}
UNTYPED = MessageDefinition(MessageDefinitionFormat.NONE, '')
_TIMES = Struct('<QQQQI')
_SIZES = Struct('<QQ')
_COUNTS = Struct('<QHIIIIQQI')
Item = tuple[Connection, int, bytes]


@lru_cache(maxsize=256)
def _qos_of_text(text: str) -> tuple[Qos, ...]:
    return tuple(parse_qos(yaml_from(text) or []))


def qos_from(stored: Any) -> list[Qos]:
    """QoS profiles from a YAML text or a list of mappings. Raises what PyYAML and rosbags raise for damaged ones."""
    return list(_qos_of_text(stored)) if isinstance(stored, str) else parse_qos(stored or [])


class BoundedMcap(McapReader):
    """path: the MCAP file. packed_bytes: size of the compressed file that it was unpacked from, if any.

    by_publish_time: whether messages are ordered and timed by `publish_time`, see `stamped_mcap`.
    """

    bio: Any
    by_publish_time = False

    def __init__(self, path: Any, packed_bytes: int = 0) -> None:
        super().__init__(path)
        self.packed_bytes = packed_bytes
        self.definitions: dict[int, tuple[str, MessageDefinition]] = {}
        self.qos_bytes = 0

    def open(self) -> None:
        """Raises OSError, ValueError, or what rosbags raises, for a file that is damaged or exceeds a limit."""
        self.bio = BoundedFile(self.path, MAX_CHUNK_BYTES + MAX_MESSAGE_BYTES)
        self.packed_bytes = self.packed_bytes or self.bio.size
        try:
            self._open()
            self._check_index()
        except BaseException:
            with suppress(Exception):
                self.close()
            raise

    # -- index ------------------------------------------------------------------------------------

    def read_index(self) -> None:
        """Read the summary section."""
        length = self.bio.size - FOOTER_BYTES - self.data_end
        if length > MAX_INDEX_BYTES:
            raise TooLargeError(f'an index of {length} bytes, and no more than {MAX_INDEX_BYTES} are read')
        self.bio.seek(self.data_end)
        summary = self._exact(length)
        for opcode, begin, end in records_of(summary):
            content = summary[begin:end]
            if opcode in (SCHEMA, CHANNEL):
                self._add(opcode, content)
            elif opcode == CHUNK_INDEX:
                self.chunks.append(_chunk_info(content))
            elif opcode == STATISTICS:
                self.statistics = _statistics(content)

    def _check_index(self) -> None:
        """An index that contradicts itself, or is not there, is made anew from the data."""
        if not self._is_consistent():
            self.connections.clear()
            self.meta_scan()
        if len(self.connections) > MAX_TOPICS:
            raise TooLargeError(f'{len(self.connections)} topics, and no more than {MAX_TOPICS} are read')
        assert self.statistics is not None
        known = self.statistics
        counts = known.channel_message_counts
        self.connections = [each._replace(msgcount=counts.get(each.id, 0)) for each in self.connections]
        total = known.message_count
        first_ns, end_ns = (known.start_time, known.end_time + 1) if total else (2**63 - 1, 0)
        self.metadata = self.metadata._replace(
            duration=end_ns - first_ns if total else 0, start_time=first_ns, end_time=end_ns, message_count=total
        )

    def _is_consistent(self) -> bool:
        known = self.statistics
        if known is None or known.chunk_count != len(self.chunks) or known.channel_count > len(self.connections):
            return False
        indexed: Counter[int] = Counter()
        for chunk in self.chunks:
            indexed.update(chunk.channel_count)
        counts = known.channel_message_counts
        return sum(counts.values()) == known.message_count and (
            not self.chunks or all(indexed[channel] == count for channel, count in counts.items())
        )

    def _add(self, opcode: int, content: bytes) -> None:
        stream = ReadDataStream(BytesIO(content))
        if opcode == SCHEMA:
            schema = Schema.read(stream)
            form = FORMATS.get(schema.encoding)
            definition = MessageDefinition(form, schema.data.decode()) if form else UNTYPED
            self.definitions[schema.id] = schema.name, definition
            # rosbags asks whether there are any.
            self.schemas[schema.id] = schema  # type: ignore[assignment]
            return
        channel = Channel.read(stream)
        if any(each.id == channel.id for each in self.connections):
            return
        text = channel.metadata.get(QOS_KEY, '')
        self.qos_bytes += len(text)
        if self.qos_bytes > MAX_YAML_BYTES:
            raise TooLargeError(f'more than {MAX_YAML_BYTES} bytes of QoS profiles')
        name, definition = self.definitions.get(channel.schema_id, ('__schemaless__', UNTYPED))
        extra = ConnectionExtRosbag2(channel.message_encoding, qos_from(text))
        self.connections.append(Connection(channel.id, channel.topic, name, definition, '', 0, extra, self))

    def meta_scan(self) -> None:
        """Find and count what a file holds that has no index, and make one."""
        allowance = Allowance(self.packed_bytes)
        self.chunks.clear()
        counts: Counter[int] = Counter()
        span = (2**63 - 1, 0)
        for at, opcode, size in self._heads():
            if opcode == CHUNK:
                chunk = self._scanned(at, size, allowance)
                if chunk.channel_count:
                    self.chunks.append(chunk)
                    counts.update(chunk.channel_count)
                    span = min(span[0], chunk.message_start_time), max(span[1], chunk.message_end_time)
            elif opcode == MESSAGE:
                channel, _, stamp_ns, _ = MESSAGE_HEAD.unpack(self._exact(MESSAGE_HEAD.size))
                counts[channel] += 1
                span = min(span[0], stamp_ns), max(span[1], stamp_ns)
            elif opcode in (SCHEMA, CHANNEL):
                self._add(opcode, self._exact(size))
        self.statistics = Statistics(
            counts.total(), len(self.schemas), len(self.connections), 0, 0, len(self.chunks), *span, dict(counts)
        )

    def _scanned(self, at: int, size: int, allowance: Allowance) -> ChunkInfo:
        content = self._exact(size)
        head = chunk_head(content)
        allowance.spend(head.unpacked_bytes)
        plain = unpacked_chunk(content, head)
        counts: Counter[int] = Counter()
        first_ns, last_ns = 2**63 - 1, 0
        number = 0
        for opcode, begin, end in records_of(plain):
            number += 1
            if opcode == MESSAGE:
                channel, _, stamp_ns, _ = MESSAGE_HEAD.unpack_from(plain, begin)
                counts[channel] += 1
                first_ns, last_ns = min(first_ns, stamp_ns), max(last_ns, stamp_ns)
            elif opcode in (SCHEMA, CHANNEL):
                self._add(opcode, plain[begin:end])
        allowance.spend(0, number)
        length, packed = RECORD.size + size, len(content) - head.data_at
        return ChunkInfo(
            first_ns, last_ns, at, length, {}, 0, head.compression, packed, head.unpacked_bytes, dict(counts)
        )

    # -- messages ---------------------------------------------------------------------------------

    def messages(
        self, connections: Collection[Connection], start: int | None = None, stop: int | None = None
    ) -> Iterator[Item]:
        """Messages in order of time, as rosbags yields them. Raises ValueError where more or fewer come than promised,
        or where they take more memory than allowed."""
        assert self.statistics is not None
        wanted = {connection.id: connection for connection in connections}
        left = Counter({channel: self.statistics.channel_message_counts.get(channel, 0) for channel in wanted})
        allowance = Allowance(self.packed_bytes)
        chosen = [
            chunk
            for chunk in self.chunks
            if (start is None or start <= chunk.message_end_time)
            and (stop is None or chunk.message_start_time < stop)
            and (not chunk.channel_count or any(chunk.channel_count.get(channel, 0) for channel in wanted))
        ]
        _require_room(chosen)
        limits = (-1 if start is None else start, 2**64 if stop is None else stop)
        if self.chunks:
            found = heapq.merge(*(self._of_chunk(chunk, wanted, limits, allowance) for chunk in chosen))
        else:
            found = self._loose(wanted, limits)
        for stamp_ns, offset, _, channel, data in found:
            if not offset:
                continue
            left[channel] -= 1
            if left[channel] < 0:
                raise ValueError(f'holds more messages of {wanted[channel].topic} than it promises')
            yield wanted[channel], stamp_ns, data
        if start is None and stop is None and (missing := left.total()):
            raise ValueError(f'{missing} messages are missing that it promises')

    def _of_chunk(
        self, chunk: ChunkInfo, wanted: Collection[int], limits: tuple[int, int], allowance: Allowance
    ) -> Iterator[tuple[int, int, int, int, bytes]]:
        """(stamp, offset of the chunk, number, channel, data) in order of time, after one item without a message, so
        that a chunk is unpacked when its time has come."""
        yield chunk.message_start_time, 0, 0, 0, b''
        at = chunk.chunk_start_offset
        plain = self.unpacked(chunk, allowance)
        found: list[tuple[int, int, int, int]] = []
        count = 0
        for opcode, begin, end in records_of(plain):
            count += 1
            if opcode != MESSAGE:
                continue
            channel, _, log_ns, publish_ns = MESSAGE_HEAD.unpack_from(plain, begin)
            stamp_ns = publish_ns if self.by_publish_time else log_ns
            if not chunk.message_start_time <= stamp_ns <= chunk.message_end_time:
                raise ValueError(f'a message in the chunk at byte {at} lies outside the times of its index')
            if channel in wanted and limits[0] <= stamp_ns < limits[1]:
                found.append((stamp_ns, begin + MESSAGE_HEAD.size, end, channel))
        allowance.spend(0, count)
        found.sort(key=itemgetter(0))
        for number, (stamp_ns, begin, end, channel) in enumerate(found):
            yield stamp_ns, at or 1, number, channel, message_of(plain[begin:end])

    def unpacked(self, chunk: ChunkInfo, allowance: Allowance) -> bytes:
        """The records of a chunk. Raises ValueError where the index contradicts it, or it exceeds a limit."""
        at = chunk.chunk_start_offset
        self.bio.seek(at)
        opcode, size = RECORD.unpack(self._exact(RECORD.size))
        if opcode != CHUNK or RECORD.size + size != chunk.chunk_length:
            raise ValueError(f'its index names a chunk at byte {at}, where there is none')
        content = self._exact(size)
        head = chunk_head(content)
        if head.unpacked_bytes != chunk.uncompressed_size:
            raise ValueError(f'its index contradicts the chunk at byte {at}')
        allowance.spend(head.unpacked_bytes)
        return unpacked_chunk(content, head)

    def _loose(self, wanted: Collection[int], limits: tuple[int, int]) -> Iterator[tuple[int, int, int, int, bytes]]:
        """As `_of_chunk`, of a file without chunks. Raises ValueError where stamps go back."""
        last_ns = -1
        for at, opcode, size in self._heads():
            if opcode != MESSAGE:
                continue
            channel, _, stamp_ns, _ = MESSAGE_HEAD.unpack(self._exact(MESSAGE_HEAD.size))
            if channel not in wanted or not limits[0] <= stamp_ns < limits[1]:
                continue
            if stamp_ns < last_ns:
                raise ValueError('its messages have no index and are not in order; `raw2drive bag recover` sorts them')
            last_ns = stamp_ns
            yield stamp_ns, at, 0, channel, message_of(self._exact(size - MESSAGE_HEAD.size))

    # -- bytes ------------------------------------------------------------------------------------

    def _heads(self) -> Iterator[tuple[int, int, int]]:
        """(offset, opcode, size of the content) of every record of the data section; the file stands at the content."""
        at = self.data_start
        while at < self.data_end:
            self.bio.seek(at)
            opcode, size = RECORD.unpack(self._exact(RECORD.size))
            if at + RECORD.size + size > self.data_end:
                raise ValueError(f'the record at byte {at} reaches beyond the end of the data')
            yield at, opcode, size
            at += RECORD.size + size

    def _exact(self, size: int) -> bytes:
        data: bytes = self.bio.read(size)
        if len(data) != size:
            raise ValueError('a record is cut off')
        return data


def message_of(data: bytes) -> bytes:
    """The bytes of a message. Raises TooLargeError."""
    if len(data) > MAX_MESSAGE_BYTES:
        raise TooLargeError(f'a message of {len(data)} bytes, and no more than {MAX_MESSAGE_BYTES} are read')
    return data


def _require_room(chunks: Sequence[ChunkInfo]) -> None:
    """Raises TooLargeError where chunks overlap in time so far that too many bytes would be open together."""
    events = [(chunk.message_start_time, -chunk.uncompressed_size) for chunk in chunks]
    events += [(chunk.message_end_time, chunk.uncompressed_size) for chunk in chunks]
    together = 0
    for _, freed in sorted(events):
        together -= freed
        if together > MAX_OPEN_BYTES:
            raise TooLargeError(f'chunks of more than {MAX_OPEN_BYTES} bytes overlap in time')


def _chunk_info(content: bytes) -> ChunkInfo:
    start_ns, end_ns, at, length, offset_bytes = _TIMES.unpack_from(content)
    offsets: dict[int, int] = dict(iter_unpack('<HQ', content[_TIMES.size : _TIMES.size + offset_bytes]))
    rest = BytesIO(content[_TIMES.size + offset_bytes :])
    index_bytes = int.from_bytes(rest.read(8), 'little')
    compression = rest.read(int.from_bytes(rest.read(4), 'little')).decode()
    packed, unpacked = _SIZES.unpack(rest.read(_SIZES.size))
    # The index records of one chunk follow one another, with 16 bytes per message and 15 around them.
    by_offset = sorted((offset, channel) for channel, offset in offsets.items())
    ends = [*(offset for offset, _ in by_offset), at + length + index_bytes]
    counts = {channel: (end - begin - 15) // 16 for (_, channel), (begin, end) in zip(by_offset, pairwise(ends))}
    return ChunkInfo(start_ns, end_ns, at, length, offsets, index_bytes, compression, packed, unpacked, counts)


def _statistics(content: bytes) -> Statistics:
    *totals, start_ns, end_ns, size = _COUNTS.unpack_from(content)
    counts = dict(iter_unpack('<HQ', content[_COUNTS.size : _COUNTS.size + size]))
    messages, schemas, channels, attachments, metadata, chunks = totals
    return Statistics(messages, schemas, channels, attachments, metadata, chunks, start_ns, end_ns, counts)
