"""Unpacking of compressed chunks, messages and files, bounded by what comes out and not by what the file claims."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from struct import Struct
from typing import Any, NamedTuple
from zlib import crc32

import lz4.frame

from raw2drive_ros.bounds import (
    MAX_CHUNK_BYTES,
    MAX_CHUNK_MESSAGES,
    MAX_MESSAGE_BYTES,
    MIB,
    Allowance,
    BoundedFile,
    TooLargeError,
)

if sys.version_info >= (3, 14):
    from compression import zstd
else:
    # What rosbags itself needs for the same purpose.
    from backports import zstd

ZSTD_MAGIC = b'\x28\xb5\x2f\xfd'
# Every frame costs a copy of what follows it.
MAX_FRAMES = 16
MAGIC = b'\x89MCAP0\r\n'
FOOTER, SCHEMA, CHANNEL, MESSAGE, CHUNK, MESSAGE_INDEX, CHUNK_INDEX, STATISTICS, DATA_END = 2, 3, 4, 5, 6, 7, 8, 11, 15
# Footer record and the magic bytes after it.
FOOTER_BYTES = 37
RECORD = Struct('<BQ')
MESSAGE_HEAD = Struct('<HIQQ')
_CHUNK_HEAD = Struct('<QQQII')
_LENGTH = Struct('<Q')


class ChunkHead(NamedTuple):
    """What a chunk record says of itself. Times in ns. data_at: where its compressed bytes begin in the record."""

    start_ns: int
    end_ns: int
    unpacked_bytes: int
    crc: int
    compression: str
    data_at: int
    data_bytes: int


def chunk_head(content: bytes, length: int | None = None) -> ChunkHead:
    """The head of a chunk record of `length` bytes, of which `content` is the beginning, or all by default.

    Raises ValueError where its lengths contradict one another.
    """
    if len(content) < _CHUNK_HEAD.size + 8:
        raise ValueError('a chunk that is too short for its head')
    start_ns, end_ns, unpacked_bytes, crc, name_bytes = _CHUNK_HEAD.unpack_from(content)
    name_end = _CHUNK_HEAD.size + name_bytes
    name = content[_CHUNK_HEAD.size : name_end]
    if name not in (b'', b'zstd', b'lz4') or len(content) < name_end + 8:
        raise ValueError(f'a chunk of unknown compression {name[:16]!r}')
    (data_bytes,) = _LENGTH.unpack_from(content, name_end)
    if name_end + 8 + data_bytes != (len(content) if length is None else length):
        raise ValueError('a chunk whose length contradicts that of its record')
    return ChunkHead(start_ns, end_ns, unpacked_bytes, crc, name.decode(), name_end + 8, data_bytes)


def unpacked_chunk(content: bytes, head: ChunkHead) -> bytes:
    """The records of a chunk. Raises ValueError where it is larger than it claims or allowed, or damaged."""
    if head.unpacked_bytes > MAX_CHUNK_BYTES:
        raise TooLargeError(f'a chunk of {head.unpacked_bytes} bytes, and no more than {MAX_CHUNK_BYTES} are read')
    packed = content[head.data_at :]
    plain = _UNPACK[head.compression](packed, head.unpacked_bytes)
    if len(plain) != head.unpacked_bytes:
        raise ValueError(f'a chunk of {len(plain)} bytes that claims {head.unpacked_bytes}')
    if head.crc and crc32(plain) != head.crc:
        raise ValueError('a chunk whose checksum is wrong')
    return plain


def unpacked_message(packed: bytes) -> bytes:
    """A message that was compressed alone. Raises ValueError where it is damaged or too large."""
    return _unzstd(packed, MAX_MESSAGE_BYTES)


def _unzstd(packed: bytes, most: int) -> bytes:
    return _unpacked(zstd.ZstdDecompressor, packed, most)


def _unlz4(packed: bytes, most: int) -> bytes:
    return _unpacked(lz4.frame.LZ4FrameDecompressor, packed, most)


_UNPACK: dict[str, Callable[[bytes, int], bytes]] = {'': lambda data, most: data, 'zstd': _unzstd, 'lz4': _unlz4}


def _unpacked(kind: Any, packed: bytes, most: int) -> bytes:
    """All frames of `packed`, of which recorders write one. Raises ValueError."""
    parts, size, rest = [], 0, packed
    for _ in range(MAX_FRAMES):
        machine = kind()
        try:
            part = machine.decompress(rest, max_length=most - size + 1)
        except (zstd.ZstdError, RuntimeError, EOFError) as error:
            raise ValueError(f'cannot be unpacked: {error}') from error
        parts.append(part)
        size += len(part)
        if size > most:
            raise TooLargeError(f'unpacks to more than {most} bytes')
        if not machine.eof:
            raise ValueError('compressed data that ends too early')
        rest = machine.unused_data
        if not rest:
            return parts[0] if len(parts) == 1 else b''.join(parts)
    raise TooLargeError(f'more than {MAX_FRAMES} frames of compressed data in one piece')


def records_of(plain: bytes) -> Iterator[tuple[int, int, int]]:
    """(opcode, begin, end of its content) of every record in the bytes of a chunk. Raises ValueError."""
    at, size, count = 0, len(plain), 0
    while at < size:
        count += 1
        if count > MAX_CHUNK_MESSAGES:
            raise TooLargeError(f'more than {MAX_CHUNK_MESSAGES} messages in one chunk')
        if size - at < RECORD.size:
            raise ValueError('a record that is cut off')
        opcode, length = RECORD.unpack_from(plain, at)
        begin = at + RECORD.size
        at = begin + length
        if at > size:
            raise ValueError('a record that reaches beyond the end of its chunk')
        yield opcode, begin, at


def unpack_file(source: Path, target: Path, allowance: Allowance) -> None:
    """Unpack a file that was compressed as a whole (zstd). Raises ValueError (TooLargeError) or OSError."""
    with BoundedFile(source, MIB) as packed, target.open('wb') as plain:
        try:
            with zstd.open(packed, 'rb') as stream:
                while part := stream.read(MIB):
                    allowance.spend(len(part))
                    plain.write(part)
        except (zstd.ZstdError, EOFError) as error:
            raise ValueError(f'{source.name}: cannot be unpacked: {error}') from error
