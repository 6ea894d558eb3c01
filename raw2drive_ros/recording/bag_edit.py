"""Makes new bags from existing ones: a time range, some topics, or several bags merged into one."""

from __future__ import annotations

import heapq
import itertools
import shutil
from collections import Counter
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any

from rosbags.rosbag2 import Reader

from raw2drive_ros.contracts import topics
from raw2drive_ros.contracts.errors import BagError
from raw2drive_ros.recording.bag_info import provenance_of
from raw2drive_ros.recording.bag_reader import begin_ns, is_latched, messages_in, open_bag
from raw2drive_ros.recording.bag_writer import BagWriter
from raw2drive_ros.recording.copying import Account, Copier, verify

# Ten years: no wall clock shows a time so close to 1970, and no simulation runs for so long.
SIMULATED_BELOW_NS = 10 * 365 * 86_400 * 10**9
# Topics with one message per stamp. Not so commands: a gate repeats one under its stamp, but without its action.
ONE_PER_STAMP = frozenset(
    spec.name
    for spec in topics.TOPICS
    if not spec.qos.latched and spec.name not in (topics.CLOCK, topics.DIAGNOSTICS, topics.PROPOSED, topics.COMMAND)
)


@contextmanager
def whole_bag(out: Path, metadata: dict[str, str]) -> Iterator[BagWriter]:
    """A writer whose bag appears if the block ends without an error; otherwise nothing of it stays."""
    writer = BagWriter(out, metadata)
    try:
        yield writer
        writer.close()
    except BaseException:
        writer.abort()
        shutil.rmtree(writer.root, ignore_errors=True)
        raise


def cut(
    bag: Path,
    out: Path,
    start_s: float = 0.0,
    end_s: float = float('inf'),
    patterns: tuple[str, ...] = ('*',),
    account: Account | None = None,
) -> dict[str, int]:
    """Copy messages of the matching topics, from `start_s` to before `end_s` after the bag's beginning, to a new bag.

    The last latched messages (routes, mounting poses) from before `start_s` are included. Messages that cannot be
    decoded are left out; `account` says how many. The new bag is read again before this returns the number of its
    messages per topic. Raises BagError.
    """
    if not 0.0 <= start_s < end_s:
        raise BagError(f'nothing lies between {start_s:g} s and {end_s:g} s: give 0 <= --start < --end')
    with open_bag(bag) as reader:
        _require_messages(bag, reader)
        idle = [p for p in patterns if not any(fnmatchcase(c.topic, p) for c in reader.connections)]
        if idle:
            raise BagError(f'{bag}: no topic matches {", ".join(idle)}; `raw2drive bag info` lists them')
        matching = [c for c in reader.connections if any(fnmatchcase(c.topic, pattern) for pattern in patterns)]
        begins_ns = begin_ns(reader)
        # In integer nanoseconds: a float64 of nanoseconds since 1970 is off by up to 128.
        lasts_s = (reader.end_time - begins_ns) * 1e-9
        start_ns = begins_ns + round(min(start_s, lasts_s + 1.0) * 1e9)
        end_ns = reader.end_time + 1 if end_s > lasts_s else begins_ns + round(end_s * 1e9)
        metadata = provenance_of(bag) | {'cut_from': bag.name, 'cut': f'{start_s:g} s to {end_s:g} s'}
        latched: dict[str, tuple[Any, bytes]] = {}
        with whole_bag(out, metadata) as writer:
            copier = Copier(writer, account or Account())
            for connection, stamp_ns, data in messages_in(reader, any_type=True, connections=matching):
                if stamp_ns >= end_ns:
                    continue
                if stamp_ns < start_ns:
                    if is_latched(connection):
                        latched[connection.topic] = connection, bytes(data)
                    continue
                for source, old in latched.values():
                    _copy(copier, source, start_ns, old)
                latched.clear()
                _copy(copier, connection, stamp_ns, bytes(data))
            for source, old in latched.values() if start_ns <= reader.end_time else ():
                _copy(copier, source, start_ns, old)
            if not writer.counts:
                left = '; '.join(copier.account.lines())
                raise BagError(f'{bag}: no message there: it lasts {lasts_s:.1f} s' + (f'; {left}' if left else ''))
    verify(out, copier)
    return dict(copier.account.counts)


@dataclass(frozen=True, slots=True)
class Merged:
    """counts: messages per topic in the new bag. doubled: messages dropped because another bag held a copy. account:
    what else was left out."""

    counts: dict[str, int]
    doubled: int
    account: Account


def merge(bags: list[Path], out: Path) -> Merged:
    """Merge all messages in order of time, keeping one copy of those that several bags hold.

    Messages that cannot be decoded are left out. The new bag is read again before this returns. Raises BagError, also
    when the bags are not of one drive: different clocks, or different sensor messages with one stamp.
    """
    with ExitStack() as stack:
        readers = [stack.enter_context(open_bag(bag)) for bag in bags]
        types: dict[str, str] = {}
        for bag, reader in zip(bags, readers, strict=True):
            for connection in reader.connections:
                if types.setdefault(connection.topic, connection.msgtype) != connection.msgtype:
                    raise BagError(
                        f'{bag}: {connection.topic} is {connection.msgtype}, elsewhere {types[connection.topic]}'
                    )
        for bag, reader in zip(bags, readers, strict=True):
            _require_messages(bag, reader)
        _require_one_clock(bags, readers)
        metadata = {'merged_from': ', '.join(bag.name for bag in bags)}
        for number, bag in enumerate(bags):
            metadata |= {f'{number}_{key}': value for key, value in provenance_of(bag).items()}
        doubled = 0
        with whole_bag(out, metadata) as writer:
            copier = Copier(writer, Account())
            streams = [_stream(reader, number) for number, reader in enumerate(readers)]
            merged = heapq.merge(*streams, key=lambda item: item[:3])
            for stamp_ns, together in itertools.groupby(merged, key=lambda item: item[0]):
                seen: dict[tuple[str, bytes], Counter[int]] = {}
                says: dict[str, int] = {}
                for _, number, _, connection, data in together:
                    topic = connection.topic
                    copies = seen.setdefault((topic, data), Counter())
                    copies[number] += 1
                    # Keep as many copies as the bag with most of them has; within a stamp, bags follow one another.
                    if copies[number] <= max((n for bag, n in copies.items() if bag != number), default=0):
                        doubled += 1
                        continue
                    if topic in ONE_PER_STAMP and says.setdefault(topic, number) != number:
                        raise BagError(
                            f'{bags[number]} and {bags[says[topic]]}: different {topic} at {stamp_ns} ns: '
                            'these are different drives, which cannot be one bag'
                        )
                    _copy(copier, connection, stamp_ns, data)
            if not writer.counts:
                raise BagError(f'{bags[0]}: no message can be decoded: {"; ".join(copier.account.lines())}')
    verify(out, copier)
    return Merged(dict(copier.account.counts), doubled, copier.account)


def _require_messages(bag: Path, reader: Reader) -> None:
    if not reader.message_count:
        raise BagError(f'{bag}: holds no messages')


def _require_one_clock(bags: list[Path], readers: list[Reader]) -> None:
    begins = [begin_ns(reader) for reader in readers]
    simulated = [bag for bag, begin in zip(bags, begins, strict=True) if begin < SIMULATED_BELOW_NS]
    if simulated and len(simulated) < len(bags):
        other = next(bag for bag in bags if bag not in simulated)
        raise BagError(f'{simulated[0]} counts simulated time and {other} that of the wall: they cannot be one bag')


def _stream(reader: Reader, number: int) -> Iterator[tuple[int, int, int, Any, bytes]]:
    for count, (connection, stamp_ns, data) in enumerate(messages_in(reader, any_type=True)):
        yield stamp_ns, number, count, connection, bytes(data)


def _copy(copier: Copier, connection: Any, stamp_ns: int, data: bytes) -> None:
    copier.write(connection.topic, stamp_ns, data, connection.msgtype, connection.msgdef)
