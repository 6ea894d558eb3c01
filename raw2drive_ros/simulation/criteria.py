"""Infractions and route completion of one drive, after Bench2Drive's criteria (spec 4.1 to 4.3)."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from raw2drive_ros.simulation.actors import PathVehicle, StandingObject, Walker, boxes_overlap, corners_m
from raw2drive_ros.simulation.layout import LANE_WIDTH_M
from raw2drive_ros.simulation.world import World
from raw2drive_ros.tables.rates import DECISION_HZ

COLLISION_MEMORY_S = 5.0
COLLISION_SPEED_MPS = 0.1
BLOCKED_SPEED_MPS = 0.1
BLOCKED_LIMIT_S = 60.0
DEVIATION_LIMIT_M = 30.0
LANE_TOLERANCE_M = 0.5
ROUTE_END_M = 10.0
BEYOND_JUNCTION_M = 8.0
# Progress counts only this close to the route, so that driving beside the road earns no route completion.
PROGRESS_WITHIN_M = 5.0
# Number of checkpoints of a route at which Bench2Drive compares the speeds of ego and traffic.
SPEED_CHECKPOINTS = 20
TRAFFIC_WITHIN_M = 50.0
STANDING_TRAFFIC_MPS = 0.5


@dataclass(slots=True)
class Criteria:
    """Observes a world; `step` returns the names of the infractions that began in this decision step.

    own_limit_s: the time limit that a suite gives this drive; None: that of the scene, see `time_limit_s`.
    """

    own_limit_s: float | None = None
    events: dict[str, int] = field(default_factory=dict)
    failure: str = ''
    travelled_m: float = 0.0
    outside_m: float = 0.0
    best_s_m: float = 0.0
    start_s_m: float | None = None
    blocked_s: float = 0.0
    collided_at_s: dict[int, float] = field(default_factory=dict)
    lights_run: set[int] = field(default_factory=set)
    signs_run: set[int] = field(default_factory=set)
    last_front_s_m: float = 0.0
    speeds: dict[int, list[tuple[float, float]]] = field(default_factory=dict)

    def step(self, world: World) -> list[str]:
        if self.start_s_m is None:
            self.start_s_m = self.best_s_m = self.last_front_s_m = world.scene.route.start_s_m
            self.last_front_s_m += world.ego.LENGTH / 2
        happened = self._collisions(world) + self._signals(world)
        rule = world.scenario.rule(world)
        if rule and rule not in self.events:
            happened.append(rule)
        for name in happened:
            self.events[name] = self.events.get(name, 0) + 1
        moved = abs(world.ego.speed) / DECISION_HZ
        self.travelled_m += moved
        if not on_road(world):
            self.outside_m += moved
        if route_deviation_m(world) < PROGRESS_WITHIN_M:
            self.best_s_m = max(self.best_s_m, world.route_s_m)
        self._compare_speeds(world)
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
        """Mean speed of the ego as a percentage of the traffic's, per section of the route that had moving traffic."""
        found = []
        for samples in self.speeds.values():
            ego, traffic = (sum(column) / len(samples) for column in zip(*samples, strict=True))
            if traffic > STANDING_TRAFFIC_MPS:
                found.append(100.0 * ego / traffic)
        return found

    def _compare_speeds(self, world: World) -> None:
        assert self.start_s_m is not None
        near = np.abs(world.positions[:-1] - world.ego.position).max(axis=1, initial=0.0) < TRAFFIC_WITHIN_M
        cars = [i for i in np.flatnonzero(near) if isinstance(world.actors[i], PathVehicle)]
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

    def _collisions(self, world: World) -> list[str]:
        ego = world.ego
        own = corners_m(float(ego.position[0]), float(ego.position[1]), ego.heading, ego.LENGTH, ego.WIDTH)
        found = []
        for actor in world.actors:
            delta = actor.position - ego.position
            if abs(delta[0]) > 7.0 or abs(delta[1]) > 7.0:
                continue
            box = corners_m(
                float(actor.position[0]), float(actor.position[1]), actor.heading, actor.LENGTH, actor.WIDTH
            )
            if not boxes_overlap(own, box):
                continue
            last = self.collided_at_s.get(id(actor), -math.inf)
            if abs(ego.speed) < COLLISION_SPEED_MPS or world.time_s - last < COLLISION_MEMORY_S:
                continue
            self.collided_at_s[id(actor)] = world.time_s
            kind = (
                'pedestrian'
                if isinstance(actor, Walker) or actor.kind == 'cyclist'
                else 'static'
                if isinstance(actor, StandingObject) and not actor.kind.startswith('parked')
                else 'vehicle'
            )
            found.append(f'collision_{kind}')
        return found

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


def on_road(world: World) -> bool:
    """Whether the ego is where it may drive: within half a lane plus tolerance of the route or of a detour around an
    obstacle, or in any forward lane."""
    if route_deviation_m(world) < LANE_WIDTH_M / 2 + LANE_TOLERANCE_M:
        return True
    lanes = world.scene.layout.forward_lanes
    if lanes == 1 and not world.scene.route.from_ramp:
        return False
    x, y = float(world.ego.position[0]), float(world.ego.position[1])
    reference = world.road.forward_path_cached()
    _, lateral = reference.project(x, y)
    to_right = -(lanes - 0.5) * LANE_WIDTH_M - LANE_TOLERANCE_M
    return to_right < lateral < LANE_WIDTH_M / 2 + LANE_TOLERANCE_M


def time_limit_s(world: World) -> float:
    """The scene's own time limit, or 30 s plus three times the time that the route takes at the speed limit."""
    if world.scene.time_limit_s is not None:
        return world.scene.time_limit_s
    return 30.0 + 3.0 * world.route.end_s_m / world.scene.layout.speed_limit_mps
