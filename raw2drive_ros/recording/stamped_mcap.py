"""MCAP files with two times per message: `log_time`, when the recorder received it, and `publish_time`, its own stamp.

rosbags writes one value into both and reads by `log_time`. Here readers still get the stamps, in order of stamps: in
simulation these count simulated time, and everything that reads a bag (training, replay, `bag cut`) goes by that.

A file of this kind has a private record (MCAP reserves the opcodes from 0x80 on for applications, and readers skip
them) after each chunk and its index: the tag `TAG` and the smallest and largest stamp of the chunk. It says that
`publish_time` is the stamp, and lets a reader merge chunks by stamp without reading all of them first. Files without it
are read as rosbags reads them.
"""

from __future__ import annotations

import struct
from collections.abc import Collection, Iterator
from io import BytesIO
from pathlib import Path
from typing import Any, ClassVar

from rosbags.interfaces import Connection
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.rosbag2.storage_mcap import ChunkInfo, McapWriter

from raw2drive_ros.bounds import MAX_INDEX_BYTES, Allowance
from raw2drive_ros.recording.bounded_mcap import BoundedMcap, message_of
from raw2drive_ros.recording.unpack import records_of

STAMPS, MESSAGE, MESSAGE_INDEX, DATA_END, TAG = 0x80, 0x05, 0x07, 0x0F, b'raw2drive stamps'
MAX_SKIPPED = 2**32
# Given as `start`: messages in the order in which they were written, with their log_time.
ARRIVAL = -1
_RANGE = struct.Struct('<QQ')
_RECORD = struct.Struct('<BQ')
# Channel, sequence, log_time, publish_time.
_MESSAGE = struct.Struct('<HIQQ')
_EMPTY = (2**63 - 1, 0)

Written = tuple[Connection, int, bytes]


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


class StampedMcapReader(BoundedMcap):
    """ranges: smallest and largest stamp of each chunk by its offset; empty for a file of another writer.

    The times of `chunks` and of `metadata` are those of the stamps where there are ranges.
    """

    ranges: dict[int, tuple[int, int]]

    def _check_index(self) -> None:
        super()._check_index()
        self.ranges = {}
        for chunk in self.chunks:
            found = self._range_after(chunk)
            if found is None:
                self.ranges.clear()
                return
            self.ranges[chunk.chunk_start_offset] = found
        if self.ranges and self.metadata.message_count:
            self.by_publish_time = True
            ranges = (self.ranges[chunk.chunk_start_offset] for chunk in self.chunks)
            self.chunks[:] = [
                chunk._replace(message_start_time=low, message_end_time=high)
                for chunk, (low, high) in zip(self.chunks, ranges, strict=True)
            ]
            start_ns, end_ns = (
                min(low for low, _ in self.ranges.values()),
                max(high for _, high in self.ranges.values()),
            )
            self.metadata = self.metadata._replace(
                start_time=start_ns, end_time=end_ns + 1, duration=end_ns - start_ns + 1
            )

    def _range_after(self, chunk: ChunkInfo) -> tuple[int, int] | None:
        at = chunk.chunk_start_offset + chunk.chunk_length
        while at < self.data_end:
            self.bio.seek(at)
            opcode, length = _RECORD.unpack(self._exact(_RECORD.size))
            if opcode != MESSAGE_INDEX:
                break
            at += _RECORD.size + length
        else:
            return None
        if opcode != STAMPS or length != len(TAG) + _RANGE.size or self._exact(len(TAG)) != TAG:
            return None
        low, high = _RANGE.unpack(self._exact(_RANGE.size))
        return low, high

    @property
    def unindexed(self) -> bool:
        """Whether a chunk has no index of its messages."""
        return any(not chunk.message_index_length for chunk in self.chunks)

    def indexed_times(self) -> Iterator[tuple[str, tuple[int, ...]]]:
        """(topic, log times as written) by chunk, from the index alone."""
        names = {connection.id: connection.topic for connection in self.connections}
        for chunk in sorted(self.chunks, key=lambda c: c.chunk_start_offset):
            if chunk.message_index_length > MAX_INDEX_BYTES:
                raise ValueError(f'an index of {chunk.message_index_length} bytes in one chunk')
            self.bio.seek(chunk.chunk_start_offset + chunk.chunk_length)
            index = BytesIO(self._exact(chunk.message_index_length))
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
            return self._arrivals({c.id: c for c in connections})
        return super().messages(connections, start, stop)

    def _arrivals(self, wanted: dict[int, Connection]) -> Iterator[Written]:
        allowance = Allowance(self.packed_bytes)
        if not self.chunks:
            for _, opcode, size in self._heads():
                if opcode == MESSAGE:
                    content = self._exact(size)
                    channel, _, log_ns, _ = _MESSAGE.unpack_from(content)
                    if channel in wanted:
                        yield wanted[channel], log_ns, message_of(content[_MESSAGE.size :])
            return
        for chunk in sorted(self.chunks, key=lambda c: c.chunk_start_offset):
            if not any(chunk.channel_count.get(channel, 0) for channel in wanted):
                continue
            plain = self.unpacked(chunk, allowance)
            for opcode, begin, end in records_of(plain):
                if opcode == MESSAGE:
                    channel, _, log_ns, _ = _MESSAGE.unpack_from(plain, begin)
                    if channel in wanted:
                        yield wanted[channel], log_ns, message_of(plain[begin + _MESSAGE.size : end])


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
