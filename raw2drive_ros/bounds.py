"""Limits on what is read from files of unknown origin, with their reasons, and readers that keep them.

A file that is refused here costs a line of text, and neither memory nor minutes. The limits are far above what this
project writes and what other recorders are known to write; with them, `raw2drive bag` stays below 1 GiB of memory.
"""

from __future__ import annotations

import errno
import io
import json
import os
import stat
from pathlib import Path
from typing import Any

import yaml

MIB = 2**20
# YAML. Parameter files have 5 KB; the metadata.yaml of a bag 20 KB, and 200 bytes more per part of a split one. The bag
# library reads 10 000 nodes of it a second.
MAX_YAML_BYTES = MIB
MAX_YAML_NODES = 50_000
MAX_YAML_DEPTH = 40
# JSON: a policy bundle's manifest has 10 KB; the list of a thousand bags would add 100 KB. A byte of JSON takes up to
# 25 bytes of memory.
MAX_JSON_BYTES = 8 * MIB
# A row of results has 2 KB, a suite up to 1000 routes; an hour of soak has 1000 samples of 1 KB.
MAX_RESULTS_BYTES = 64 * MIB
# safetensors: 120 bytes per tensor; preset `paper` has 500 tensors, with its optimisers 1500.
MAX_HEADER_BYTES = 4 * MIB
# Weights of preset `paper` have 360 MB as float16; a checkpoint of it, float32 with two moments, 2.2 GB.
MAX_WEIGHT_BYTES = 512 * MIB
MAX_CHECKPOINT_BYTES = 4096 * MIB
# A message: an 8K RGB image has 100 MB, which no camera of this project comes near; a 4K one has 25 MB, a dense point
# cloud 30 MB. Messages of many small parts take a thousand times their size when decoded; no route, command or
# diagnostic report has more than 100 KB.
MAX_MESSAGE_BYTES = 64 * MIB
MAX_STRUCTURED_BYTES = MIB
# MCAP: recorders close a chunk after 1 to 16 MB, or after the message that exceeds this. Chunks that overlap
# in time have to be open together.
MAX_CHUNK_BYTES = 2 * MAX_MESSAGE_BYTES
MAX_OPEN_BYTES = 3 * MAX_CHUNK_BYTES
# The smallest messages of a vehicle, with their record, have 40 bytes.
MAX_CHUNK_MESSAGES = 1_000_000
# The index at the end of a file has 400 bytes per chunk: 60 GB of bag.
MAX_INDEX_BYTES = 32 * MIB
# Large systems have 1500 topics.
MAX_TOPICS = 4096
# What all chunks and messages of a file unpack to. Recordings of a simulation shrink to a tenth, black pictures to a
# hundredth; a message cannot be packed into less than a few bytes, because each has another stamp.
UNPACKED_FLOOR_BYTES = 512 * MIB
UNPACKED_RATIO = 200
MESSAGES_FLOOR = 100_000
MESSAGES_PER_BYTE = 0.25
# Pixels of a compressed picture: 8K.
MAX_PIXELS = 2**25

_KINDS = {
    stat.S_IFIFO: 'a FIFO',
    stat.S_IFSOCK: 'a socket',
    stat.S_IFCHR: 'a device',
    stat.S_IFBLK: 'a device',
    stat.S_IFDIR: 'a folder',
}
_Loader: Any = getattr(yaml, 'CSafeLoader', yaml.SafeLoader)


class TooLargeError(ValueError):
    """Something would exceed a limit of this module. Callers turn it into the error of what they read."""


class BoundedFile(io.BufferedReader):
    """A regular file, open for reading, of which no more than `most` bytes are read at once.

    Raises OSError for anything that is not a regular file: a FIFO would block, a device never end.
    """

    def __init__(self, path: Path, most: int) -> None:
        # Without O_NONBLOCK, opening a FIFO waits for a writer.
        handle = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC)
        try:
            found = os.fstat(handle)
            if not stat.S_ISREG(found.st_mode):
                kind = _KINDS.get(stat.S_IFMT(found.st_mode), 'something else')
                raise OSError(errno.EINVAL, f'is {kind}, not a file', str(path))
        except BaseException:
            os.close(handle)
            raise
        super().__init__(io.FileIO(handle, 'rb'))
        self.size = found.st_size
        self.most = most

    def read(self, size: int | None = -1, /) -> bytes:
        """Raises TooLargeError where `size`, or the rest of the file, is more than `most`."""
        asked = self.size - self.tell() if size is None or size < 0 else size
        if asked > self.most:
            raise TooLargeError(f'{asked} bytes in one piece, and no more than {self.most} are read')
        return super().read(size)


def require_regular(path: Path) -> int:
    """The size of a regular file in bytes. Raises OSError for anything else, without blocking."""
    with BoundedFile(path, 0) as file:
        return file.size


def read_regular(path: Path, most: int) -> bytes:
    """The content of a regular file of at most `most` bytes. Raises OSError, whose `strerror` says why."""
    with BoundedFile(path, most + 1) as file:
        # Files of /proc have size 0 and content nevertheless.
        content = file.read(most + 1) if file.size <= most else b''
        if file.size > most or len(content) > most:
            size = max(file.size, len(content))
            raise OSError(errno.EFBIG, f'has {size} bytes, and no more than {most} are read', str(path))
    return content


def yaml_from(content: bytes | str) -> Any:
    """What a YAML text holds. Raises yaml.YAMLError or ValueError (TooLargeError: nested or multiplied too far)."""
    text = content.decode('utf-8') if isinstance(content, bytes) else content
    _measure(text)
    loader = _Loader(text)
    try:
        return loader.get_single_data()
    finally:
        loader.dispose()


def _measure(text: str) -> None:
    """Raises TooLargeError where a text, its aliases expanded, has too many nodes or too deep ones."""
    sizes: dict[str, int] = {}
    # Of every collection that is not closed yet: its anchor, and the nodes in it so far.
    open_ones: list[tuple[str | None, int]] = []
    total = 0
    for event in yaml.parse(text, Loader=_Loader):
        if isinstance(event, yaml.CollectionEndEvent):
            anchor, inside = open_ones.pop()
            size = inside + 1
        elif isinstance(event, yaml.CollectionStartEvent):
            open_ones.append((event.anchor, 0))
            if len(open_ones) > MAX_YAML_DEPTH:
                raise TooLargeError(f'nested more than {MAX_YAML_DEPTH} deep')
            continue
        elif isinstance(event, yaml.AliasEvent):
            if any(anchor == event.anchor for anchor, _ in open_ones):
                raise TooLargeError(f'*{event.anchor} holds itself')
            anchor, size = None, sizes.get(event.anchor or '', 1)
        elif isinstance(event, yaml.ScalarEvent):
            anchor, size = event.anchor, 1
        else:
            continue
        if anchor is not None:
            sizes[anchor] = size
        if open_ones:
            open_ones[-1] = open_ones[-1][0], open_ones[-1][1] + size
        total = open_ones[0][1] if open_ones else size
        if size > MAX_YAML_NODES or total > MAX_YAML_NODES:
            raise TooLargeError(f'more than {MAX_YAML_NODES} nodes, aliases counted as often as they stand there')


def read_yaml(path: Path) -> Any:
    """What a YAML file holds. Raises OSError, yaml.YAMLError or ValueError."""
    return yaml_from(read_regular(path, MAX_YAML_BYTES))


def read_json(path: Path, most: int = MAX_JSON_BYTES) -> Any:
    """What a JSON file holds. Raises OSError or ValueError."""
    content = read_regular(path, most)
    try:
        return json.loads(content)
    except RecursionError as error:
        raise TooLargeError('nested too deeply') from error


def tensor_shapes(path: Path, most: int) -> dict[str, tuple[int, ...]]:
    """The names and shapes of the tensors in a safetensors file, of which only the header is read.

    Raises OSError, or ValueError for a header that is too long or does not describe the file.
    """
    with BoundedFile(path, MAX_HEADER_BYTES) as file:
        if file.size > most:
            raise OSError(errno.EFBIG, f'has {file.size} bytes, and no more than {most} are read', str(path))
        length = int.from_bytes(file.read(8), 'little')
        if not 2 <= length <= min(MAX_HEADER_BYTES, file.size - 8):
            raise TooLargeError(f'a header of {length} bytes in a file of {file.size}')
        try:
            header = json.loads(file.read(length))
            entries = {name: entry for name, entry in header.items() if name != '__metadata__'}
            shapes = {name: tuple(int(side) for side in entry['shape']) for name, entry in entries.items()}
            end = max((int(entry['data_offsets'][1]) for entry in entries.values()), default=0)
        except (RecursionError, TypeError, KeyError, IndexError, AttributeError, OverflowError) as error:
            raise ValueError(f'not the header of a safetensors file: {error!r}') from error
        if 8 + length + end != file.size:
            raise ValueError(f'{file.size} bytes, where its header describes {8 + length + end}')
    return shapes


class Allowance:
    """How much the content of a file may grow when it is unpacked, by the size of the file."""

    def __init__(self, packed_bytes: int) -> None:
        self.bytes = UNPACKED_FLOOR_BYTES + UNPACKED_RATIO * packed_bytes
        self.messages = MESSAGES_FLOOR + int(MESSAGES_PER_BYTE * packed_bytes)
        self.packed_bytes = packed_bytes

    def spend(self, unpacked_bytes: int, messages: int = 0) -> None:
        """Raises TooLargeError when more is spent than is allowed."""
        self.bytes -= unpacked_bytes
        self.messages -= messages
        if self.bytes < 0 or self.messages < 0:
            what = 'bytes' if self.bytes < 0 else 'messages'
            raise TooLargeError(f'its {self.packed_bytes} bytes unpack to implausibly many {what}')
