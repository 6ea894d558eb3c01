"""New bags out of old ones: a stretch of time, some topics, or several bags as one."""

from __future__ import annotations

import heapq
import shutil
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any

from rosbags.rosbag2 import Reader

from raw2drive_ros.recording.bag_info import provenance_of
from raw2drive_ros.recording.bag_reader import BagError, begin_ns, messages_in, open_bag, said_once
from raw2drive_ros.recording.bag_writer import BagWriter


@contextmanager
def whole_bag(out: Path, facts: dict[str, str]) -> Iterator[BagWriter]:
    """A writer whose bag appears when the block is left without an error, and of which nothing stays otherwise."""
    writer = BagWriter(out, facts)
    try:
        yield writer
        writer.close()
    except BaseException:
        writer.abort()
        shutil.rmtree(writer.root, ignore_errors=True)
        raise


def cut(
    bag: Path, out: Path, start_s: float = 0.0, end_s: float = float('inf'), patterns: tuple[str, ...] = ('*',)
) -> dict[str, int]:
    """Messages of the topics that match, from `start_s` to before `end_s` after the bag's beginning, into a new bag.

    What is said once (routes, mounting poses) comes along from before. Returns messages per topic. Raises BagError.
    """
    if not start_s < end_s:
        raise BagError(f'nothing lies between {start_s} s and {end_s} s')
    with open_bag(bag) as reader:
        begins_ns = begin_ns(reader)
        start_ns, end_ns = begins_ns + start_s * 1e9, begins_ns + end_s * 1e9
        facts = provenance_of(bag) | {'cut_from': bag.name, 'cut': f'{start_s:g} s to {end_s:g} s'}
        latched: dict[str, tuple[Any, bytes]] = {}
        with whole_bag(out, facts) as writer:
            for connection, stamp_ns, data in messages_in(reader):
                if not any(fnmatchcase(connection.topic, pattern) for pattern in patterns) or stamp_ns >= end_ns:
                    continue
                if stamp_ns < start_ns:
                    if said_once(connection):
                        latched[connection.topic] = connection, bytes(data)
                    continue
                for topic, (source, old) in latched.items():
                    writer.write_raw(topic, round(start_ns), old, _type_of(source))
                latched.clear()
                writer.write_raw(connection.topic, stamp_ns, bytes(data), _type_of(connection))
            for topic, (source, old) in latched.items() if start_ns <= reader.end_time else ():
                writer.write_raw(topic, round(start_ns), old, _type_of(source))
            if not writer.counts:
                raise BagError(f'{bag}: no message there: it lasts {(reader.end_time - begins_ns) * 1e-9:.1f} s')
            return dict(writer.counts)


def merge(bags: list[Path], out: Path) -> dict[str, int]:
    """All messages of all bags in order of time; returns messages per topic. Raises BagError."""
    with ExitStack() as stack:
        readers = [stack.enter_context(open_bag(bag)) for bag in bags]
        types: dict[str, str] = {}
        for bag, reader in zip(bags, readers, strict=True):
            for connection in reader.connections:
                if types.setdefault(connection.topic, connection.msgtype) != connection.msgtype:
                    raise BagError(
                        f'{bag}: {connection.topic} is {connection.msgtype}, elsewhere {types[connection.topic]}'
                    )
        facts = {'merged_from': ', '.join(bag.name for bag in bags)}
        for number, bag in enumerate(bags):
            facts |= {f'{number}_{key}': value for key, value in provenance_of(bag).items()}
        with whole_bag(out, facts) as writer:
            streams = [_stream(reader, number) for number, reader in enumerate(readers)]
            for stamp_ns, _, _, connection, data in heapq.merge(*streams, key=lambda item: item[:3]):
                writer.write_raw(connection.topic, stamp_ns, data, _type_of(connection))
            return dict(writer.counts)


def _stream(reader: Reader, number: int) -> Iterator[tuple[int, int, int, Any, bytes]]:
    for count, (connection, stamp_ns, data) in enumerate(messages_in(reader)):
        yield stamp_ns, number, count, connection, bytes(data)


def _type_of(connection: Any) -> tuple[str, str]:
    return connection.msgtype, connection.msgdef.data
