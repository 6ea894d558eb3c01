"""Bags back into decision ticks: what belongs to one stamp, what is missing, and where a sequence is broken."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from msg_adapters.factory import RosbagsFactory
from msg_adapters.privileged import (
    advice_from_message,
    bev_from_message,
    ego_from_message,
    signals_from_message,
    transition_from_message,
)
from msg_adapters.privileged_actors import actors_from_message
from msg_adapters.stamps import stamp_ns
from raw2drive_ros.contracts import topics
from raw2drive_ros.contracts.errors import BagError, ContractError
from raw2drive_ros.contracts.privileged import Advice, PrivilegedFrame, Transition
from raw2drive_ros.contracts.public import CameraCalibration, Image8, ImuSample, OdometrySample, Route
from raw2drive_ros.contracts.verdicts import Verdicts
from raw2drive_ros.driving.continuity import BACK_NS, follows
from raw2drive_ros.driving.planner_inputs import PlannerInputs
from raw2drive_ros.recording.bag_reader import decoded, messages_in
from raw2drive_ros.recording.line_reader import AnyReader
from raw2drive_ros.tables.rates import DECISION_NS

# Incomplete ticks that are kept for the rest of their messages, and samples of IMU and odometry: a recording in which
# no tick ever completes is read in bounded memory. A planner waits for four.
PENDING_TICKS = 16
MOTION_SAMPLES = 512
CHECKS: dict[str, Callable[[Any], Any]] = {
    topics.BEV: bev_from_message,
    topics.BEV_VISIBLE: bev_from_message,
    topics.SIGNALS: signals_from_message,
    topics.ACTORS: actors_from_message,
    topics.EGO: ego_from_message,
    topics.TRANSITION: transition_from_message,
    topics.ADVICE: advice_from_message,
}
# What makes a tick of training, beside the sensors.
PRIVILEGED = (topics.BEV, topics.EGO, topics.TRANSITION)
# What a reader may ask for besides; old bags lack it.
EXTRAS = (topics.BEV_VISIBLE, topics.SIGNALS, topics.ACTORS)


@dataclass(slots=True)
class BagTick:
    """One decision tick read back from a bag; cameras only where the bag has them.

    starts_segment: nothing is carried over from the tick before (`driving.continuity`); also true at the first tick of
    an episode and of the bag. starts_episode: the first tick of its episode that is there.
    """

    stamp_ns: int
    images: dict[str, Image8]
    imu: ImuSample
    odometry: OdometrySample
    route: Route
    privileged: PrivilegedFrame | None
    transition: Transition | None
    episode: str
    starts_segment: bool = False
    starts_episode: bool = False


@dataclass(slots=True)
class TickCounts:
    """What became of the ticks of a bag.

    ticks: complete ones. incomplete: some of their messages are there, others are missing or were refused; of these
    without_route: the messages are there, the route of their episode is not. missing: decision periods in an episode
    of which there is no message. cuts: sequences that had to begin anew at a tick that is not the first of an episode.
    begins_lost, ends_lost: incomplete ticks that were the first of an episode, the last or a terminal one. back: how
    often time went back.
    """

    ticks: int = 0
    incomplete: int = 0
    without_route: int = 0
    missing: int = 0
    cuts: int = 0
    begins_lost: int = 0
    ends_lost: int = 0
    back: int = 0
    verdicts: Verdicts = field(default_factory=Verdicts)

    @property
    def dropped(self) -> int:
        """Ticks that took place and are not used."""
        return self.incomplete + self.missing


@dataclass(frozen=True, slots=True)
class _Last:
    """The last tick that was delivered."""

    stamp_ns: int
    episode: str
    ended: bool
    route_ns: int


class TickAssembler:
    """Collects samples by stamp; `take` hands out the ticks that are complete, in order. A `Receiver` of samples.

    Takes every picture, whatever its rate, and none of a lens with distortion: it has no cameras to rectify to. Where
    an episode begins and ends is read from every transition, also those of ticks that never become complete.
    extras: of `EXTRAS`, without which a privileged tick is not complete either.
    """

    def __init__(
        self, cameras: tuple[str, ...], counts: TickCounts, *, privileged: bool, extras: Collection[str] = ()
    ) -> None:
        self.cameras, self.counts, self.privileged = cameras, counts, privileged
        self.calibrations: dict[str, CameraCalibration] = {}
        self.rig: tuple[CameraCalibration, ...] = ()
        self.taken_ns: int | None = None
        self.needed = len(cameras) + (len(PRIVILEGED) + len(extras) if privileged else 0)
        self.routes: list[Route] = []
        self.imus: dict[int, ImuSample] = {}
        self.odometries: dict[int, OdometrySample] = {}
        self.pending: dict[int, dict[str, Any]] = {}
        self.ready: list[BagTick] = []
        self.last: _Last | None = None
        # Since the last tick: ticks that were dropped, and whether an episode began or ended with one of them.
        self.dropped, self.boundary = 0, False

    def take(self) -> list[BagTick]:
        """The ticks that have become complete since the last call."""
        found, self.ready = self.ready, []
        return found

    def finish(self) -> None:
        """Count what is incomplete at the end of the bag."""
        for stamp in sorted(self.pending):
            self._drop(stamp)

    # -- samples ------------------------------------------------------------------------------------------

    def add_route(self, route: Route) -> None:
        if self.routes and self.routes[-1].stamp_ns == route.stamp_ns:
            self.routes.pop()
        self.routes = [*self.routes[-1:], route]
        # A planner without a route does not wait for one: what it saw before is gone, and never decided upon.
        for stamp in sorted(self.pending) if self.privileged else ():
            self._complete(stamp)

    def add_calibration(self, calibration: CameraCalibration) -> None:
        self.calibrations[calibration.name] = calibration

    def forget_calibration(self, camera: str) -> None:
        self.calibrations.pop(camera, None)

    def forget_pictures(self) -> None:
        """Nothing: no picture waits to be rectified."""

    def skip_image(self, camera: str, stamp_ns: int, now_ns: int) -> None:
        """Nothing: no picture is left out (`taken_ns`)."""

    def add_image(self, camera: str, stamp_ns: int, image: Image8, now_ns: int) -> None:
        self.add_part(camera, stamp_ns, image)

    def add_imu(self, sample: ImuSample, now_ns: int) -> None:
        self.imus[sample.stamp_ns] = sample
        self._moved(self.imus, sample.stamp_ns)

    def add_odometry(self, sample: OdometrySample, now_ns: int) -> None:
        self.odometries[sample.stamp_ns] = sample
        self._moved(self.odometries, sample.stamp_ns)

    def refuse(self, name: str, why: str, now_ns: int) -> None:
        """Nothing: the message is missing, so its tick stays incomplete."""

    def add_part(self, name: str, stamp_ns: int, value: Any) -> None:
        """A picture by the name of its camera, or a privileged sample by its topic."""
        if self.last is not None and stamp_ns <= self.last.stamp_ns:
            if stamp_ns >= self.last.stamp_ns - BACK_NS:
                # A tick that the bridge sent again.
                return
            self._go_back()
        self.pending.setdefault(stamp_ns, {})[name] = value
        self._complete(stamp_ns)
        while len(self.pending) > PENDING_TICKS:
            self._drop(next(iter(self.pending)))

    def _moved(self, samples: dict[int, Any], stamp_ns: int) -> None:
        self._complete(stamp_ns)
        while len(samples) > MOTION_SAMPLES:
            del samples[next(iter(samples))]

    # -- ticks --------------------------------------------------------------------------------------------

    def _complete(self, stamp_ns: int) -> None:
        """Deliver the tick of that stamp if everything of it is there, and whatever is older is given up."""
        if self.last is not None and stamp_ns <= self.last.stamp_ns:
            return
        if not self._whole(stamp_ns):
            return
        parts = self.pending.get(stamp_ns, {})
        transition, episode = parts.get(topics.TRANSITION, (None, ''))
        older = [parts_of for stamp, parts_of in self.pending.items() if stamp < stamp_ns]
        new_episode = self._begins_episode(transition, episode, older)
        route = self._route_of(stamp_ns, new_episode=new_episode)
        if route is None:
            return
        for stamp in sorted(stamp for stamp in self.pending if stamp < stamp_ns):
            self._drop(stamp)
        self.pending.pop(stamp_ns, None)
        frame = _frame_of(stamp_ns, parts) if self.privileged else None
        images = {camera: parts[camera] for camera in self.cameras}
        self.ready.append(
            BagTick(
                stamp_ns,
                images,
                self.imus[stamp_ns],
                self.odometries[stamp_ns],
                route,
                frame,
                transition,
                episode,
                starts_segment=self._starts_segment(stamp_ns, route, transition, new_episode=new_episode),
                starts_episode=new_episode,
            )
        )
        ended = transition is not None and (transition.is_last or transition.is_terminal)
        self.last = _Last(stamp_ns, episode, ended, route.stamp_ns)
        self.dropped, self.boundary = 0, False
        self.counts.ticks += 1
        self.imus = {s: v for s, v in self.imus.items() if s > stamp_ns}
        self.odometries = {s: v for s, v in self.odometries.items() if s > stamp_ns}

    def _whole(self, stamp_ns: int) -> bool:
        """Whether every message of the stamp is there; the route has no stamp of a tick."""
        parts = self.pending.get(stamp_ns, {})
        return len(parts) >= self.needed and stamp_ns in self.imus and stamp_ns in self.odometries

    def _begins_episode(self, transition: Transition | None, episode: str, older: list[dict[str, Any]]) -> bool:
        if self.last is None:
            return True
        if transition is None:
            return False
        between = self.boundary or any(_is_boundary(parts) for parts in older)
        return transition.is_first or between or self.last.ended or episode != self.last.episode

    def _route_of(self, stamp_ns: int, *, new_episode: bool) -> Route | None:
        """The route of a tick. A planner takes the newest; where episodes are known, it has to be that of the episode,
        which is issued at its beginning: with the one before, the next checkpoints would be of another drive."""
        if not self.routes or not self.privileged:
            return self.routes[-1] if self.routes else None
        route = next((r for r in reversed(self.routes) if r.stamp_ns <= stamp_ns), self.routes[-1])
        old = self.last is not None and new_episode and route.stamp_ns == self.last.route_ns
        return None if old else route

    def _starts_segment(self, stamp_ns: int, route: Route, transition: Transition | None, *, new_episode: bool) -> bool:
        """Also counts what is missing before the tick."""
        if self.last is None:
            return True
        same_drive = not new_episode and route.stamp_ns == self.last.route_ns
        starts = not follows(self.last.stamp_ns, stamp_ns, same_drive=same_drive, complete=not self.dropped)
        if same_drive and self.needed:
            periods = round((stamp_ns - self.last.stamp_ns) / DECISION_NS)
            self.counts.missing += max(0, periods - 1 - self.dropped)
        expected = not same_drive if transition is None else transition.is_first
        self.counts.cuts += starts and not expected
        return starts

    def _drop(self, stamp_ns: int) -> None:
        whole = self._whole(stamp_ns)
        parts = self.pending.pop(stamp_ns)
        self.counts.incomplete += 1
        self.counts.without_route += whole
        self.dropped += 1
        self.boundary |= _is_boundary(parts)
        if topics.TRANSITION in parts:
            transition, _ = parts[topics.TRANSITION]
            self.counts.begins_lost += transition.is_first
            self.counts.ends_lost += transition.is_last or transition.is_terminal

    def _go_back(self) -> None:
        """Time went back: whatever is incomplete stays so. IMU and odometry may already be those of the new time."""
        self.finish()
        self.counts.back += 1
        self.last, self.dropped, self.boundary = None, 0, False


def _is_boundary(parts: dict[str, Any]) -> bool:
    transition = parts[topics.TRANSITION][0] if topics.TRANSITION in parts else None
    return transition is not None and (transition.is_first or transition.is_last or transition.is_terminal)


def _frame_of(stamp_ns: int, parts: dict[str, Any]) -> PrivilegedFrame:
    extras = (parts.get(topic) for topic in (topics.BEV_VISIBLE, topics.ACTORS, topics.SIGNALS))
    return PrivilegedFrame(stamp_ns, parts[topics.BEV], parts[topics.EGO], *extras)


def camera_topics(reader: AnyReader) -> dict[str, str]:
    """topic -> camera for every camera that the bag holds: its raw topic, or else its compressed one."""
    present = {connection.topic for connection in reader.connections}
    found = {}
    for camera in topics.CAMERAS:
        for topic in (topics.image_topic(camera), topics.compressed_topic(camera)):
            if topic in present:
                found[topic] = camera
                break
    return found


def checked_messages(
    reader: AnyReader, factory: RosbagsFactory, wanted: set[str], verdicts: Verdicts
) -> Iterator[tuple[str, int, Any]]:
    """(topic, recorded stamp, message) of the wanted topics; bytes that are no message of their type are refused."""
    connections = [c for c in reader.connections if c.topic in wanted]
    # An empty list of connections would select all of them.
    for connection, recorded_ns, data in messages_in(reader, connections=connections) if connections else ():
        try:
            message = decoded(factory, reader, connection, data)
        except BagError as error:
            why = str(error).removeprefix(f'{reader.path}: {connection.topic}: ')
            verdicts.refuse(connection.topic, recorded_ns, why)
            continue
        yield connection.topic, recorded_ns, message


def checked(topic: str, message: Any, verdicts: Verdicts) -> Any:
    """The content of a privileged message; None for one that is refused."""
    try:
        value = CHECKS[topic](message)
    except ContractError as error:
        verdicts.refuse(topic, stamp_ns(message.header.stamp), str(error))
        return None
    verdicts.accept(topic)
    return value


def read_advice(reader: AnyReader, factory: RosbagsFactory, verdicts: Verdicts | None = None) -> dict[int, Advice]:
    """stamp -> what the expert would do there, in bags that hold it. Refused messages are left out, and counted."""
    verdicts = Verdicts() if verdicts is None else verdicts
    messages = checked_messages(reader, factory, {topics.ADVICE}, verdicts)
    found = (checked(topic, message, verdicts) for topic, _, message in messages)
    return {advice.stamp_ns: advice for advice in found if advice is not None}


def read_ticks(
    reader: AnyReader,
    path: Path,
    *,
    cameras: bool,
    privileged: bool = True,
    counts: TickCounts | None = None,
    extras: Collection[str] = (),
) -> Iterator[BagTick]:
    """Decision ticks in time order. A tick is complete when its last expected message has arrived.

    Messages that break their contract are left out, by the verdict of the planner's own inputs, and their ticks are
    incomplete. counts: is filled while ticks are read. extras: topics of `EXTRAS`, which are read too, and without
    which no tick is complete; the others are None in the privileged frames. Raises BagError, also at the end of a bag
    of which more messages were refused than `contracts.verdicts` allows.
    """
    factory = RosbagsFactory()
    counts = TickCounts() if counts is None else counts
    images = camera_topics(reader) if cameras else {}
    ticks = TickAssembler(tuple(images.values()), counts, privileged=privileged, extras=extras)
    inputs = PlannerInputs(ticks, compressed={c for t, c in images.items() if topics.BY_NAME[t].optional})
    inputs.verdicts = counts.verdicts
    wanted = {*inputs.topics, *((*PRIVILEGED, *extras) if privileged else ())}
    try:
        for topic, recorded_ns, message in checked_messages(reader, factory, wanted, counts.verdicts):
            if topic in inputs.handlers:
                inputs.receive(topic, message, recorded_ns)
            else:
                value = checked(topic, message, counts.verdicts)
                if value is not None:
                    ticks.add_part(topic, stamp_ns(message.header.stamp), value)
            yield from ticks.take()
    except BagError:
        raise
    except Exception as error:
        raise BagError(f'{path}: damaged after {reader.message_count} messages were promised: {error}') from error
    ticks.finish()
    if unusable := counts.verdicts.unusable():
        raise BagError(f'{path}: {unusable}')
