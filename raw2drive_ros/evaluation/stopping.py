"""From a dead planner to a standing car: computed from the contract, and measured in the simulator."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from raw2drive_ros.contracts import topics
from raw2drive_ros.driving.bundle import load_bundle
from raw2drive_ros.driving.gate_config import load_gate_config
from raw2drive_ros.driving.monitor_config import load_monitor_config
from raw2drive_ros.driving.raw_planner import RawPlanner
from raw2drive_ros.evaluation.faulty_drive import drive_with_faults
from raw2drive_ros.faults.injector import Injector
from raw2drive_ros.faults.plan import Fault
from raw2drive_ros.simulation.environment import DrivingEnv, SimulationConfig
from raw2drive_ros.simulation.route_id import RouteId
from raw2drive_ros.tables.rates import DECISION_HZ
from raw2drive_ros.timing import load_timing

DT_S = 0.001


@dataclass(frozen=True, slots=True)
class Stopping:
    """detection_s: from the last proposal until the gate detects the silence. reaction_s: from there until the braking
    command is published (a period of the gate). settle_s: from there until the car stands. distance_m: driven since
    the last proposal.
    """

    speed_mps: float
    detection_s: float
    reaction_s: float
    settle_s: float
    distance_m: float

    @property
    def total_s(self) -> float:
        return self.detection_s + self.reaction_s + self.settle_s


def computed(speed_mps: float) -> Stopping:
    """The stop that `params/timing.yaml` and `params/gate.yaml` specify: comfortable braking, then emergency braking.

    The car coasts until the gate brakes; drag is left out, so that a real stop is shorter.
    """
    timing, config = load_timing(), load_gate_config()
    stop, full = config.stop, config.motion.full_brake_mps2
    reaction_s = 1.0 / timing.gate_rate_hz
    lead_s = timing.comfortable_after_s + reaction_s
    emergency_s = timing.emergency_after_s - timing.comfortable_after_s
    speed, distance, settle = speed_mps, speed_mps * lead_s, 0.0
    while speed > 0.0:
        gentle = min(stop.comfortable_brake, settle * stop.comfortable_brake_rate_1ps)
        brake = stop.emergency_brake if settle >= emergency_s else gentle
        distance += speed * DT_S
        speed -= brake * full * DT_S
        settle += DT_S
    return Stopping(speed_mps, timing.comfortable_after_s, reaction_s, settle, distance)


def measured(bundle: Path, after_s: float = 3.0) -> Stopping:
    """Drive the policy, drop every proposal from `after_s` on, measure the stop; in lock-step, so in whole ticks."""
    planner = RawPlanner(load_bundle(bundle), load_monitor_config().limits(load_timing()))
    env = DrivingEnv(SimulationConfig(bev=False, end_on_infraction=False))
    fault = Fault(topic=topics.PROPOSED, kind='drop', start_s=after_s)
    speeds: list[float] = []
    drive = drive_with_faults(
        env,
        planner,
        Injector([fault]),
        RouteId('LaneFollowing', 1),
        lambda tick, gate: speeds.append(tick.sensors.odometry.speed_mps),
    )
    assert drive.stop_s is not None and drive.stand_s is not None
    period_s = 1.0 / DECISION_HZ
    last = round(after_s / period_s) - 1
    distance = sum(speeds[last:]) * period_s
    # The tick in which the gate stops is the first whose command brakes.
    return Stopping(speeds[last], drive.stop_s - last * period_s, 0.0, drive.stand_s - drive.stop_s, distance)
