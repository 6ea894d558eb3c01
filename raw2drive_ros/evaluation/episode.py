"""One closed-loop drive in process: the same driver, gate and message rounding as in the ROS graph."""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from msg_adapters.factory import MessageFactory, RosbagsFactory
from msg_adapters.sensors import odometry_from_message, odometry_to_message
from raw2drive_ros.contracts.public import Control, Decision, SensorFrame, VehicleStatus
from raw2drive_ros.driving.gate import Gate
from raw2drive_ros.driving.gate_config import load_gate_config
from raw2drive_ros.driving.gate_state import Moment
from raw2drive_ros.evaluation.comfort import comfort_percent
from raw2drive_ros.evaluation.episode_driver import EpisodeDriver
from raw2drive_ros.evaluation.metrics import RouteResult, efficiency_percent, score_route
from raw2drive_ros.simulation.environment import DrivingEnv, Tick
from raw2drive_ros.simulation.route_id import RouteId
from raw2drive_ros.timing import load_timing

OnTick = Callable[[Tick, Decision], None]


@dataclass(slots=True)
class Drive:
    """The record of one drive. controls: every command, in order. terms: the terms of the reward, per tick.
    tick_ms: wall time per tick; decide_ms: that of the driver's decision alone."""

    result: RouteResult
    controls: list[Control] = field(default_factory=list)
    rewards: list[float] = field(default_factory=list)
    terms: list[dict[str, float]] = field(default_factory=list)
    tick_ms: list[float] = field(default_factory=list)
    decide_ms: list[float] = field(default_factory=list)


def result_of(env: DrivingEnv, *, bench2drive_compat: bool = False) -> RouteResult:
    """The score of the episode that `env` has just driven. bench2drive_compat: as Bench2Drive's tools compute it."""
    assert env.world is not None
    criteria = env.criteria
    return score_route(
        env.route_id,
        criteria.route_completion(env.world),
        criteria.events,
        criteria.failure,
        criteria.outside_percent,
        signs_obeyed=criteria.obeyed_signs_at_first_junction(env.world),
        duration_s=env.world.time_s,
        reward=env.reward_sum,
        efficiency=efficiency_percent(criteria.traffic_speed_percents(), bench2drive_compat=bench2drive_compat),
        comfort=comfort_percent(np.array(env.motion).reshape(-1, 3), bench2drive_compat=bench2drive_compat),
        limit_s=criteria.limit_s(env.world),
        needless_stop_s=criteria.needless_stop_s,
    )


def driver_seed(route: RouteId) -> int:
    """Seed of a driver's own random numbers on this route and repetition."""
    return route.seed + 1_000_000 * route.repetition


def as_received(factory: MessageFactory, tick: Tick) -> SensorFrame:
    """The tick's frame as a subscriber gets it: yaw is sent as a quaternion, which changes its last bits."""
    odometry = odometry_from_message(odometry_to_message(factory, tick.sensors.odometry))
    return dataclasses.replace(tick.sensors, odometry=odometry)


def lock_step_gate() -> Gate:
    """Configured as the gate node in lock-step: silence is measured in ROS time, limits and stops are as shipped."""
    config = load_gate_config()
    return Gate(config.gate_limits(load_timing()), config.motion_limits(), steady=False, simulated=True)


def drive_route(
    env: DrivingEnv,
    driver: EpisodeDriver,
    route: RouteId,
    on_tick: OnTick = lambda tick, decision: None,
    max_ticks: int | None = None,
    *,
    bench2drive_compat: bool = False,
    time_limit_s: float | None = None,
) -> Drive:
    """Drive a route to its end, or for `max_ticks`; time_limit_s: that of the suite, None for the scene's own."""
    factory = RosbagsFactory()
    gate = lock_step_gate()
    driver.reset(driver_seed(route))
    tick, _ = env.reset_to(route, time_limit_s)
    drive = Drive(result_of(env, bench2drive_compat=bench2drive_compat))
    while not env.done and (max_ticks is None or len(drive.controls) < max_ticks):
        started = time.perf_counter()
        decision = driver.control(env, as_received(factory, tick), tick)
        drive.decide_ms.append((time.perf_counter() - started) * 1e3)
        now = Moment(time.monotonic(), tick.stamp_ns * 1e-9)
        speed_mps = tick.sensors.odometry.speed_mps
        # As the bridge reports it: the car was put at the route's start, where it may move already.
        gate.vehicle(VehicleStatus(tick.stamp_ns, speed_mps, placed=1, ticks=len(drive.controls)), now)
        gate.observe(speed_mps, now)
        control = gate.propose(decision, now)
        on_tick(tick, decision)
        tick, reward, *_ = env.step(control)
        drive.controls.append(control)
        drive.rewards.append(reward)
        drive.terms.append(tick.info['reward_terms'])
        drive.tick_ms.append((time.perf_counter() - started) * 1e3)
    drive.result = result_of(env, bench2drive_compat=bench2drive_compat)
    return drive
