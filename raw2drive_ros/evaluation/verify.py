"""Verification by replay: does a bundle, given the sensor data of a bag, decide what was recorded there?"""

from __future__ import annotations

from bisect import bisect_left, bisect_right
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from msg_adapters.commands import decision_from_message
from msg_adapters.factory import RosbagsFactory
from raw2drive_ros.contracts import topics
from raw2drive_ros.contracts.errors import BagError, ContractError
from raw2drive_ros.contracts.public import Control, Decision, SensorFrame
from raw2drive_ros.driving.bundle import load_bundle
from raw2drive_ros.driving.continuity import follows
from raw2drive_ros.driving.raw_driver import RawDriver
from raw2drive_ros.recording.bag_info import provenance_of
from raw2drive_ros.recording.bag_reader import decoded, messages_in, open_bag
from raw2drive_ros.recording.line_reader import AnyReader, time_lines
from raw2drive_ros.recording.ticks import BagTick, read_ticks

FIELDS = ('throttle', 'brake', 'steer', 'reverse')
# Ticks without a recorded decision that are kept: if the decisions are found to be lost, their belief has to advance.
MAX_WAITING = 50


@dataclass(frozen=True, slots=True)
class Verification:
    """compared: decisions that were recorded and made again. left_out: ticks at which nothing was decided. differing:
    number of differences by field; mean_difference: their mean size. first: the first decision that differs: its stamp,
    field, both values. text: the verdict in a sentence. drives: time lines in the bag, each verified by itself. lost:
    decisions that were made and are not in the bag, by their counters. not_compared: recorded decisions of a belief
    that cannot be known from the bag, because sensor data or decisions before them are missing.
    """

    equal: bool
    compared: int
    left_out: int
    differing: dict[str, int]
    mean_difference: dict[str, float]
    first: dict[str, Any] | None
    text: str
    drives: int = 1
    lost: int = 0
    not_compared: int = 0


@dataclass(frozen=True, slots=True)
class Proposal:
    """What was proposed for a stamp. first, last: its counters (1, 2, 3 ... within a planner's process), more than one
    where the planner repeated itself; None in bags of older versions, which hold none."""

    control: Control
    first: int | None
    last: int | None


def _proposals(reader: AnyReader) -> tuple[dict[int, Proposal], int]:
    """(stamp -> proposal, number of messages that are no proposal: values that are not finite, missing names)."""
    factory = RosbagsFactory()
    found: dict[int, Proposal] = {}
    refused = 0
    connections = [c for c in reader.connections if c.topic == topics.PROPOSED]
    # An empty list of connections would select all of them.
    for connection, _, data in messages_in(reader, connections=connections) if connections else ():
        try:
            decision = decision_from_message(decoded(factory, reader, connection, data))
        except ContractError:
            refused += 1
            continue
        number = decision.sequence or None
        before = found.get(decision.stamp_ns)
        first = before.first if before is not None and before.first is not None else number
        found[decision.stamp_ns] = Proposal(decision.control, first, number)
    return found, refused


def recorded_proposals(bag: Path) -> dict[int, Control]:
    """stamp -> control of every proposal in a bag. Raises BagError when it has none."""
    with open_bag(bag) as reader:
        found, _ = _proposals(reader)
    if not found:
        raise BagError(f'{bag}: has no {topics.PROPOSED}; record a drive of the raw policy')
    return {stamp_ns: proposal.control for stamp_ns, proposal in found.items()}


@dataclass(slots=True)
class _Tally:
    """What all time lines of a bag add up to."""

    compared: int = 0
    left_out: int = 0
    changed: int = 0
    lost: int = 0
    not_compared: int = 0
    refused: int = 0
    differences: dict[str, list[float]] = field(default_factory=lambda: {name: [] for name in FIELDS})
    first: dict[str, Any] | None = None

    def compare(self, recorded: Control, decision: Decision) -> None:
        self.compared += 1
        self.changed += decision.control != recorded
        for name in FIELDS:
            old, new = getattr(recorded, name), getattr(decision.control, name)
            if old != new:
                self.differences[name].append(abs(float(new) - float(old)))
                where = {'stamp_ns': decision.stamp_ns, 'field': name, 'recorded': old, 'now': new}
                self.first = self.first or where


class _Follower:
    """Drives one time line again. `known`: whether the driver's belief is the planner's at this moment."""

    def __init__(self, driver: RawDriver, proposals: dict[int, Proposal], tally: _Tally, *, afresh: bool) -> None:
        self.driver, self.proposals, self.tally = driver, proposals, tally
        self.stamps = sorted(proposals)
        self.afresh = afresh
        self.known = True
        self.counter: int | None = None
        self.decided: BagTick | None = None
        self.before: BagTick | None = None
        # Ticks since the last recorded decision, the first MAX_WAITING of them.
        self.waiting: list[BagTick] = []
        self.waited = 0
        driver.reset()

    def take(self, tick: BagTick) -> None:
        recorded = self.proposals.get(tick.stamp_ns)
        if recorded is None:
            self.waited += 1
            if len(self.waiting) < MAX_WAITING:
                self.waiting.append(tick)
        else:
            self._follow(tick, recorded)
            if self.known:
                self.tally.compare(recorded.control, self._drive(tick))
            else:
                self.tally.not_compared += 1
            self.counter, self.decided = recorded.last, tick
            self.waiting, self.waited = [], 0
        self.before = tick

    def end(self) -> None:
        """After the last tick."""
        self.tally.left_out += self.waited

    def _follow(self, tick: BagTick, recorded: Proposal) -> None:
        """Bring the driver's belief to where the planner's was at this tick, or find that it cannot be known."""
        unseen, lost = self._missing(tick, recorded)
        self.tally.lost += lost
        self.tally.left_out += max(0, self.waited - lost)
        if self.counter is not None and recorded.first is not None and recorded.first <= self.counter:
            # Another planner process, which knows nothing of the drive so far.
            self.driver.reset()
            self.known = True
        if not unseen and lost and lost == self.waited == len(self.waiting):
            # At every one of these ticks a decision was made: the belief advanced as at those that were recorded.
            for waiting in self.waiting if self.known else ():
                self._drive(waiting)
            lost = 0
        if self._begins(tick, recorded, certain=not unseen and not lost):
            if not self.known:
                self.driver.reset()
            self.known = True
        elif unseen or lost or self.decided is None:
            self.known = False

    def _missing(self, tick: BagTick, recorded: Proposal) -> tuple[int, int]:
        """Since the last decision: (decisions on ticks that the bag does not hold whole, decisions not in the bag)."""
        if recorded.first is None or (self.decided is not None and self.counter is None):
            # Without counters nothing is known of what is missing.
            return 0, 0
        low = 0 if self.decided is None else bisect_right(self.stamps, self.decided.stamp_ns)
        unseen = [self.proposals[s] for s in self.stamps[low : bisect_left(self.stamps, tick.stamp_ns)]]
        if self.counter is None:
            # What was decided before the bag began is not lost.
            return len(unseen), 0
        since = self.counter if recorded.first > self.counter else 0
        there = sum(p.last - p.first + 1 for p in unseen if p.first is not None and p.last is not None)
        return len(unseen), max(0, recorded.first - 1 - since - there)

    def _begins(self, tick: BagTick, recorded: Proposal, *, certain: bool) -> bool:
        """Whether the planner forgot everything before it decided at this tick, or had nothing to forget.

        certain: every decision since the last one is in the bag.
        """
        if tick.route.stamp_ns >= tick.stamp_ns:
            return True
        if self.decided is None:
            return certain and (recorded.first in (None, 1) or self.afresh)
        if certain:
            new_route = tick.route.stamp_ns != self.decided.route.stamp_ns
            return new_route or not follows(self.decided.stamp_ns, tick.stamp_ns)
        before = self.before
        continues = before is not None and follows(before.stamp_ns, tick.stamp_ns)
        return continues and before is not None and tick.route.stamp_ns != before.route.stamp_ns

    def _drive(self, tick: BagTick) -> Decision:
        return self.driver.drive(SensorFrame(tick.stamp_ns, tick.images, tick.imu, tick.odometry), tick.route)


def verify_bag(bag: Path, bundle: Path) -> Verification:
    """Compare bit for bit, and name the first difference. Raises BagError or BundleError."""
    driver = RawDriver(load_bundle(bundle))
    tally = _Tally()
    with open_bag(bag) as reader:
        lines = time_lines(reader)
        proposals = [_proposals(line) for line in lines]
        tally.refused = sum(refused for _, refused in proposals)
        if not any(found for found, _ in proposals):
            raise BagError(f'{bag}: has no {topics.PROPOSED}; record a drive of the raw policy')
        went_back = provenance_of(bag).get('began', '').startswith('time went back')
        for number, (line, (found, _)) in enumerate(zip(lines, proposals, strict=True)):
            # A planner starts anew when time goes back.
            follower = _Follower(driver, found, tally, afresh=went_back or number > 0)
            for tick in read_ticks(line, bag, cameras=True, privileged=False):
                follower.take(tick)
            follower.end()
    differing = {name: len(found) for name, found in tally.differences.items() if found}
    mean = {name: sum(found) / len(found) for name, found in tally.differences.items() if found}
    return Verification(
        tally.first is None and tally.compared > 0,
        tally.compared,
        tally.left_out,
        differing,
        mean,
        tally.first,
        _text(tally, differing, mean, len(lines)),
        len(lines),
        tally.lost,
        tally.not_compared,
    )


def _text(tally: _Tally, differing: dict[str, int], mean: dict[str, float], drives: int) -> str:
    rest = f'; {tally.left_out} ticks have no recorded decision' if tally.left_out else ''
    if tally.lost:
        rest += f'; lost {tally.lost} proposals: they were made and are not in the bag'
    if tally.not_compared:
        rest += f'; {tally.not_compared} decisions not compared: what the planner knew at them is not in the bag'
    if tally.refused:
        rest += f'; {tally.refused} messages on {topics.PROPOSED} are no proposals'
    if drives > 1:
        rest += f'; time goes back in this bag: {drives} drives, each by itself'
    if not tally.compared:
        return f'nothing could be compared: no decision with its sensor data{rest}'
    if tally.first is None:
        return f'{tally.compared} decisions are equal, bit for bit{rest}'
    fields = ', '.join(f'{name} {count} times by {mean[name]:.2f} on average' for name, count in differing.items())
    first = tally.first
    where = (
        f'first {topics.PROPOSED} at {first["stamp_ns"]} ns: {first["field"]} {first["recorded"]} recorded, '
        f'{first["now"]} now'
    )
    return f'{tally.changed} of {tally.compared} decisions differ: {fields}; {where}{rest}'
