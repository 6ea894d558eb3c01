"""Driving by the route alone: speed profiles that are laid down in advance, and a bumper that feels 7 m ahead.

Nothing here looks at traffic, walkers or obstacles; only profiles with a `sensor` see what is just before the bumper,
lights and stop signs. What a profile knows is the route's line, the speed limit and the type of the scenario. Whoever
wins a pair of drives with one of these has found a hole in the benchmark.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Any

import numpy as np

from raw2drive_ros.contracts.public import Control
from raw2drive_ros.evaluation.following import (
    idm_acceleration,
    leader,
    pedals,
    pursuit_steer,
    route_window,
    stop_line_m,
    stopping,
)
from raw2drive_ros.simulation.path import Path
from raw2drive_ros.simulation.world import World
from raw2drive_ros.tables.rates import DECISION_HZ

SENSOR_M = 7.0
GAIN_1PS = 1.5
STANDING_MPS = 0.2
# A stop counts as made within this distance of its place.
STOP_WITHIN_M = 2.5
# A turn of the route: curvature above this (1/m); two of them this near to each other are one.
TURN_1PM, TURN_APART_M, BEFORE_TURN_M = 1.0 / 30.0, 25.0, 8.0
GOAL_M = 10.0
FASTEST_MPS = 40.0


@dataclass(frozen=True, slots=True)
class Stop:
    """Stand for `for_s` at a share `at` of the way from start to goal."""

    at: float
    for_s: float


@dataclass(frozen=True, slots=True)
class Profile:
    """How fast to drive where, decided before the start.

    speed_mps: at most. share: of the advised speed (limit, slower in curves), may exceed 1. wait_s: stand at the start.
    stops: in order. slow: (from, to, m/s), as shares of the way. turn_stop_s: stand so long before every turn of the
    route. offset_m: to the left of the route. sensor: feels what is ahead within 7 m in its own corridor, and obeys
    lights and stop signs.
    """

    speed_mps: float = FASTEST_MPS
    share: float = 1.0
    wait_s: float = 0.0
    stops: tuple[Stop, ...] = ()
    slow: tuple[float, float, float] | None = None
    turn_stop_s: float = 0.0
    offset_m: float = 0.0
    sensor: bool = False

    def stored(self) -> dict[str, Any]:
        """The fields that differ from the defaults."""
        found = {field.name: getattr(self, field.name) for field in fields(self)}
        found['stops'] = tuple((stop.at, stop.for_s) for stop in self.stops)
        return {name: value for name, value in found.items() if value != _DEFAULTS[name]}

    @staticmethod
    def from_stored(values: Mapping[str, Any]) -> Profile:
        """Raises ValueError for what `stored` does not give."""
        if unknown := sorted(set(values) - set(_DEFAULTS)):
            raise ValueError(f'no such parameter: {", ".join(unknown)}')
        given = dict(values)
        for name, value in given.items():
            numbers = np.ravel(np.array(value, float)) if name not in ('sensor', 'stops', 'slow') else np.zeros(0)
            if numbers.size > 1 or not np.isfinite(numbers).all():
                raise ValueError(f'{name}: {value!r} is not a number')
        if 'stops' in given:
            given['stops'] = tuple(Stop(float(at), float(for_s)) for at, for_s in given['stops'])
        if given.get('slow') is not None:
            begin, end, speed = map(float, given['slow'])
            given['slow'] = (begin, end, speed)
        return Profile(**given)


_DEFAULTS: dict[str, Any] = {field.name: field.default for field in fields(Profile)}


def turns_m(route: Path, begin_m: float, end_m: float) -> list[float]:
    """Arc lengths at which the route begins to turn."""
    found: list[float] = []
    last = -math.inf
    for s_m in np.arange(begin_m, end_m, 2.0):
        if route.curvature(float(s_m), 2.0) > TURN_1PM:
            if s_m - last > TURN_APART_M:
                found.append(float(s_m))
            last = float(s_m)
    return found


def least_s(profile: Profile, world: World) -> float:
    """A time (s) that the profile takes at least, without a drive: for candidates that a limit rules out."""
    begin, goal = world.route_s_m, world.goal_s_m - GOAL_M
    stations = np.arange(begin, goal, 2.0)
    speeds = np.array([wanted_mps(profile, world, float(s)) for s in stations])
    stands = profile.wait_s + sum(stop.for_s for stop in profile.stops)
    # Curves may be taken faster than at the advised speed, hence the factor.
    return stands + 0.9 * float((2.0 / np.maximum(speeds, 0.1)).sum())


def wanted_mps(profile: Profile, world: World, s_m: float) -> float:
    """Speed of the profile at a place of the route, without its stops."""
    speed = min(profile.speed_mps, profile.share * world.speed_limit_at(s_m))
    if profile.slow is not None:
        begin, end, slow_mps = profile.slow
        if begin <= way_share(world, s_m) < end:
            speed = min(speed, slow_mps)
    return speed


def way_share(world: World, s_m: float) -> float:
    """How much of the way from start to goal lies before a place of the route."""
    start = world.scene.route.start_s_m
    return (s_m - start) / max(world.goal_s_m - start, 1e-6)


class ProfileDriver:
    """Drives a profile: `control(world)` returns a `Control`. A new one for every drive."""

    def __init__(self, profile: Profile) -> None:
        self.profile = profile
        # (arc length, seconds left to stand there), in order.
        self.stands: list[tuple[float, float]] | None = None

    def control(self, world: World) -> Control:
        profile = self.profile
        if self.stands is None:
            self.stands = self._stands(world)
        speed = max(world.ego.speed, 0.0)
        steer = pursuit_steer(world, offset_m=profile.offset_m)
        if world.time_s < profile.wait_s:
            return pedals(world, -3.0 if speed > 0.05 else 0.0, steer)
        wanted = wanted_mps(profile, world, world.route_s_m)
        acceleration = min(max(GAIN_1PS * (wanted - speed), -5.0), 3.0)
        acceleration = min(acceleration, self._stop(world, speed))
        if profile.sensor:
            acceleration = min(acceleration, _felt(world, speed, wanted, profile.offset_m))
        return pedals(world, acceleration, steer)

    def _stands(self, world: World) -> list[tuple[float, float]]:
        begin, goal = world.scene.route.start_s_m, world.goal_s_m
        places = [(begin + stop.at * (goal - begin), stop.for_s) for stop in self.profile.stops]
        if self.profile.turn_stop_s > 0.0:
            turns = turns_m(world.route, begin + BEFORE_TURN_M, goal)
            places += [(s_m - BEFORE_TURN_M, self.profile.turn_stop_s) for s_m in turns]
        return sorted(places)

    def _stop(self, world: World, speed: float) -> float:
        """Acceleration (m/s2) for the next stop; inf without one."""
        assert self.stands is not None
        while self.stands and world.route_s_m > self.stands[0][0] + STOP_WITHIN_M:
            del self.stands[0]
        if not self.stands:
            return math.inf
        place_m, left_s = self.stands[0]
        gap_m = place_m - world.route_s_m
        if speed < STANDING_MPS and gap_m < STOP_WITHIN_M:
            if left_s <= 0.0:
                del self.stands[0]
                return math.inf
            self.stands[0] = (place_m, left_s - 1.0 / DECISION_HZ)
        return stopping(speed, gap_m + 1.0)


def _felt(world: World, speed: float, wanted: float, offset_m: float) -> float:
    """Acceleration (m/s2) by what the bumper feels, and by lights and stop signs."""
    gap, closing = leader(world, route_window(world, offset_m))
    ahead = idm_acceleration(speed, wanted, gap, closing) if gap < SENSOR_M else math.inf
    return min(ahead, stopping(speed, stop_line_m(world)))
