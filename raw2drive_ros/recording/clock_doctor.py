"""What `raw2drive bag doctor` says of the clocks of a bag: time that goes back, stamps that tell no time, clocks that
differ, the delay of reception by topic, and messages whose counters show that others are missing."""

from __future__ import annotations

import itertools
import statistics
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from msg_adapters.commands import SEQUENCE
from msg_adapters.factory import RosbagsFactory
from msg_adapters.named_values import named_values_from_message
from raw2drive_ros.contracts import topics
from raw2drive_ros.contracts.errors import BagError, ContractError
from raw2drive_ros.recording.bag_info import provenance_of
from raw2drive_ros.recording.bag_reader import bag_folder, decoded, messages_in, open_bag
from raw2drive_ros.recording.bounded_bag import BoundedReader
from raw2drive_ros.recording.stamped_mcap import ARRIVAL
from raw2drive_ros.recording.time_lines import NEAR_NS, SOURCES, TimeLines, stamp_of

# Severity, text, remedy: a `bag_doctor.Complaint`.
Finding = tuple[str, str, str]
# A delay is told of these: of a proposal, that from the sensors' moment to its reception.
TIMED = frozenset({*SOURCES, topics.PROPOSED})
# More than this beyond the smallest delay, and simulated time does not run at the wall's pace.
REAL_TIME_NS = 1_000_000_000
# So many delays of a topic are kept, evenly spread, for their median and their 99 % quantile.
MAX_DELAYS = 4096


@dataclass(slots=True)
class _Topic:
    """delays_ns: log_time less stamp, and beside_ns: stamp less the newest stamp of the reference topic, of every
    `every`-th message."""

    messages: int = 0
    negative: int = 0
    without: int = 0
    every: int = 1
    delays_ns: list[int] = field(default_factory=list)
    beside_ns: list[int] = field(default_factory=list)

    def add(self, stamp_ns: int, log_ns: int, reference_ns: int | None) -> None:
        self.messages += 1
        self.negative += stamp_ns < 0
        self.without += stamp_ns == 0
        if stamp_ns <= 0 or self.messages % self.every:
            return
        self.delays_ns.append(log_ns - stamp_ns)
        if reference_ns is not None:
            self.beside_ns.append(stamp_ns - reference_ns)
        if len(self.delays_ns) >= 2 * MAX_DELAYS:
            self.delays_ns, self.beside_ns, self.every = self.delays_ns[::2], self.beside_ns[::2], 2 * self.every


def clock_findings(path: Path) -> list[Finding]:
    """Reads every message once, in the order of arrival. Raises BagError."""
    heard: dict[str, _Topic] = {}
    lines: TimeLines[None] = TimeLines()
    lost: dict[str, int] = {}
    with open_bag(path) as reader:
        reference = _reference(reader)
        reference_ns: int | None = None
        counters = _Counters(reader)
        for connection, log_ns, data in messages_in(reader, any_type=True, start=ARRIVAL):
            stamp_ns = stamp_of(connection.msgtype, data)
            lines.feed(connection.topic, stamp_ns, None)
            counters.hear(connection, data)
            if stamp_ns is None or connection.topic not in TIMED:
                continue
            if connection.topic == reference:
                reference_ns = stamp_ns
            heard.setdefault(connection.topic, _Topic()).add(stamp_ns, log_ns, reference_ns)
        lines.finish()
        stamped, lost = reader.stamped, counters.lost
    return [
        *_of_lines(lines),
        *_of_stamps(heard),
        *_of_clocks(heard),
        *_of_log_time(heard, stamped=stamped),
        *_of_counters(lost),
        *_of_recording(path),
    ]


def _reference(reader: BoundedReader) -> str:
    present = {c.topic for c in reader.connections if c.msgcount}
    return next((name for name in SOURCES if name in present), '')


class _Counters:
    """lost: by topic, how many counters are missing between the messages of one process."""

    def __init__(self, reader: BoundedReader) -> None:
        self.reader, self.factory = reader, RosbagsFactory()
        self.last: dict[str, int] = {}
        self.lost: dict[str, int] = {}

    def hear(self, connection: Any, data: bytes) -> None:
        topic = connection.topic
        if topic not in (topics.PROPOSED, topics.COMMAND) or connection.msgtype != topics.BY_NAME[topic].msgtype:
            return
        try:
            number = named_values_from_message(decoded(self.factory, self.reader, connection, data)).get(SEQUENCE)
        except ContractError:
            return
        if number is None or not 1 <= number < 2**53:
            return
        last = self.last.get(topic)
        if last is not None and number > last + 1:
            self.lost[topic] = self.lost.get(topic, 0) + int(number) - last - 1
        self.last[topic] = int(number)


def _of_lines(lines: TimeLines[None]) -> Iterator[Finding]:
    if lines.began:
        times = 'once' if len(lines.began) == 1 else f'{len(lines.began)} times'
        yield (
            'warning',
            f'time goes back {times} (first: {lines.began[0].removeprefix("time went back ")}): '
            f'{len(lines.began) + 1} drives in one bag',
            'replay takes them one by one; raw2drive record begins a new bag by itself',
        )
    for topic, count in lines.strays.items():
        yield (
            'warning',
            f'{topic}: {count} stamps go back by more than 0.5 s while the other topics go on',
            'do several publishers share the topic, or was its clock set?',
        )


def _of_stamps(heard: dict[str, _Topic]) -> Iterator[Finding]:
    for topic, found in heard.items():
        if found.negative:
            text = f'{topic}: {found.negative} of {found.messages} stamps are negative, and make no tick'
            yield 'error', text, 'set the clock of the node that publishes it'
        if found.without:
            text = f'{topic}: {found.without} of {found.messages} messages have no stamp (0), and make no tick'
            yield 'warning', text, 'stamp every message with the time of its measurement'


def _of_clocks(heard: dict[str, _Topic]) -> Iterator[Finding]:
    """Topics whose stamps are far from those that arrive with them, measured from the clock that most topics have."""
    beside_ns = {name: statistics.median(found.beside_ns) for name, found in heard.items() if found.beside_ns}
    near = {name: sum(abs(ns - other) <= NEAR_NS for other in beside_ns.values()) for name, ns in beside_ns.items()}
    most = max(near, key=lambda name: near[name], default='')
    for topic, found_ns in beside_ns.items():
        away_ns = found_ns - beside_ns[most]
        if abs(away_ns) > NEAR_NS:
            yield (
                'error',
                f'{topic}: stamps are {abs(away_ns) * 1e-9:.0f} s {"after" if away_ns > 0 else "before"} those of '
                f'{most} that arrive with them: two clocks, so no tick is complete',
                'use_sim_time in every node or in none; synchronise the clocks of the machines (chrony, PTP)',
            )


def _of_log_time(heard: dict[str, _Topic], *, stamped: bool) -> Iterator[Finding]:
    delays = {topic: sorted(found.delays_ns) for topic, found in sorted(heard.items()) if found.delays_ns}
    everything = sorted(itertools.chain.from_iterable(delays.values()))
    if not everything or everything[0] == everything[-1] == 0:
        # Written by its maker: there is no reception.
        return
    simulated = abs(_part(everything, 50)) > NEAR_NS
    if simulated:
        how = 'readers here go by the stamps' if stamped else 'replay goes by the stamps, info and cut by log_time'
        text = f'log_time is of another clock than the stamps (simulated time beside that of the wall?): {how}'
        yield 'note', text, 'ros2 bag play plays the recorded /clock'
        if _part(everything, 99) - everything[0] > REAL_TIME_NS:
            text = 'no delay of reception can be read: simulated time does not run at the pace of the wall'
            yield 'note', text, 'record a vehicle, or raw2drive sim --real-time'
            return
    least_ns = everything[0] if simulated else 0
    each = ', '.join(
        f'{topic} {(_part(found, 50) - least_ns) * 1e-6:.0f}/{(_part(found, 99) - least_ns) * 1e-6:.0f}'
        for topic, found in delays.items()
    )
    beyond = ' beyond the smallest one' if simulated else ''
    text = f'received after their stamps{beyond} by so many ms (median/99 %): {each}'
    yield 'note', text, 'negative: the clock of the sensor is ahead of that of the recorder'


def _part(values: list[int], percent: int) -> int:
    """A quantile of sorted values."""
    return values[min(len(values) - 1, len(values) * percent // 100)]


def _of_counters(lost: dict[str, int]) -> Iterator[Finding]:
    for topic, count in lost.items():
        what = 'proposals' if topic == topics.PROPOSED else 'commands'
        yield 'warning', f'lost {count} {what}: counters are missing on {topic}', 'was the recorder overloaded?'


def _of_recording(path: Path) -> Iterator[Finding]:
    provenance = provenance_of(path)
    if provenance.get('begins', '').startswith('in the middle'):
        text = f'the recording begins {provenance["begins"]}: its first tick is not there'
        yield 'note', text, 'start raw2drive record before the drive'
    if provenance.get('began', '').startswith('time went back'):
        yield 'note', f'a part of a recording that began when {provenance["began"]}', 'the part before is beside it'
    folder = bag_folder(path)
    parts = sorted(file.parent.name for file in folder.glob('*/metadata.yaml'))
    if parts:
        yield 'note', f'time went back while it was recorded: other drives are in {", ".join(parts)}', 'bag info'


def clock_complaints(path: Path) -> list[Finding]:
    """As `clock_findings`; a bag that cannot be read as a whole is complained of elsewhere."""
    try:
        return clock_findings(path)
    except BagError:
        return []
