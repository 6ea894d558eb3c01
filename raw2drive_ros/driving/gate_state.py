"""States of the safety gate, the instants it reasons about, and its times and brakes."""

from __future__ import annotations

import enum
from dataclasses import dataclass


class GateState(enum.Enum):
    """waiting: no proposal yet, brake held. driving: proposals pass. comfortable_stop, emergency_stop: latched until
    `activate`. handed_over: the vehicle's driver has taken over; latched too."""

    WAITING = 'waiting'
    DRIVING = 'driving'
    COMFORTABLE_STOP = 'comfortable_stop'
    EMERGENCY_STOP = 'emergency_stop'
    HANDED_OVER = 'handed_over'


STOPS = (GateState.COMFORTABLE_STOP, GateState.EMERGENCY_STOP, GateState.HANDED_OVER)


@dataclass(frozen=True, slots=True)
class Moment:
    """One instant on both clocks, in seconds. ros_s: ROS time (/clock or system time), the clock of message stamps."""

    steady_s: float
    ros_s: float


@dataclass(frozen=True, slots=True)
class GateLimits:
    """Times in seconds, brakes as pedals [0, 1]; `params/timing.yaml` and `params/gate.yaml` say what each is for."""

    comfortable_after_s: float = 0.3
    emergency_after_s: float = 0.8
    frozen_odometry: int = 20
    proposal_age_s: float = 0.3
    odometry_after_s: float = 0.5
    clock_back_s: float = 0.05
    comfortable_brake: float = 0.15
    comfortable_brake_rate_1ps: float = 0.5
    emergency_brake: float = 0.6
    hold_brake: float = 0.3
    speed_margin_mps: float = 2.0
    standing_mps: float = 0.3
    slowing_after_s: float = 2.0
    slowing_mps: float = 0.5
    swing: float = 1.0
    swings: int = 10
    swing_window_s: float = 2.0
    saturated_after_s: float = 5.0
    activation_expires_s: float = 10.0
