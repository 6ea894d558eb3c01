"""Drives of which only the verdict counts: without sensors, and over as soon as they have failed.

The verdict is that of `episode.drive_route` (a test compares): same gate, same criteria.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass

from raw2drive_ros.contracts.actions import nearest_action
from raw2drive_ros.contracts.public import Control, Decision, VehicleStatus
from raw2drive_ros.driving.gate_state import Moment
from raw2drive_ros.evaluation.episode import lock_step_gate, result_of
from raw2drive_ros.simulation.criteria import Criteria
from raw2drive_ros.simulation.environment import DrivingEnv, SimulationConfig
from raw2drive_ros.simulation.route_id import RouteId
from raw2drive_ros.simulation.world import World

Decide = Callable[[World], Control]
# (time s, arc length on the route m, lateral offset m, speed m/s).
Moments = list[tuple[float, float, float, float]]


@dataclass(frozen=True, slots=True)
class Verdict:
    """cause: the first infraction or failure; '' for a success. seconds, s_m: time and arc length until then."""

    success: bool
    cause: str
    seconds: float
    s_m: float = 0.0


def sensorless_env() -> DrivingEnv:
    """A simulator without cameras and masks; drives go on after infractions, as in an evaluation."""
    return DrivingEnv(SimulationConfig(cameras=False, bev=False, end_on_infraction=False))


def spoiled(criteria: Criteria) -> str:
    """The first infraction or failure of a drive that can no longer succeed, or ''."""
    if criteria.events:
        return next(iter(criteria.events))
    return criteria.failure or ('outside_lanes' if criteria.outside_percent > 0.0 else '')


def quick_drive(env: DrivingEnv, decide: Decide, route: RouteId, limit_s: float | None = None) -> Verdict:
    """Drive until the goal is reached or the drive has failed."""
    gate = lock_step_gate()
    tick, _ = env.reset_to(route, limit_s)
    assert env.world is not None
    number = 0
    while not env.done:
        control = decide(env.world)
        now = Moment(time.monotonic(), tick.stamp_ns * 1e-9)
        speed_mps = tick.sensors.odometry.speed_mps
        gate.vehicle(VehicleStatus(tick.stamp_ns, speed_mps, placed=1, ticks=number), now)
        gate.observe(speed_mps, now)
        tick, *_ = env.step(gate.propose(Decision(tick.stamp_ns, control, nearest_action(control)), now))
        number += 1
        if cause := spoiled(env.criteria):
            return Verdict(success=False, cause=cause, seconds=env.world.time_s, s_m=env.world.route_s_m)
    success = result_of(env).success
    cause = '' if success else spoiled(env.criteria) or 'incomplete'
    return Verdict(success, cause, env.world.time_s, env.world.route_s_m)
