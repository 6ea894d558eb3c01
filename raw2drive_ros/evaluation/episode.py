"""One closed-loop drive in process: the same driver, gate and message rounding as in the ROS graph."""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Callable
from dataclasses import dataclass, field

from msg_adapters.factory import RosbagsFactory
from msg_adapters.sensors import odometry_from_message, odometry_to_message
from raw2drive_ros.contract import Control, Decision, SensorFrame
from raw2drive_ros.driving.gate import Gate
from raw2drive_ros.evaluation.drivers import EpisodeDriver
from raw2drive_ros.evaluation.metrics import RouteResult, score_route
from raw2drive_ros.simulation.environment import DrivingEnv, Tick

OnTick = Callable[[Tick, Decision], None]


@dataclass(slots=True)
class Drive:
    """What one drive left behind. controls: every command, in order. tick_ms: wall time per tick."""

    result: RouteResult
    controls: list[Control] = field(default_factory=list)
    rewards: list[float] = field(default_factory=list)
    tick_ms: list[float] = field(default_factory=list)
    decide_ms: list[float] = field(default_factory=list)


def result_of(env: DrivingEnv) -> RouteResult:
    """The score of the episode that `env` has just driven."""
    assert env.world is not None
    criteria = env.criteria
    return score_route(
        env.scenario_name,
        env.seed_used,
        criteria.route_completion(env.world),
        criteria.events,
        criteria.failure,
        criteria.outside_percent,
        signs_obeyed=criteria.obeyed_signs_at_first_junction(env.world),
    )


def as_received(factory: RosbagsFactory, tick: Tick) -> SensorFrame:
    """The tick's frame as a subscriber gets it: yaw travels as a quaternion, which costs its last bits."""
    odometry = odometry_from_message(odometry_to_message(factory, tick.sensors.odometry))
    return dataclasses.replace(tick.sensors, odometry=odometry)


def drive_route(
    env: DrivingEnv,
    driver: EpisodeDriver,
    scenario: str,
    seed: int,
    on_tick: OnTick = lambda tick, decision: None,
    max_ticks: int | None = None,
) -> Drive:
    """Drive (scenario, seed) to its end, or for `max_ticks`."""
    factory = RosbagsFactory()
    gate = Gate()
    driver.reset(seed)
    tick, _ = env.reset(seed=seed, options={'scenario': scenario})
    drive = Drive(result_of(env))
    while not env.done and (max_ticks is None or len(drive.controls) < max_ticks):
        started = time.perf_counter()
        decision = driver.control(env, as_received(factory, tick), tick)
        drive.decide_ms.append((time.perf_counter() - started) * 1e3)
        control = gate.propose(decision, tick.stamp_ns * 1e-9)
        on_tick(tick, decision)
        tick, reward, *_ = env.step(control)
        drive.controls.append(control)
        drive.rewards.append(reward)
        drive.tick_ms.append((time.perf_counter() - started) * 1e3)
    drive.result = result_of(env)
    return drive
