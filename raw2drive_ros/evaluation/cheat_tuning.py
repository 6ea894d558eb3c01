"""Chooses, type by type, how each sightless driver drives best on training routes, under the limits of the rule.

A drive ends when it has failed, a second drive of a pair is skipped when the first is lost, and a profile that differs
from a known one only after the place where that one failed is not driven. All ways are tried on `SCREENED` pairs; the
`KEPT` best of them on the others too, each until it can no longer win more than the best so far.
"""

from __future__ import annotations

import dataclasses
import math
import zlib
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from functools import partial

import numpy as np

from raw2drive_ros.evaluation.cheats import FAMILIES, SCRIPT, Choice, Tuned, Way, best_of, decider
from raw2drive_ros.evaluation.memoriser import Recorded
from raw2drive_ros.evaluation.quick_drive import quick_drive, sensorless_env
from raw2drive_ros.evaluation.reference import ReferenceRunner, References
from raw2drive_ros.evaluation.sightless import Profile, Stop, least_s
from raw2drive_ros.evaluation.suites import LimitRule, Pair, Suite
from raw2drive_ros.evaluation.workers import in_order
from raw2drive_ros.simulation.draws import Draw, Rng
from raw2drive_ros.simulation.environment import DrivingEnv
from raw2drive_ros.simulation.route_id import RouteId
from raw2drive_ros.simulation.scenario import get_scenario
from raw2drive_ros.simulation.world import World

PAIRS = 5
SCREENED, KEPT = 2, 12
REFINEMENTS = 40
# Profiles brake for a stop no earlier than with this deceleration (`following.stopping`), and some room.
SOFTEST_BRAKING_MPS2, ROOM_M = 1.2, 8.0


@dataclass(slots=True)
class Course:
    """A pair to be won. limits_s: of its drives, None for the scenes' own. world: its event, at the start."""

    drives: tuple[RouteId, ...]
    limits_s: tuple[float | None, ...]
    world: World = field(init=False)

    def __post_init__(self) -> None:
        first = self.drives[0]
        self.world = World(get_scenario(first.type), Draw(first.type, first.seed, event=not first.twin))


class Trials:
    """Drives ways of driving over the courses of one type; the same drive is not driven twice."""

    def __init__(self, env: DrivingEnv, courses: Sequence[Course], memories: Sequence[Recorded] = ()) -> None:
        self.env, self.courses, self.memories = env, courses, memories
        self.known: dict[tuple[Way, RouteId], bool] = {}
        # Arc length at which a profile without stops and slow stretches failed.
        self.failed_s_m: dict[tuple[Profile, RouteId], float] = {}

    def wins(self, way: Way, number: int) -> tuple[bool, bool]:
        """(all drives of course `number`, the first of them) won. Ways that the limits rule out are not driven."""
        course = self.courses[number]
        limits = [limit_s for limit_s in course.limits_s if limit_s is not None]
        if limits and isinstance(way, Profile) and least_s(way, course.world) > min(limits):
            return False, False
        first = False
        for place, (route, limit_s) in enumerate(zip(course.drives, course.limits_s, strict=True)):
            if not self._won(way, route, limit_s, course.world):
                return False, first
            first = first or place == 0
        return True, True

    def _won(self, way: Way, route: RouteId, limit_s: float | None, world: World) -> bool:
        key = (way, route)
        if key not in self.known:
            if isinstance(way, Profile) and self._fails_as_before(way, route, world):
                self.known[key] = False
                return False
            verdict = quick_drive(self.env, decider(way, self.memories), route, limit_s)
            self.known[key] = verdict.success
            if isinstance(way, Profile) and not verdict.success and way == _plain(way):
                self.failed_s_m[way, route] = verdict.s_m
        return self.known[key]

    def _fails_as_before(self, way: Profile, route: RouteId, world: World) -> bool:
        """Whether the profile without its stops and slow stretch failed before it would have to brake for them."""
        failed_s_m = self.failed_s_m.get((_plain(way), route))
        return failed_s_m is not None and failed_s_m < differs_s_m(way, world)


def search(family: str, trials: Trials) -> Choice:
    """The way of a family that wins most courses; of equals the one that wins most events, then the first."""
    ways = list(dict.fromkeys(FAMILIES[family].ways()))
    if len(trials.courses) > SCREENED and len(ways) > KEPT:
        ways = _screened(trials, ways)
    best: Way = ways[0]
    score = (-1, -1)
    for way in ways:
        tried = _score(trials, way, score[0])
        if tried > score:
            best, score = way, tried
        if score[0] == len(trials.courses):
            break
    if FAMILIES[family].refined and isinstance(best, Profile):
        best, score = _refine(trials, best, score)
    return Choice(family, best, max(score[0], 0), len(trials.courses))


def _screened(trials: Trials, ways: Sequence[Way]) -> list[Way]:
    """The ways that do best on the first courses, best first; one that wins all courses is enough."""
    scores = []
    for number, way in enumerate(ways):
        score = _score(trials, way, -1, SCREENED)
        if score[0] == SCREENED and _score(trials, way, -1)[0] == len(trials.courses):
            return [way]
        scores.append((*score, -number))
    return [ways[-last] for *_, last in sorted(scores, reverse=True)[:KEPT]]


def _plain(profile: Profile) -> Profile:
    return dataclasses.replace(profile, stops=(), slow=None)


def differs_s_m(profile: Profile, world: World) -> float:
    """Arc length up to which a profile drives as it would without its stops and its slow stretch."""
    start, goal = world.scene.route.start_s_m, world.goal_s_m
    shares = [stop.at for stop in profile.stops] + ([] if profile.slow is None else [profile.slow[0]])
    if not shares:
        return -math.inf
    speed = min(profile.speed_mps, profile.share * float(world.speed_limits.max()))
    return start + min(shares) * (goal - start) - speed * speed / (2.0 * SOFTEST_BRAKING_MPS2) - ROOM_M


def _score(trials: Trials, way: Way, most: int, courses: int | None = None) -> tuple[int, int]:
    """(courses, events) won of the first `courses`; (-1, -1) once it is clear that no more than `most` are."""
    won = events = 0
    count = len(trials.courses) if courses is None else courses
    for number in range(count):
        if most > 0 and won + count - number <= most:
            return -1, -1
        whole, first = trials.wins(way, number)
        won, events = won + whole, events + first
    return won, events


def _refine(trials: Trials, best: Profile, score: tuple[int, int]) -> tuple[Profile, tuple[int, int]]:
    """Tries random changes of the best profile, from one improvement to the next."""
    rng = np.random.default_rng(zlib.crc32(trials.courses[0].drives[0].type.encode())) if trials.courses else None
    for _ in range(REFINEMENTS):
        if rng is None or score[0] == len(trials.courses):
            break
        way = changed(best, rng)
        tried = _score(trials, way, score[0])
        if tried > score:
            best, score = way, tried
    return best, score


def changed(profile: Profile, rng: Rng) -> Profile:
    """A profile that differs in one or two parameters."""
    for _ in range(int(rng.integers(1, 3))):
        kind = int(rng.integers(6))
        if kind == 0:
            profile = dataclasses.replace(profile, share=round(profile.share * float(rng.uniform(0.8, 1.25)), 3))
        elif kind == 1:
            profile = dataclasses.replace(
                profile, wait_s=round(max(0.0, profile.wait_s + float(rng.uniform(-4, 4))), 1)
            )
        elif kind == 2:
            at, for_s = round(float(rng.uniform(0.05, 0.9)), 3), round(float(rng.uniform(1.0, 14.0)), 1)
            kept = profile.stops[1:] if len(profile.stops) > 1 else profile.stops
            stops = tuple(sorted((*kept, Stop(at, for_s)), key=lambda stop: stop.at))
            profile = dataclasses.replace(profile, stops=stops)
        elif kind == 3:
            profile = dataclasses.replace(profile, offset_m=round(float(rng.uniform(-1.2, 1.2)), 2))
        elif kind == 4 and profile.stops:
            moved = tuple(
                Stop(round(s.at + float(rng.uniform(-0.06, 0.06)), 3), round(s.for_s * float(rng.uniform(0.7, 1.4)), 1))
                for s in profile.stops
            )
            profile = dataclasses.replace(profile, stops=moved)
        else:
            begin = float(rng.uniform(0.0, 0.8))
            slow = (round(begin, 3), round(begin + float(rng.uniform(0.1, 0.4)), 3), round(float(rng.uniform(1, 7)), 2))
            profile = dataclasses.replace(profile, slow=slow)
    return profile


# -- over all types ---------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class TuneSettings:
    """pairs: of training routes per type. timed: under the rule's limits, otherwise under the scenes' own."""

    references: References = field(default_factory=References)
    pairs: int = PAIRS
    timed: bool = True
    rule: LimitRule = field(default_factory=LimitRule)


@dataclass(frozen=True, slots=True)
class TypeTuned:
    """What was found for one type."""

    type: str
    choices: dict[str, Choice]
    memories: tuple[Recorded, ...]


@dataclass(slots=True)
class _Tuner:
    env: DrivingEnv
    references: ReferenceRunner
    settings: TuneSettings


def _make_tuner(settings: TuneSettings) -> _Tuner:
    return _Tuner(sensorless_env(), ReferenceRunner(settings.references), settings)


def tune(
    train: Suite,
    types: Iterable[str],
    settings: TuneSettings,
    workers: int = 1,
    on_type: Callable[[int, str], None] = lambda done, note: None,
) -> Iterator[TypeTuned]:
    """What is found, type by type. Types of which the suite has no routes get none. Raises UnknownDriverError."""
    jobs = [tuple(pair for pair in train.pairs if pair.type == kind) for kind in dict.fromkeys(types)]
    jobs = [pairs for pairs in jobs if pairs]
    limits = train.limits_s(train.routes) if settings.timed else {}
    work = [(pairs, {r: limits[r] for pair in pairs for r in pair.drives if r in limits}) for pairs in jobs]
    for done, found in enumerate(in_order(partial(_make_tuner, settings), _tune_type, work, workers), 1):
        on_type(done, found.type)
        yield found


def _tune_type(tuner: _Tuner, job: tuple[tuple[Pair, ...], dict[RouteId, float]]) -> TypeTuned:
    pairs, stored = job
    courses: list[Course] = []
    memories: list[Recorded] = []
    for pair in pairs:
        if len(courses) == tuner.settings.pairs:
            break
        driven = [tuner.references.drive(route) for route in pair.drives]
        memories += [drive.memory for drive in driven if drive.memory is not None]
        seconds = [drive.seconds for drive in driven]
        rule = tuner.settings.rule
        measured = [None if s is None else rule.limit_s(s) for s in seconds]
        limits = tuple(stored.get(route, limit) for route, limit in zip(pair.drives, measured, strict=True))
        if not tuner.settings.timed:
            limits = (None,) * len(pair.drives)
        elif None in limits:
            # Nobody has reached the goal: such a route is in no suite.
            continue
        courses.append(Course(pair.drives, limits))
    trials = Trials(tuner.env, courses, memories)
    choices = {family: search(family, trials) for family in FAMILIES}
    return TypeTuned(pairs[0].type, choices | {SCRIPT: best_of(list(choices.values()))}, tuple(memories))


def together(found: Iterable[TypeTuned], before: Tuned | None = None) -> Tuned:
    """One table of what was found for all types; before: for other types."""
    before = before or Tuned()
    parts = list(found)
    new = {part.type for part in parts}
    memories = [memory for memory in before.memories if memory.type not in new]
    memories += [memory for part in parts for memory in part.memories]
    choices = {
        name: {kind: c for kind, c in before.choices.get(name, {}).items() if kind not in new}
        | {part.type: part.choices[name] for part in parts}
        for name in (*FAMILIES, SCRIPT)
    }
    return Tuned(choices, tuple(memories))
