"""Drives of a reference driver without a time limit: suites get their limits from them, memorisers their memories."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from raw2drive_ros.contracts.public import Decision
from raw2drive_ros.evaluation.driver_spec import DriverSpec
from raw2drive_ros.evaluation.drivers import DRIVERS
from raw2drive_ros.evaluation.episode import drive_route
from raw2drive_ros.evaluation.evaluate import Conditions, RouteRunner
from raw2drive_ros.evaluation.memoriser import EVERY_TICKS, Recorded, key_parameters, shape_of
from raw2drive_ros.simulation.environment import DrivingEnv, Tick
from raw2drive_ros.simulation.route_id import RouteId

REFERENCE, FALLBACK = 'expert', 'oracle'


@dataclass(frozen=True, slots=True)
class ReferenceDrive:
    """seconds: until the goal; None when no reference driver reached it. by: the driver."""

    seconds: float | None
    by: str
    memory: Recorded | None = None


@dataclass(frozen=True, slots=True)
class References:
    """Names of the driver whose times count, and of the one that is tried where it does not reach the goal, or ''."""

    driver: str = REFERENCE
    fallback: str = FALLBACK

    def names(self) -> tuple[str, ...]:
        """Those that exist, in the order in which they are tried. Raises UnknownDriverError for the first."""
        second = (self.fallback,) if self.fallback in DRIVERS and self.fallback != self.driver else ()
        return (self.driver, *second)


class ReferenceRunner:
    """One process's reference drivers and simulators. Raises UnknownDriverError."""

    def __init__(self, references: References) -> None:
        self.runners = [(name, RouteRunner(DriverSpec(name).build(), Conditions())) for name in references.names()]

    def drive(self, route: RouteId) -> ReferenceDrive:
        """The drive of the first driver that reaches the goal, or of the last one."""
        found = ReferenceDrive(None, '')
        for name, runner in self.runners:
            found = _drive(name, runner, route)
            if found.seconds is not None:
                break
        return found


class _Recorder:
    """Notes where the ego is, every `EVERY_TICKS` decisions."""

    def __init__(self, env: DrivingEnv) -> None:
        self.env = env
        self.ticks = 0
        self.moments: list[tuple[float, float, float, float]] = []

    def on_tick(self, tick: Tick, decision: Decision) -> None:
        """Called on every decision, before the world is stepped."""
        world = self.env.world
        assert world is not None
        if self.ticks % EVERY_TICKS == 0:
            way_m = world.route_s_m - world.scene.route.start_s_m
            self.moments.append((world.time_s, way_m, world.route_lateral_m, max(world.ego.speed, 0.0)))
        self.ticks += 1


def _drive(name: str, runner: RouteRunner, route: RouteId) -> ReferenceDrive:
    env = runner.env
    recorder = _Recorder(env)
    result = drive_route(env, runner.driver, route, recorder.on_tick, time_limit_s=math.inf).result
    if result.route_completion < 100.0:
        return ReferenceDrive(None, name)
    assert env.world is not None
    keys, shape = key_parameters(env.world), shape_of(env.world)
    memory = Recorded(route.type, route.seed, route.twin, keys, shape, np.array(recorder.moments))
    return ReferenceDrive(result.duration_s, name, memory)
