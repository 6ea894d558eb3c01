"""The time lines of a bag, each of which reads like a bag: readers take them one after the other and mix no drives."""

from __future__ import annotations

import itertools
from array import array
from collections.abc import Collection, Iterator

from rosbags.interfaces import Connection

from raw2drive_ros.contracts import topics
from raw2drive_ros.recording.bag_reader import begin_ns, is_latched, messages_in
from raw2drive_ros.recording.bounded_bag import BoundedReader
from raw2drive_ros.recording.stamped_mcap import ARRIVAL, StampedMcapReader
from raw2drive_ros.recording.time_lines import BACK_NS, NEAR_NS, SOURCES, TimeLines, stamp_of

SAMPLE = 300


class TimeLine:
    """One time line of a bag, with the reading half of a rosbags Reader: messages in the order in which they arrived.

    Their times are their own stamps, whatever log_time says; latched messages, diagnostics and stamps that tell no time
    get the time of their neighbours. A line begins with the latest latched messages from before it: the route of a new
    drive may have come just before time went back. `connections` are those of the whole bag.
    """

    def __init__(self, reader: BoundedReader, number: int, lines: array[int], span: tuple[int, int]) -> None:
        self.reader, self.number, self.lines = reader, number, lines
        self.path, self.connections = reader.path, reader.connections
        self.start_time, self.end_time = span[0], span[1] + 1
        self.message_count = sum(1 for line in lines if line == number)

    def messages(
        self, connections: Collection[Connection] = (), start: int | None = None, stop: int | None = None
    ) -> Iterator[tuple[Connection, int, bytes]]:
        wanted = {c.id for c in connections or self.connections}
        newest_ns = self.start_time
        latched: dict[str, tuple[Connection, bytes]] = {}
        for line, (connection, _, data) in zip(self.lines, self.reader.arrivals(), strict=True):
            if line > self.number:
                return
            if line < self.number:
                if connection.id in wanted and _is_kept(connection):
                    latched[connection.topic] = connection, data
                continue
            for kept, said in latched.values() if (start or 0) <= self.start_time else ():
                yield kept, self.start_time, said
            latched.clear()
            stamp_ns = stamp_of(connection.msgtype, data)
            if stamp_ns is not None and connection.topic in SOURCES and stamp_ns > 0:
                newest_ns = stamp_ns
            elif stamp_ns is None or stamp_ns <= 0 or abs(stamp_ns - newest_ns) > NEAR_NS:
                stamp_ns = newest_ns
            if connection.id in wanted and (start or 0) <= stamp_ns and (stop is None or stamp_ns < stop):
                yield connection, stamp_ns, data


def _is_kept(connection: Connection) -> bool:
    spec = topics.BY_NAME.get(connection.topic)
    return is_latched(connection) or (spec is not None and spec.qos.latched)


AnyReader = BoundedReader | TimeLine


def time_lines(reader: BoundedReader) -> list[AnyReader]:
    """The time lines of an open bag: the reader itself where there is one and its times are the stamps.

    Bags of this package's recorder have one, which is known without reading them; others are read once. Raises BagError
    for damaged data.
    """
    if reader.stamped or (_logs_stamps(reader) and not _goes_back(reader)):
        return [reader]
    splitter: TimeLines[int] = TimeLines()
    lines: array[int] = array('I')
    spans: dict[int, tuple[int, int]] = {}
    away = heard = 0

    def assign(decided: list[tuple[int, int]]) -> None:
        for line, index in decided:
            lines[index] = line

    stamps: array[int] = array('q')
    for index, (connection, log_ns, data) in enumerate(messages_in(reader, any_type=True, start=ARRIVAL)):
        stamp_ns = stamp_of(connection.msgtype, data)
        tells = stamp_ns is not None and stamp_ns > 0 and connection.topic in SOURCES
        heard += tells
        away += tells and abs(log_ns - (stamp_ns or 0)) > NEAR_NS
        lines.append(0)
        stamps.append(stamp_ns if tells and stamp_ns is not None else 0)
        assign(splitter.feed(connection.topic, stamp_ns, index))
    assign(splitter.finish())
    for line, stamp_ns in zip(lines, stamps, strict=True):
        if stamp_ns:
            low, high = spans.get(line, (stamp_ns, stamp_ns))
            spans[line] = min(low, stamp_ns), max(high, stamp_ns)
    if splitter.line == 0 and 2 * away <= heard:
        return [reader]
    return [TimeLine(reader, line, lines, span) for line, span in sorted(spans.items())] or [reader]


def lasts_s(lines: list[AnyReader]) -> float:
    """Seconds that all lines last together, each from its first message that is not latched."""
    return sum((line.end_time - begin_ns(line)) * 1e-9 for line in lines)


def _logs_stamps(reader: BoundedReader) -> bool:
    """Whether log_time is the stamp itself, by the first messages."""
    told = [
        (log_ns, stamp_of(connection.msgtype, data))
        for connection, log_ns, data in itertools.islice(messages_in(reader, any_type=True, start=ARRIVAL), SAMPLE)
        if connection.topic in SOURCES
    ]
    return bool(told) and all(log_ns == stamp_ns for log_ns, stamp_ns in told)


def _goes_back(reader: BoundedReader) -> bool:
    """Whether the log times of a topic that tells the time go back as written; True where no index tells."""
    newest: dict[str, int] = {}
    for storage in getattr(reader.storage, 'storages', [reader.storage]):
        if not isinstance(storage, StampedMcapReader) or not storage.chunks:
            return True
        for topic, times in storage.indexed_times():
            if topic not in SOURCES:
                continue
            for time_ns in times:
                if time_ns < newest.get(topic, time_ns) - BACK_NS:
                    return True
                newest[topic] = max(newest.get(topic, time_ns), time_ns)
        if storage.unindexed:
            return True
    return False
