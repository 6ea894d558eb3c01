"""Infractions and route completion of one drive, after Bench2Drive's criteria (spec 4.1 to 4.3).

Two infractions are of this benchmark alone: making others brake hard, and lanes by the car's footprint (`footprint`).
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass, field

import numpy as np

from raw2drive_ros.simulation.actors import Actor, PathVehicle, StandingObject, Walker
from raw2drive_ros.simulation.conduct import (
    ENTERED_WITHIN_S,
    MOVING_MPS,
    STANDING_MPS,
    forces_braking,
    has_reason_to_stand,
)
from raw2drive_ros.simulation.contact import Contact, key_of
from raw2drive_ros.simulation.footprint import LANE_CHANGE_M, LANE_TOLERANCE_M, Way, on_road, ways_of
from raw2drive_ros.simulation.protocol import BENCH2DRIVE, PAIRS
from raw2drive_ros.simulation.world import World
from raw2drive_ros.tables.rates import DECISION_HZ

__all__ = ['LANE_TOLERANCE_M', 'Criteria', 'on_road', 'route_deviation_m', 'time_limit_s']

# As in Bench2Drive, collisions of a standing ego, with the same actor soon after, or near the last one do not count.
# Who leans on a car that has hit it has not collided with it: contacts that follow this closely are one.
LEANING_S = 0.5
COLLISION_MEMORY_S = 5.0
COLLISION_APART_M = 5.0
COLLISION_SPEED_MPS = 0.1
# A cone that is touched more slowly than this is only pushed aside.
CONE_MPS = 4.0
BLOCKED_SPEED_MPS = 0.1
BLOCKED_LIMIT_S = 60.0
DEVIATION_LIMIT_M = 30.0
ROUTE_END_M = 10.0
BEYOND_JUNCTION_M = 8.0
# Progress counts only this close to the route, so that driving beside the road earns no route completion.
PROGRESS_WITHIN_M = 5.0
# Number of checkpoints of a route at which Bench2Drive compares the speeds of ego and traffic.
SPEED_CHECKPOINTS = 20
TRAFFIC_WITHIN_M = 50.0
# The stretch of an event has to be left within `SCENARIO_S` plus its length at `SCENARIO_MPS`. Bench2Drive gives 240 s,
# which is longer than any drive here.
SCENARIO_S, SCENARIO_MPS, BENCH2DRIVE_SCENARIO_S = 60.0, 2.0, 240.0
# Bench2Drive's limits: 4000 ticks at 20 Hz for short routes; 300 s plus the way at a tenth of the speed limit.
TICK_LIMIT_S, SHORT_ROUTE_M, ROUTE_LIMIT_S, ROUTE_LIMIT_SHARE = 200.0, 1000.0, 300.0, 0.1


@dataclass(slots=True)
class Criteria:
    """Observes a world; `step` returns the names of the infractions that began in this decision step.

    own_limit_s: the time limit that a suite gives this drive; None: that of the scene, see `time_limit_s`. protocol:
    see `simulation.protocol`. step_outside_m: way outside the lanes in the last step. needless_stop_s: the longest time
    for which the ego stood without a reason.
    """

    own_limit_s: float | None = None
    protocol: str = PAIRS
    events: dict[str, int] = field(default_factory=dict)
    failure: str = ''
    travelled_m: float = 0.0
    outside_m: float = 0.0
    step_outside_m: float = 0.0
    straddled_m: float = 0.0
    best_s_m: float = 0.0
    start_s_m: float | None = None
    blocked_s: float = 0.0
    contacts_seen: int = 0
    touched_at_s: dict[int, float] = field(default_factory=dict)
    collided_at_s: dict[int, float] = field(default_factory=dict)
    collided_at_m: tuple[float, float] | None = None
    lights_run: set[int] = field(default_factory=set)
    signs_run: set[int] = field(default_factory=set)
    last_front_s_m: float = 0.0
    speeds: dict[int, list[tuple[float, float]]] = field(default_factory=dict)
    # Places of the ego, one per step, the oldest `ENTERED_WITHIN_S` ago.
    places_m: deque[tuple[float, float]] = field(
        default_factory=lambda: deque(maxlen=round(ENTERED_WITHIN_S * DECISION_HZ))
    )
    forced: set[int] = field(default_factory=set)
    entered_at_s: dict[int, float] = field(default_factory=dict)
    overdue: set[int] = field(default_factory=set)
    stood_s: float = 0.0
    needless_s: float = 0.0
    needless_stop_s: float = 0.0

    def step(self, world: World, way: Way | None = None) -> list[str]:
        """way: where the ego is, for who knows it already; see `footprint.ways_of`."""
        if self.start_s_m is None:
            self.start_s_m = self.best_s_m = self.last_front_s_m = world.scene.route.start_s_m
            self.last_front_s_m += world.ego.LENGTH / 2
        happened = self._collisions(world) + self._signals(world) + self._forced_braking(world) + self._overdue(world)
        rule = world.scenario.rule(world)
        if rule and rule not in self.events:
            happened.append(rule)
        for name in happened:
            self.events[name] = self.events.get(name, 0) + 1
        self._measure_way(world, ways_of([world])[0] if way is None else way)
        if route_deviation_m(world) < PROGRESS_WITHIN_M:
            self.best_s_m = max(self.best_s_m, world.route_s_m)
        self._compare_speeds(world)
        self._watch_standing(world)
        self.last_front_s_m = world.front_s_m
        self.blocked_s = self.blocked_s + 1 / DECISION_HZ if abs(world.ego.speed) < BLOCKED_SPEED_MPS else 0.0
        if abs(world.route_lateral_m) > DEVIATION_LIMIT_M:
            self.failure = 'route_deviation'
        elif self.blocked_s > BLOCKED_LIMIT_S:
            self.failure = 'blocked'
        elif world.time_s > self.limit_s(world):
            self.failure = 'timeout'
        return happened

    def limit_s(self, world: World) -> float:
        """Time (s) after which the drive fails."""
        if self.protocol == BENCH2DRIVE:
            return loose_limit_s(world)
        return time_limit_s(world) if self.own_limit_s is None else self.own_limit_s

    def finished(self, world: World) -> bool:
        """Whether the ego has reached the goal."""
        return world.goal_s_m - self.best_s_m < ROUTE_END_M

    def route_completion(self, world: World) -> float:
        """Percentage of the route that was driven; 100 within `ROUTE_END_M` of the goal."""
        assert self.start_s_m is not None
        if world.goal_s_m - self.best_s_m < ROUTE_END_M:
            return 100.0
        return 100.0 * max(0.0, self.best_s_m - self.start_s_m) / (world.goal_s_m - self.start_s_m)

    def traffic_speed_percents(self) -> list[float]:
        """Mean speed of the ego as a percentage of the traffic's, per section of the route with moving cars near."""
        found = []
        for samples in self.speeds.values():
            ego, traffic = (sum(column) / len(samples) for column in zip(*samples, strict=True))
            found.append(100.0 * ego / traffic)
        return found

    def _compare_speeds(self, world: World) -> None:
        assert self.start_s_m is not None
        near = np.abs(world.positions[:-1] - world.ego.position).max(axis=1, initial=0.0) < TRAFFIC_WITHIN_M
        cars = [i for i in np.flatnonzero(near & (world.speeds[:-1] > MOVING_MPS)) if _is_car(world.actors[i])]
        if not cars:
            return
        done = (self.best_s_m - self.start_s_m) / (world.goal_s_m - self.start_s_m)
        stretch = self.speeds.setdefault(int(SPEED_CHECKPOINTS * min(max(done, 0.0), 0.999)), [])
        stretch.append((abs(world.ego.speed), float(world.speeds[cars].mean())))

    def obeyed_signs_at_first_junction(self, world: World) -> bool:
        """Whether the ego passed the first junction of the route without running a red light or a stop sign."""
        junctions = world.road.junctions
        if not junctions or {'red_light', 'stop_sign'} & set(self.events):
            return False
        return self.best_s_m > junctions[0].entry_s_m + BEYOND_JUNCTION_M

    @property
    def outside_percent(self) -> float:
        return 100.0 * self.outside_m / self.travelled_m if self.travelled_m > 0 else 0.0

    def _measure_way(self, world: World, way: Way) -> None:
        """Add the way of this step, and what of it was outside the lanes."""
        moved = abs(world.ego.speed) / DECISION_HZ
        self.travelled_m += moved
        # A lane change may take its way; what was used up comes back by driving within a lane.
        change = moved if way.straddles else -moved
        self.straddled_m = min(max(0.0, self.straddled_m + change), LANE_CHANGE_M + moved)
        outside = self.straddled_m > LANE_CHANGE_M or not way.on_road
        self.step_outside_m = moved if outside else 0.0
        self.outside_m += self.step_outside_m

    def _collisions(self, world: World) -> list[str]:
        new, self.contacts_seen = world.contacts[self.contacts_seen :], len(world.contacts)
        return [f'collision_{_collision_kind(contact.actor)}' for contact in new if self._counts(contact)]

    def _counts(self, contact: Contact) -> bool:
        """Whether a contact is a collision of its own; then it is kept in mind."""
        key = key_of(contact.actor)
        begins = contact.time_s - self.touched_at_s.get(key, -math.inf) > LEANING_S
        self.touched_at_s[key] = contact.time_s
        if not begins or contact.ego_speed_mps < COLLISION_SPEED_MPS:
            return False
        if contact.actor.kind == 'cone' and contact.impact_mps < CONE_MPS:
            return False
        if contact.time_s - self.collided_at_s.get(key, -math.inf) < COLLISION_MEMORY_S:
            return False
        last = self.collided_at_m
        if last is not None and math.dist(last, contact.place_m) < COLLISION_APART_M:
            return False
        self.collided_at_s[key], self.collided_at_m = contact.time_s, contact.place_m
        return True

    def _forced_braking(self, world: World) -> list[str]:
        x, y = (float(v) for v in world.ego.position)
        before = self.places_m[0] if self.places_m else (x, y)
        self.places_m.append((x, y))
        keys = [key_of(actor) for actor in world.actors if forces_braking(world, actor, before)]
        new = [key for key in keys if key not in self.forced]
        self.forced.update(new)
        return ['forced_braking'] * len(new)

    def _overdue(self, world: World) -> list[str]:
        found = []
        for i, (begin, end) in enumerate(world.scene.events_s_m):
            if world.front_s_m < begin or i in self.overdue:
                continue
            entered_s = self.entered_at_s.setdefault(i, world.time_s)
            allowed_s = SCENARIO_S + (end - begin) / SCENARIO_MPS
            if self.protocol == BENCH2DRIVE:
                allowed_s = BENCH2DRIVE_SCENARIO_S
            if self.best_s_m < end and world.time_s - entered_s > allowed_s:
                self.overdue.add(i)
                found.append('scenario_timeout')
        return found

    def _watch_standing(self, world: World) -> None:
        if abs(world.ego.speed) > STANDING_MPS:
            self.stood_s = self.needless_s = 0.0
            return
        self.stood_s += 1.0 / DECISION_HZ
        needless = not has_reason_to_stand(world, self.stood_s)
        self.needless_s = self.needless_s + 1.0 / DECISION_HZ if needless else 0.0
        self.needless_stop_s = max(self.needless_stop_s, self.needless_s)

    def _signals(self, world: World) -> list[str]:
        found = []
        front, before = world.front_s_m, self.last_front_s_m
        for i, light in enumerate(world.lights):
            if i not in self.lights_run and before < light.line_s_m <= front and light.colour == 'red':
                self.lights_run.add(i)
                found.append('red_light')
        for i, sign in enumerate(world.stop_signs):
            if i not in self.signs_run and before < sign.line_s_m <= front and not sign.obeyed:
                self.signs_run.add(i)
                found.append('stop_sign')
        return found


def route_deviation_m(world: World) -> float:
    """Distance (m) of the ego's centre from the route; 0 between the route and a detour around an obstacle."""
    right, left = world.lateral_range_m(world.route_s_m)
    return max(0.0, right - world.route_lateral_m, world.route_lateral_m - left)


def time_limit_s(world: World) -> float:
    """The scene's own time limit, or 30 s plus three times the time that the route takes at the speed limit."""
    if world.scene.time_limit_s is not None:
        return world.scene.time_limit_s
    return 30.0 + 3.0 * world.route.end_s_m / world.scene.layout.speed_limit_mps


def loose_limit_s(world: World) -> float:
    """Bench2Drive's limit: its number of ticks, or on long routes the time of its route criterion."""
    if world.route.end_s_m < SHORT_ROUTE_M:
        return TICK_LIMIT_S
    return ROUTE_LIMIT_S + world.route.end_s_m / (ROUTE_LIMIT_SHARE * world.scene.layout.speed_limit_mps)


def _is_car(actor: Actor) -> bool:
    return isinstance(actor, PathVehicle) and actor.kind != 'cyclist'


def _collision_kind(actor: Actor) -> str:
    """pedestrian, vehicle (cyclists too, as in Bench2Drive) or static."""
    if actor.kind == 'cyclist':
        return 'vehicle'
    if isinstance(actor, Walker):
        return 'pedestrian'
    return 'static' if isinstance(actor, StandingObject) and not actor.kind.startswith('parked') else 'vehicle'
