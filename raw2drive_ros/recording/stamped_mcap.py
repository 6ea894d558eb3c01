"""MCAP files with two times per message: `log_time`, when the recorder received it, and `publish_time`, its own stamp.

rosbags writes one value into both and reads by `log_time`. Here readers still get the stamps, in order of stamps: in
simulation these count simulated time, and everything that reads a bag (training, replay, `bag cut`) goes by that.

A file of this kind has a private record (MCAP reserves the opcodes from 0x80 on for applications, and readers skip
them) after each chunk and its index: the tag `TAG` and the smallest and largest stamp of the chunk. It says that
`publish_time` is the stamp, and lets a reader merge chunks by stamp without reading all of them first. Files without it
are read as rosbags reads them.
"""

from __future__ import annotations

import heapq
import struct
from collections.abc import Callable, Collection, Iterator
from io import BytesIO
from pathlib import Path
from typing import Any, ClassVar, NamedTuple

from rosbags.interfaces import Connection
from rosbags.rosbag2 import Reader, StoragePlugin, Writer
from rosbags.rosbag2.reader import DirectoryReader
from rosbags.rosbag2.storage_mcap import ChunkInfo, McapReader, McapWriter, decompress, read_exact
from rosbags.rosbag2.storage_sqlite3 import Sqlite3Reader

STAMPS, MESSAGE, DATA_END, TAG = 0x80, 0x05, 0x0F, b'raw2drive stamps'
MAX_SKIPPED = 2**32
# Given as `start`: messages in the order in which they were written, with their log_time.
ARRIVAL = -1
_RANGE = struct.Struct('<QQ')
_RECORD = struct.Struct('<BQ')
# Channel, sequence, log_time, publish_time.
_MESSAGE = struct.Struct('<HIQQ')
_EMPTY = (2**63 - 1, 0)

Written = tuple[Connection, int, bytes]


class _Stamped(NamedTuple):
    """Sorted by stamp, within a stamp as written."""

    stamp_ns: int
    offset: int
    number: int
    connection: Connection | None
    data: bytes


class StampedMcapWriter(McapWriter):
    """`stamp_ns`: set before each `write`, whose timestamp is the time of reception; None: the two are one value."""

    stamp_ns: int | None = None
    stamped: bool | None = None
    _range = _EMPTY

    def write(self, connection: Connection, timestamp: int, data: bytes | memoryview) -> None:
        stamp_ns = timestamp if self.stamp_ns is None else self.stamp_ns
        if self.stamped is None:
            # One kind per file: decided by its first message.
            self.stamped = self.stamp_ns is not None
        self.message_start_time = min(timestamp, self.message_start_time)
        self.message_end_time = max(timestamp, self.message_end_time)
        self.channel_stats[connection.id] += 1
        chunk = self.chunk
        chunk.message_start_time = min(timestamp, chunk.message_start_time)
        chunk.message_end_time = max(timestamp, chunk.message_end_time)
        chunk.msgs[connection.id].append((timestamp, chunk.bio.tell()))
        self._range = min(stamp_ns, self._range[0]), max(stamp_ns, self._range[1])
        chunk.bio.write(_RECORD.pack(MESSAGE, _MESSAGE.size + len(data)))
        chunk.bio.write(_MESSAGE.pack(connection.id, 0, timestamp, stamp_ns))
        chunk.bio.write(data)
        if chunk.bio.tell() > 2**20:
            self.close_chunk()

    def close_chunk(self) -> None:
        super().close_chunk()
        if self.stamped:
            said = TAG + _RANGE.pack(*self._range)
            self.bio.write(_RECORD.pack(STAMPS, len(said)) + said)
        self._range = _EMPTY


class StampedWriter(Writer):
    """A rosbags Writer of MCAP bags; `write_at` takes both times."""

    STORAGE_PLUGINS: ClassVar[dict[Any, Any]] = {**Writer.STORAGE_PLUGINS, StoragePlugin.MCAP: StampedMcapWriter}

    def write_at(
        self, connection: Connection, stamp_ns: int, received_ns: int | None, data: bytes | memoryview
    ) -> None:
        """received_ns: None where nobody received it (a collector writes what it made): its stamp is its log_time."""
        assert isinstance(self.storage, StampedMcapWriter)
        self.storage.stamp_ns = None if received_ns is None else stamp_ns
        self.write(connection, stamp_ns if received_ns is None else received_ns, data)


def _inflated(chunk: ChunkInfo, bio: Any) -> BytesIO:
    # Opcode and length of the record, then its two times and the size.
    bio.seek(chunk.chunk_start_offset + _RECORD.size + 24)
    (crc,) = struct.unpack('<I', read_exact(bio, 4))
    bio.seek(chunk.chunk_start_offset + _RECORD.size + 40 + len(chunk.compression))
    packed = read_exact(bio, chunk.compressed_size)
    return BytesIO(decompress(packed, chunk.compression, chunk.uncompressed_size, crc))


def _messages(chunk: ChunkInfo, bio: Any) -> Iterator[tuple[int, int, int, bytes]]:
    """(channel, log_time, publish_time, data) of a chunk, as written."""
    inner = _inflated(chunk, bio)
    while inner.tell() < chunk.uncompressed_size:
        kind, length = _RECORD.unpack(read_exact(inner, _RECORD.size))
        record = read_exact(inner, length)
        if kind == MESSAGE:
            channel, _, log_ns, publish_ns = _MESSAGE.unpack_from(record)
            yield channel, log_ns, publish_ns, record[_MESSAGE.size :]


class StampedMcapReader(McapReader):
    """ranges: smallest and largest stamp of each chunk by its offset; empty for a file of another writer."""

    ranges: dict[int, tuple[int, int]]

    def _open(self) -> None:
        super()._open()
        self.ranges = {}
        for chunk in self.chunks:
            found = self._range_after(chunk)
            if found is None:
                self.ranges.clear()
                return
            self.ranges[chunk.chunk_start_offset] = found
        if self.ranges and self.metadata.message_count:
            start_ns, end_ns = self.span
            self.metadata = self.metadata._replace(
                start_time=start_ns, end_time=end_ns + 1, duration=end_ns - start_ns + 1
            )

    @property
    def span(self) -> tuple[int, int]:
        """Smallest and largest stamp of the file."""
        return min(low for low, _ in self.ranges.values()), max(high for _, high in self.ranges.values())

    def _range_after(self, chunk: ChunkInfo) -> tuple[int, int] | None:
        assert self.bio is not None
        self.bio.seek(chunk.chunk_start_offset + chunk.chunk_length + chunk.message_index_length)
        size = _RECORD.size + len(TAG) + _RANGE.size
        record = self.bio.read(size)
        if len(record) < size or record[0] != STAMPS or record[_RECORD.size :][: len(TAG)] != TAG:
            return None
        low, high = _RANGE.unpack_from(record, _RECORD.size + len(TAG))
        return low, high

    @property
    def unindexed(self) -> bool:
        """Whether a chunk has no index of its messages."""
        return any(not chunk.message_index_length for chunk in self.chunks)

    def indexed_times(self) -> Iterator[tuple[str, tuple[int, ...]]]:
        """(topic, log times as written) by chunk, from the index alone."""
        assert self.bio is not None
        names = {connection.id: connection.topic for connection in self.connections}
        for chunk in sorted(self.chunks, key=lambda c: c.chunk_start_offset):
            self.bio.seek(chunk.chunk_start_offset + chunk.chunk_length)
            index = BytesIO(read_exact(self.bio, chunk.message_index_length))
            while head := index.read(_RECORD.size):
                record = index.read(_RECORD.unpack(head)[1])
                (channel,) = struct.unpack_from('<H', record)
                times = struct.unpack_from(f'<{(len(record) - 6) // 8}Q', record, 6)[::2]
                if channel in names:
                    yield names[channel], times

    def messages(
        self, connections: Collection[Connection], start: int | None = None, stop: int | None = None
    ) -> Iterator[Written]:
        if start == ARRIVAL:
            yield from self._arrivals({c.id: c for c in connections})
        elif self.ranges:
            yield from self._by_stamp({c.id: c for c in connections}, start, stop)
        else:
            yield from super().messages(connections, start, stop)

    def _arrivals(self, wanted: dict[int, Connection]) -> Iterator[Written]:
        if not self.chunks:
            yield from self.messages_scan(list(wanted.values()))
            return
        for chunk in sorted(self.chunks, key=lambda c: c.chunk_start_offset):
            if any(chunk.channel_count.get(channel, 0) for channel in wanted):
                for channel, log_ns, _, data in _messages(chunk, self.bio):
                    if channel in wanted:
                        yield wanted[channel], log_ns, data

    def _by_stamp(self, wanted: dict[int, Connection], start: int | None, stop: int | None) -> Iterator[Written]:
        low_ns, high_ns = 0 if start is None else start, 2**64 if stop is None else stop
        sources = []
        for chunk in self.chunks:
            low, high = self.ranges[chunk.chunk_start_offset]
            if low_ns <= high and low < high_ns and any(chunk.channel_count.get(channel, 0) for channel in wanted):
                keep = _between(low_ns, high_ns)
                sources.append(self._sorted(chunk, low, wanted, keep))
        for found in heapq.merge(*sources, key=lambda m: m[:3]):
            if found.connection is not None:
                yield found.connection, found.stamp_ns, found.data

    def _sorted(
        self, chunk: ChunkInfo, low: int, wanted: dict[int, Connection], keep: Callable[[int], bool]
    ) -> Iterator[_Stamped]:
        # Before the chunk is read: the merge asks every source for its first message.
        yield _Stamped(low, chunk.chunk_start_offset, -1, None, b'')
        found = [
            _Stamped(stamp_ns, chunk.chunk_start_offset, number, wanted[channel], data)
            for number, (channel, _, stamp_ns, data) in enumerate(_messages(chunk, self.bio))
            if channel in wanted and keep(stamp_ns)
        ]
        yield from sorted(found, key=lambda m: m[:3])


def _between(low_ns: int, high_ns: int) -> Callable[[int], bool]:
    return lambda stamp_ns: low_ns <= stamp_ns < high_ns


def holds_stamps(file: Path) -> bool:
    """Whether an MCAP file, finished or not, is of this kind: its publish_time is the stamp. Damage makes it False."""
    with file.open('rb') as stream:
        # After the magic: records up to the private one after the first chunk and its index.
        stream.seek(8)
        while len(head := stream.read(_RECORD.size)) == _RECORD.size:
            kind, length = _RECORD.unpack(head)
            if kind == STAMPS and length == len(TAG) + _RANGE.size and stream.read(len(TAG)) == TAG:
                return True
            if kind == DATA_END or length > MAX_SKIPPED:
                return False
            stream.seek(length, 1)
    return False


class StampedDirectory(DirectoryReader):
    """A bag's folder; its times are those of the stamps where its files hold them."""

    STORAGE_PLUGINS: ClassVar[dict[Any, Any]] = {'mcap': StampedMcapReader, 'sqlite3': Sqlite3Reader}

    @property
    def stamped(self) -> bool:
        return bool(self.storages) and all(getattr(storage, 'ranges', None) for storage in self.storages)

    def open(self) -> None:
        super().open()
        if self.stamped and self.metadata.message_count:
            spans = [storage.span for storage in self.storages if isinstance(storage, StampedMcapReader)]
            start_ns, end_ns = min(low for low, _ in spans), max(high for _, high in spans)
            self.metadata = self.metadata._replace(
                start_time=start_ns, end_time=end_ns + 1, duration=end_ns - start_ns + 1
            )


class StampedReader(Reader):
    """A rosbags Reader. `messages` gives stamps, in order of stamps, where the bag holds both times; otherwise what
    rosbags gives: log times."""

    STORAGE_PLUGINS: ClassVar[dict[Any, Any]] = {
        **Reader.STORAGE_PLUGINS,
        'dir': StampedDirectory,
        '.mcap': StampedMcapReader,
    }

    @property
    def stamped(self) -> bool:
        """Whether log_time is the time of reception and publish_time the stamp."""
        return bool(getattr(self.storage, 'stamped', None) or getattr(self.storage, 'ranges', None))

    def arrivals(self, connections: Collection[Connection] = ()) -> Iterator[Written]:
        """(connection, log_time, data) in the order in which they were written (sqlite3: in order of log_time)."""
        return self.messages(connections, start=ARRIVAL)
