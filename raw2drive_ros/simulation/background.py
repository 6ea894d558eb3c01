"""Moving traffic that wants nothing: cars on all lanes, and cyclists.

It lives in a ring around the ego: it is added where no camera sees it, on lanes that are emptier than the density asks
for, and removed far away. For what stands or walks beside the road see `roadside`.
"""

from __future__ import annotations

import copy
import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from raw2drive_ros.contracts.public import Float64
from raw2drive_ros.simulation.actors import Look, PathVehicle
from raw2drive_ros.simulation.courses import Course, CourseBook, LaneRef
from raw2drive_ros.simulation.draws import Rng
from raw2drive_ros.simulation.flows import HIDDEN_M
from raw2drive_ros.simulation.free_space import gap_in_lane, is_free
from raw2drive_ros.simulation.scenario import BackgroundSpec

if TYPE_CHECKING:
    from raw2drive_ros.simulation.world import World

# Moving traffic is added up to this far from the ego, and removed beyond.
REACH_M, GONE_M = 150.0, 185.0
SPACING_M = {'none': math.inf, 'light': 64.0, 'medium': 38.0, 'dense': 24.0}
MOST = {'none': 0, 'light': 8, 'medium': 15, 'dense': 24}
SPOT_M = 6.0
# No car is added this near before a junction or after its beginning.
JUNCTION_M = 30.0
TRIES = 4
VAN_SHARE = 0.15
# Free room in front of and behind a car that is added, and how far outside its lane a cyclist rides.
ROOM_M = 4.0
RIDES_BESIDE_M = 0.45
# In front of and behind the ego's start, its lane stays empty.
CLEAR_AHEAD_M, CLEAR_BEHIND_M = 28.0, 14.0
CYCLIST_MPS = (3.8, 5.2)
TURNS = ('ahead', 'left', 'right')


@dataclass(frozen=True, slots=True)
class Spot:
    """A place where a car may be added: on a lane, `s_m` along it. rides: cyclists may ride beside it."""

    lane: LaneRef
    s_m: float
    heading_rad: float
    rides: bool


class Background:
    """The running `BackgroundSpec` of a world. avoid: lanes that it must not use. seeds: of its draws."""

    def __init__(self, spec: BackgroundSpec, book: CourseBook, avoid: set[LaneRef], seeds: list[int]) -> None:
        self.spec, self.book, self.avoid = spec, book, avoid
        self.seeds, self.drawn = seeds, 0
        self.cars: list[int] = []
        self.riders: list[int] = []
        self.spots: list[Spot] = []
        self.places_m: Float64 = np.zeros((0, 2))
        self.own: set[LaneRef] = set()

    def fork(self) -> Background:
        """An independent copy."""
        fork = copy.copy(self)
        fork.cars, fork.riders = list(self.cars), list(self.riders)
        return fork

    def prepare(self, own: set[LaneRef], rides_along: set[tuple[str, str]]) -> None:
        """List the places for cars. own: the lanes of the ego's route. rides_along: edges with cyclists."""
        self.own = own
        places = []
        for ref, lane in self.book.lanes.items():
            if lane.junction >= 0 or self._class_of(ref) not in self.spec.lanes or not self._leads_out(ref):
                continue
            to_junction = any(self.book.lanes[other].junction >= 0 for other in self.book.after[ref])
            rides = ref[:2] in rides_along and ref[2] == self.book.count(ref) - 1
            end = lane.length - (JUNCTION_M if to_junction else 2.0)
            for s_m in np.arange(3.0, end, SPOT_M):
                x, y, yaw = lane.pose(float(s_m))
                self.spots.append(Spot(ref, float(s_m), yaw, rides))
                places.append((x, y))
        self.places_m = np.array(places).reshape(-1, 2)

    def _class_of(self, ref: LaneRef) -> str:
        if ref in self.own:
            return 'own'
        if ref[:2] in self.book.road.lanes_along(oncoming=False):
            return 'beside'
        return 'oncoming' if ref[:2] in self.book.road.lanes_along(oncoming=True) else 'cross'

    def _leads_out(self, ref: LaneRef) -> bool:
        """Whether a car on the lane can go on to the edge of the map, on lanes that it may use."""
        lanes = self.book.downstream(ref)
        return ref not in self.avoid and not self.avoid & set(lanes) and self.book.is_sink(lanes[-1])

    def fill(self, world: World) -> None:
        """The traffic that is there when the scene begins, in sight and out of sight."""
        if not self.spots:
            return
        rng = self._rng()
        near = np.hypot(*(self.places_m - world.ego.position).T) < REACH_M
        for index in rng.permutation(np.flatnonzero(near)).tolist():
            spot = self.spots[index]
            if not (spot.lane in self.own and self._before_the_ego(world, index)):
                self._try(world, index, self._rng())

    def _before_the_ego(self, world: World, index: int) -> bool:
        """Whether a place is where the ego starts."""
        dx, dy = (self.places_m[index] - world.ego.position).tolist()
        along = dx * math.cos(world.ego.heading) + dy * math.sin(world.ego.heading)
        return -CLEAR_BEHIND_M < along < CLEAR_AHEAD_M and math.hypot(dx, dy) < CLEAR_AHEAD_M + 5.0

    def update(self, world: World) -> None:
        """Add a car where the road is empty and nobody looks; remove those that are far away."""
        for numbers in (self.cars, self.riders):
            numbers[:] = [number for number in numbers if world.find(number) is not None]
            for number in numbers:
                actor = world.find(number)
                if actor is not None and world.ego_distance_m(actor.position) > GONE_M:
                    world.remove(actor)
        if self._full():
            return
        far = np.hypot(*(self.places_m - world.ego.position).T)
        ring = np.flatnonzero((far > HIDDEN_M + 2.0) & (far < REACH_M))
        for _ in range(TRIES if len(ring) else 0):
            rng = self._rng()
            if self._try(world, int(rng.choice(ring)), rng):
                return

    def _full(self) -> bool:
        return len(self.cars) >= MOST[self.spec.density] and len(self.riders) >= self.spec.cyclists

    def _rng(self) -> Rng:
        self.drawn += 1
        return np.random.default_rng([*self.seeds, self.drawn])

    def _try(self, world: World, index: int, rng: Rng) -> bool:
        """Add a car or a cyclist at a place, if it is as far from all others in its lane as the density says."""
        if len(self.riders) < self.spec.cyclists and self.spots[index].rides:
            return self._add_cyclist(world, index, rng)
        if len(self.cars) >= MOST[self.spec.density]:
            return False
        spot = self.spots[index]
        spacing = SPACING_M[self.spec.density] * float(rng.uniform(0.75, 1.5))
        speed = world.scene.layout.speed_limit_mps * float(rng.uniform(0.72, 0.98))
        x, y = self.places_m[index].tolist()
        free_m, leader_mps = gap_in_lane(world, x, y, spot.heading_rad)
        turns = tuple(TURNS[i] for i in rng.choice(3, 4, p=(0.5, 0.25, 0.25)))
        course = self._course(spot, turns)
        if free_m < spacing or course is None:
            return False
        speed = min(speed, math.sqrt(leader_mps**2 + 2.0 * 1.5 * free_m))
        kind = 'van' if rng.random() < VAN_SHARE else 'car'
        actor = PathVehicle(
            course.path,
            course.station_of(spot.lane) + spot.s_m,
            speed,
            speed,
            kind,
            Look.draw(kind, rng, world.draw.split),
            time_gap_s=float(rng.uniform(1.0, 1.5)),
            course=course,
        )
        return self._add(world, actor, self.cars)

    def _add_cyclist(self, world: World, index: int, rng: Rng) -> bool:
        """A cyclist rides beside the outermost lane."""
        spot = self.spots[index]
        course = self._course(spot, ('ahead',) * 4)
        if course is None:
            return False
        lateral = -(self.book.lanes[spot.lane].width / 2 + RIDES_BESIDE_M)
        speed = float(rng.uniform(*CYCLIST_MPS))
        station = course.station_of(spot.lane) + spot.s_m
        look = Look.draw('cyclist', rng, world.draw.split)
        actor = PathVehicle(course.path, station, speed, speed, 'cyclist', look, lateral_m=lateral, course=course)
        return self._add(world, actor, self.riders)

    @staticmethod
    def _add(world: World, actor: PathVehicle, numbers: list[int]) -> bool:
        if not is_free(world, actor, ROOM_M):
            return False
        world.add(actor)
        numbers.append(actor.number)
        return True

    def _course(self, spot: Spot, turns: tuple[str, ...]) -> Course | None:
        """A course with these turns or, where they lead to lanes that it may not use, along the road."""
        for then in (turns, ()):
            course = self.book.through(spot.lane, then)
            ahead = set(course.lanes[course.lanes.index(spot.lane) :])
            if not ahead & self.avoid and self.book.is_sink(course.lanes[-1]):
                return course
        return None
