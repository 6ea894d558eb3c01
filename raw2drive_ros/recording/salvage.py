"""Everything readable of a damaged MCAP file, in the order in which it was written.

A chunk that cannot be unpacked is left out. Where a record's length is wrong, nothing behind it is where it should be:
the search goes on byte by byte for the next record that proves itself: a chunk by unpacking to what it claims (and by
its checksum), any other one by its inner lengths and by the record that follows it.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Generator, Iterator
from contextlib import suppress
from dataclasses import dataclass, field
from io import BytesIO
from pathlib import Path
from struct import Struct
from struct import error as StructError
from typing import NamedTuple, Protocol

from mcap.data_stream import ReadDataStream
from mcap.records import Channel, Schema

from raw2drive_ros.bounds import MAX_CHUNK_BYTES, MAX_INDEX_BYTES, MIB, Allowance, BoundedFile
from raw2drive_ros.recording.unpack import (
    CHANNEL,
    CHUNK,
    DATA_END,
    FOOTER,
    FOOTER_BYTES,
    MAGIC,
    MESSAGE,
    MESSAGE_HEAD,
    MESSAGE_INDEX,
    RECORD,
    SCHEMA,
    ChunkHead,
    chunk_head,
    records_of,
    unpacked_chunk,
)

# Header, attachments, metadata: they hold no messages.
EXPECTED = (1, 9, 12)
# Private records of this project.
OURS = b'raw2drive'
HEADER, HIGHEST_OPCODE, PRIVATE_OPCODES = 1, DATA_END, 128
MAX_RECORD_BYTES = MAX_CHUNK_BYTES + MIB
# Opcode and a length below 2 ** 32 of a record of the data section. Looking ahead: candidates overlap.
_CANDIDATE = re.compile(rb'(?=[\x03-\x07\x0f].{4}\x00{4})', re.DOTALL)
# A search that looks at so many places in vain has met something other than a recording.
MAX_CANDIDATES = 300_000
# Enough of a record to judge it by: the head of a chunk, the name of a topic or type.
PEEK_BYTES = 1024
_INDEX_HEAD = Struct('<HI')
_UINT32 = Struct('<I')
FOOTER_CONTENT_BYTES = 20


class Found(NamedTuple):
    """A message. channel: see `Salvage.definition`. log_ns, publish_ns: its two times in the file."""

    channel: int
    log_ns: int
    publish_ns: int
    data: bytes


class Gap(NamedTuple):
    """A place where something is lost. end_ns: up to when, where that is known; 0 otherwise."""

    end_ns: int = 0


class Source(Protocol):
    """Where records stand: a file, or the bytes of a chunk."""

    size: int

    def at(self, position: int, size: int) -> bytes:
        """`size` bytes from `position`, or what there is."""


class _File:
    def __init__(self, file: BoundedFile) -> None:
        self.file = file
        self.size = file.size

    def at(self, position: int, size: int) -> bytes:
        self.file.seek(position)
        return self.file.read(size)


class _Bytes:
    def __init__(self, content: bytes) -> None:
        self.content = content
        self.size = len(content)

    def at(self, position: int, size: int) -> bytes:
        return self.content[position : position + size]


@dataclass(slots=True)
class Salvage:
    """damaged: chunks that could not be unpacked. breaks: places where the boundaries of records were lost and found
    again, or lost for good, with `skipped_bytes` between. truncated: the file ends before its data does, as after a
    kill. strange: records of kinds that no recorder writes there. lost: messages of damaged chunks by channel, where
    their index has survived."""

    source: Source
    schemas: dict[int, Schema] = field(default_factory=dict)
    channels: dict[int, Channel] = field(default_factory=dict)
    damaged: int = 0
    breaks: int = 0
    skipped_bytes: int = 0
    truncated: bool = False
    strange: int = 0
    lost: Counter[int] = field(default_factory=Counter)
    _candidates: int = 0
    # The last chunk was read, so that the index records behind it tell nothing new; otherwise: whether its loss has
    # been noted, and the messages that were found of it nevertheless.
    _covered: bool = False
    _noted: bool = False
    _loose: Counter[int] = field(default_factory=Counter)
    _allowance: Allowance = field(init=False)

    def __post_init__(self) -> None:
        self._allowance = Allowance(self.source.size)

    def records(self) -> Iterator[Found | Gap]:
        """Messages, and gaps between them. Raises TooLargeError where the file unpacks to implausibly much."""
        self._read_summary()
        begin = len(MAGIC) if self.source.at(0, len(MAGIC)) == MAGIC else 0
        ended = yield from self._walk(self.source, begin)
        self.truncated = not ended

    def definition(self, channel: int) -> tuple[Channel, Schema] | None:
        """The channel and its schema, or None where either is lost."""
        about = self.channels.get(channel)
        schema = self.schemas.get(about.schema_id) if about else None
        return (about, schema) if about and schema else None

    def _walk(self, source: Source, at: int) -> Generator[Found | Gap, None, bool]:
        """Returns whether the walk came to where the data section says that it ends."""
        while at < source.size:
            self._allowance.spend(0, 1)
            opcode, length = _head(source, at)
            end = at + RECORD.size + length
            following: int | None = None
            sound = self._is_record(source, at, opcode, length, prove=False)
            if not sound or not _is_head(source, end):
                following = self._next_record(source, at + 1)
                # What is broken is this record's length where another one begins inside it, else the next record.
                sound = sound and (following is None or following >= end)
            if sound:
                if opcode in (DATA_END, FOOTER):
                    return True
                yield from self._content(opcode, source.at(at + RECORD.size, length), nested=source is not self.source)
                at = end
                continue
            if opcode == CHUNK:
                self._lose()
            self._noted = True
            self.skipped_bytes += (source.size if following is None else following) - at
            yield Gap()
            if following is None:
                # The end of a file that its recorder did not finish, or of a chunk, has no next record.
                self.breaks += source is not self.source
                return False
            self.breaks += 1
            at = following
        return False

    # -- content of records -----------------------------------------------------------------------

    def _content(self, opcode: int, content: bytes, *, nested: bool) -> Iterator[Found | Gap]:
        if opcode == CHUNK:
            yield from self._of_chunk(content)
        elif opcode == MESSAGE:
            channel, _, log_ns, publish_ns = MESSAGE_HEAD.unpack_from(content)
            self._covered = nested
            self._loose[channel] += not nested
            yield Found(channel, log_ns, publish_ns, content[MESSAGE_HEAD.size :])
        elif opcode in (SCHEMA, CHANNEL):
            self._define(opcode, content)
        elif opcode == MESSAGE_INDEX:
            yield from self._of_index(content)
        elif opcode not in EXPECTED and not content.startswith(OURS):
            self._lose()
            self.strange += 1
            self._noted = True
            yield Gap()

    def _of_index(self, content: bytes) -> Iterator[Gap]:
        """Of a chunk that was not read, perhaps because its head is that of another record now."""
        channel, size = _INDEX_HEAD.unpack_from(content)
        missing = max(0, size // 16 - self._loose.pop(channel, 0))
        if self._covered or not missing:
            return
        self.lost[channel] += missing
        if not self._noted:
            self._noted = True
            self.damaged += 1
            yield Gap()

    def _lose(self) -> None:
        """What follows is the index of a chunk that was not read."""
        self._covered = self._noted = False
        self._loose.clear()

    def _of_chunk(self, content: bytes) -> Iterator[Found | Gap]:
        head = chunk_head(content)
        plain = self._unpacked(content, head)
        self._lose()
        if plain is None:
            self.damaged += 1
            self._noted = True
            yield Gap(head.end_ns)
            return
        self._covered = True
        yield from self._walk(_Bytes(plain), 0)
        self._covered = True

    def _unpacked(self, content: bytes, head: ChunkHead) -> bytes | None:
        """The bytes of a chunk, or None where it is damaged. Raises TooLargeError as `records`."""
        if head.unpacked_bytes > MAX_CHUNK_BYTES:
            return None
        self._allowance.spend(head.unpacked_bytes)
        try:
            return unpacked_chunk(content, head)
        except ValueError:
            return None

    def _define(self, opcode: int, content: bytes) -> None:
        with suppress(Exception):
            # Damaged definitions raise all kinds of errors; messages of such a channel have no definition.
            if opcode == SCHEMA:
                schema = Schema.read(ReadDataStream(BytesIO(content)))
                self.schemas.setdefault(schema.id, schema)
            else:
                channel = Channel.read(ReadDataStream(BytesIO(content)))
                self.channels.setdefault(channel.id, channel)

    def _read_summary(self) -> None:
        """Schemas and channels as the summary section repeats them: the chunk that introduced them may be lost."""
        footer_at = self.source.size - FOOTER_BYTES
        footer = self.source.at(max(0, footer_at), FOOTER_BYTES)
        if not footer.endswith(MAGIC) or footer[0] != FOOTER:
            return
        begin = int.from_bytes(footer[9:17], 'little')
        if not 0 < begin < footer_at or footer_at - begin > MAX_INDEX_BYTES:
            return
        summary = self.source.at(begin, footer_at - begin)
        with suppress(ValueError):
            for opcode, start, end in records_of(summary):
                if opcode in (SCHEMA, CHANNEL):
                    self._define(opcode, summary[start:end])

    # -- boundaries -------------------------------------------------------------------------------

    def _next_record(self, source: Source, at: int) -> int | None:
        """Where the next record stands that proves itself, at or after `at`."""
        while at < source.size:
            window = source.at(at, MIB + RECORD.size)
            for match in _CANDIDATE.finditer(window):
                self._candidates += 1
                if self._candidates > MAX_CANDIDATES:
                    return None
                opcode, length = RECORD.unpack_from(window, match.start())
                if self._is_record(source, at + match.start(), opcode, length, prove=True):
                    return at + match.start()
            at += MIB
        return None

    def _is_record(self, source: Source, at: int, opcode: int, length: int, *, prove: bool) -> bool:
        """Whether a record stands there whole. prove: by more than its lengths, which may be chance."""
        begin, end = at + RECORD.size, at + RECORD.size + length
        if length > MAX_RECORD_BYTES or end > source.size:
            return False
        if opcode == CHUNK:
            # Chunks hold no chunks.
            return source is self.source and self._is_chunk(source, begin, length, prove=prove)
        if opcode == FOOTER:
            return length == FOOTER_CONTENT_BYTES and end + len(MAGIC) == source.size
        if prove and not _is_head(source, end):
            return False
        try:
            peek = source.at(begin, min(length, PEEK_BYTES))
            if opcode == MESSAGE:
                return MESSAGE_HEAD.unpack_from(peek)[0] in self.channels or not prove
            if opcode == MESSAGE_INDEX:
                return bool(_INDEX_HEAD.unpack_from(peek)[1] == length - _INDEX_HEAD.size)
            if opcode in (SCHEMA, CHANNEL):
                return _is_text_at(peek, 2 if opcode == SCHEMA else 4)
        except (ValueError, StructError):
            return False
        if opcode == DATA_END:
            return length == _UINT32.size
        return not prove and (HEADER <= opcode <= HIGHEST_OPCODE or opcode >= PRIVATE_OPCODES)

    def _is_chunk(self, source: Source, at: int, length: int, *, prove: bool) -> bool:
        try:
            head = chunk_head(source.at(at, min(length, PEEK_BYTES)), length)
        except (ValueError, StructError):
            return False
        return not prove or self._unpacked(source.at(at, length), head) is not None


def _is_head(source: Source, at: int) -> bool:
    """Whether a record could begin there, which the file may cut off, or the file ends."""
    if at == source.size:
        return True
    opcode, length = _head(source, at)
    known = HEADER <= opcode <= HIGHEST_OPCODE or opcode >= PRIVATE_OPCODES
    return known and length <= MAX_RECORD_BYTES


def _head(source: Source, at: int) -> tuple[int, int]:
    """(opcode, length) of the record there; what the file cuts off counts as zero."""
    opcode, length = RECORD.unpack(source.at(at, RECORD.size).ljust(RECORD.size, b'\0'))
    return opcode, length


def _is_text_at(content: bytes, at: int) -> bool:
    """Whether a text with its length before it stands there, as topics and type names do."""
    (length,) = _UINT32.unpack_from(content, at)
    text = content[at + 4 : at + 4 + length]
    return len(text) == length > 0 and text.decode().isprintable()


def open_salvage(path: Path) -> Salvage:
    """Raises OSError where there is no regular file."""
    return Salvage(_File(BoundedFile(path, MAX_RECORD_BYTES + MIB)))
