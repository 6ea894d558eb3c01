"""Traffic flows: dense platoons without usable gaps, and gaps between them, given by arrival times at a point, or
endless."""

from __future__ import annotations

import copy
import math
from typing import TYPE_CHECKING

import numpy as np

from raw2drive_ros.simulation.actors import Look, PathVehicle
from raw2drive_ros.simulation.courses import Course
from raw2drive_ros.simulation.draws import Rng
from raw2drive_ros.simulation.free_space import is_free
from raw2drive_ros.simulation.scenario import FlowSpec, TrafficSpec

if TYPE_CHECKING:
    from raw2drive_ros.simulation.world import World

# Arc length at which a vehicle enters its path.
ENTRY_S_M = 1.0
# In dense traffic IDM settles below its target speed; this factor keeps a flow near the speed it was drawn with.
IDM_SLACK = 1.12
TIGHT_GAP_S = 0.4
# Nothing appears or vanishes nearer to the ego than this: a camera shows what is within 80 m.
HIDDEN_M = 88.0
# A stream is kept up this far from the ego.
REACH_M = 170.0
# At the start, how far beyond the point its first vehicle may be.
BEYOND_POINT_M = 40.0
MOST_AT_ONCE = 30
SLOWEST_EGO_MPS = 4.0


def group_times(
    rng: Rng,
    first_s: float,
    until_s: float,
    headway_s: tuple[float, float] = (1.4, 1.75),
    gap_s: tuple[float, float] = (6.5, 8.5),
    later_s: float = 5.0,
    groups: int = 2,
) -> list[float]:
    """Arrival times (s): a platoon from `first_s` to `until_s`, then `groups - 1` more, each `later_s` long, with gaps
    of `gap_s` between them."""
    times, now, end = [], first_s, until_s
    for _ in range(groups):
        while now < end:
            times.append(now)
            now += float(rng.uniform(*headway_s))
        now += float(rng.uniform(*gap_s))
        end = now + later_s
    return times


def arriving(
    times_s: list[float],
    on: str | tuple[str, str],
    place_s_m: float,
    speed_mps: float,
    lane: int = 0,
    kind: str = 'car',
    clear_m: tuple[float, float] = (0.0, 0.0),
    *,
    has_priority: bool = True,
    obeys_light: bool = False,
) -> tuple[TrafficSpec, ...]:
    """Vehicles that reach arc length `place_s_m` of their path at `times_s`; those that are not on it yet enter later.

    clear_m: no vehicle starts between these arc lengths, where the ego starts.
    """
    cars = []
    for time_s in times_s:
        station = place_s_m - time_s * speed_mps
        if clear_m[0] < station < clear_m[1]:
            continue
        cars.append(
            TrafficSpec(
                on,
                max(station, ENTRY_S_M),
                speed_mps,
                lane=lane,
                target_speed_mps=IDM_SLACK * speed_mps,
                kind=kind,
                obeys_light=obeys_light,
                has_priority=has_priority,
                enters_at_s=max(0.0, (ENTRY_S_M - station) / speed_mps),
                time_gap_s=TIGHT_GAP_S,
            )
        )
    return tuple(cars)


class Flow:
    """A running `FlowSpec`: adds vehicles at the upstream end of its stream, out of the ego's sight.

    Vehicles are placed by their distance to the one before them, so that the stream at the point does not depend on
    where they appear. point_s_m: arc length of the point on the course. ego_s_m: the same on the ego's route. seeds:
    of its draws, which count up, so that a fork of the world goes on with the same ones.
    """

    def __init__(self, spec: FlowSpec, course: Course, point_s_m: float, ego_s_m: float, seeds: list[int]) -> None:
        self.spec, self.course = spec, course
        self.point_s_m, self.ego_s_m = point_s_m, ego_s_m
        self.seeds, self.drawn = seeds, 0
        self.numbers: list[int] = []
        # The plan of what comes next: a vehicle `spacing_s` after the last one, which leads a platoon or belongs to the
        # one that ends at `platoon_ends_s`. Times are those of arrival at the point.
        self.last_arrival_s, self.spacing_s, self.leads = -math.inf, 0.0, True
        self.platoon_ends_s = math.inf
        self.armed = self.ended = False

    def fork(self) -> Flow:
        """An independent copy."""
        fork = copy.copy(self)
        fork.numbers = list(self.numbers)
        return fork

    def fill(self, world: World) -> None:
        """Place the stream as it is when the scene begins."""
        if self.spec.from_s_m <= world.route_s_m:
            self._extend(world, 0.0)

    def update(self, world: World) -> None:
        """Add vehicles at the upstream end, and take back those out of sight that come too late."""
        if self.ended or not self.spec.from_s_m <= world.route_s_m < self.spec.until_s_m:
            return
        self._find_last(world)
        if not self.armed and self.ego_s_m - world.route_s_m < self.spec.armed_within_m:
            self.armed = True
            self.platoon_ends_s = world.time_s + self.spec.first_gap_after_s
            self._take_back(world, self.platoon_ends_s)
        end_s = self._end_s(world)
        if end_s < math.inf:
            self._take_back(world, end_s)
            self.ended = end_s <= world.time_s
        self._extend(world, HIDDEN_M)

    def _end_s(self, world: World) -> float:
        """When the last vehicle has to pass the point, after the ego's present speed; inf for an endless stream.

        At the start after the speed limit: what is in sight then cannot be taken back.
        """
        if self.spec.last_passes_m is None:
            return math.inf
        left = self.ego_s_m - world.route_s_m - self.spec.last_passes_m
        expected = world.scene.layout.speed_limit_mps if world.time_s == 0.0 else SLOWEST_EGO_MPS
        return world.time_s + max(0.0, left) / max(world.ego.speed, expected)

    def _find_last(self, world: World) -> None:
        """Update when the last vehicle arrives: it may have been held up."""
        while self.numbers:
            last = world.find(self.numbers[-1])
            if isinstance(last, PathVehicle):
                self.last_arrival_s = self._arrival_s(world, last.s_m)
                return
            self.numbers.pop()

    def _take_back(self, world: World, until_s: float) -> None:
        """Remove vehicles out of sight that would pass the point later than `until_s`."""
        while self.numbers:
            last = world.find(self.numbers[-1])
            if not isinstance(last, PathVehicle):
                self.numbers.pop()
                continue
            if self.last_arrival_s <= until_s or world.ego_distance_m(last.position) < HIDDEN_M:
                return
            world.remove(last)
            self.numbers.pop()
            self._find_last(world)

    def _arrival_s(self, world: World, s_m: float) -> float:
        return world.time_s + (self.point_s_m - s_m) / self.spec.speed_mps

    def _extend(self, world: World, hidden_m: float) -> None:
        """Place vehicles behind the last one, as long as their places are between `hidden_m` and `REACH_M` from the
        ego."""
        end_s = self._end_s(world)
        for _ in range(MOST_AT_ONCE):
            rng = np.random.default_rng([*self.seeds, self.drawn])
            s_m = self._next_s_m(world, rng, hidden_m)
            if s_m < ENTRY_S_M or world.ego_distance_m(self.course.path.pose(s_m)[:2]) > REACH_M:
                return
            arrival = self._arrival_s(world, s_m)
            if arrival > end_s:
                return
            self.drawn += 1
            if arrival > self.platoon_ends_s and not self.leads:
                self.spacing_s, self.leads = float(rng.uniform(*self.spec.gap_s)), True
                continue
            if not self._place(world, rng, s_m):
                # The place is taken: the next try is farther upstream.
                self.spacing_s += 1.0
                continue
            self.last_arrival_s = arrival
            if self.leads:
                self.platoon_ends_s = arrival + float(rng.uniform(*self.spec.platoon_s)) if self.armed else math.inf
            self.spacing_s, self.leads = float(rng.uniform(*self.spec.headway_s)), False

    def _next_s_m(self, world: World, rng: Rng, hidden_m: float) -> float:
        """Arc length of the next vehicle: behind the last one, and out of sight."""
        path, speed = self.course.path, self.spec.speed_mps
        first = min(self.point_s_m + BEYOND_POINT_M, path.length_m - 1.0) - float(rng.uniform(0.0, 1.5)) * speed
        s_m = first
        if self.last_arrival_s > -math.inf:
            s_m = min(first, self.point_s_m - (self.last_arrival_s + self.spacing_s - world.time_s) * speed)
        else:
            # The stream begins where the ego's surroundings do: in the ego's direction it comes along beside the ego.
            while s_m > 0.0 and world.ego_distance_m(path.pose(s_m)[:2]) > REACH_M:
                s_m -= 2.0
        while s_m > 0.0 and world.ego_distance_m(path.pose(s_m)[:2]) < hidden_m:
            s_m -= 2.0
        return s_m

    def _place(self, world: World, rng: Rng, s_m: float) -> bool:
        """Add a vehicle, if its place is free."""
        spec = self.spec
        actor = PathVehicle(
            self.course.path,
            s_m,
            spec.speed_mps,
            spec.speed_mps * (1.0 if self.leads else IDM_SLACK),
            spec.kind,
            Look.draw(spec.kind, rng, world.draw.split),
            lateral_m=spec.lateral_m,
            time_gap_s=TIGHT_GAP_S,
            course=self.course,
            yields=spec.yields,
            obeys_lights=spec.obeys_lights,
            ignores_ego=spec.ignores_ego,
        )
        if not is_free(world, actor):
            return False
        world.add(actor)
        self.numbers.append(actor.number)
        return True
