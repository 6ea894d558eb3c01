"""`params/gate.yaml`, validated, together with the gate's share of `params/timing.yaml`."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Annotated

from pydantic import Field

from raw2drive_ros.contracts.errors import ConfigError
from raw2drive_ros.driving.gate_limits import MotionLimits
from raw2drive_ros.driving.gate_state import GateLimits
from raw2drive_ros.settings import Strict, load_strict, params_folder
from raw2drive_ros.timing import Timing

Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]
Bound = Annotated[float, Field(gt=0)]
Pedal = Annotated[float, Field(gt=0, le=1)]


class MotionConfig(Strict):
    """See `MotionLimits`. Every field is required: a forgotten limit must not pass for a disabled one (`.inf`)."""

    wheelbase_m: Positive
    max_steer_rad: Annotated[float, Field(gt=0, lt=math.pi / 2)]
    full_throttle_mps2: Positive
    full_brake_mps2: Positive
    max_speed_mps: Bound
    max_acceleration_mps2: Bound
    max_deceleration_mps2: Bound
    max_jerk_mps3: Bound
    max_steer: Annotated[float, Field(gt=0, le=1)]
    max_steer_rate_1ps: Bound
    max_lateral_mps2: Bound
    max_gear_speed_mps: Bound


class StopConfig(Strict):
    """See `GateLimits`."""

    comfortable_brake: Pedal
    comfortable_brake_rate_1ps: Positive
    emergency_brake: Pedal
    hold_brake: Pedal
    speed_margin_mps: Positive
    standing_mps: Positive
    slowing_after_s: Positive
    slowing_mps: Positive
    swing: Positive
    swings: int = Field(ge=2)
    swing_window_s: Positive
    saturated_after_s: Positive


class GateConfig(Strict):
    """The whole file."""

    motion: MotionConfig
    stop: StopConfig

    def motion_limits(self) -> MotionLimits:
        return MotionLimits(**self.motion.model_dump())

    def gate_limits(self, timing: Timing) -> GateLimits:
        ages = (
            'activation_expires_s',
            'comfortable_after_s',
            'emergency_after_s',
            'proposal_age_s',
            'odometry_after_s',
        )
        found = {name: getattr(timing, name) for name in (*ages, 'clock_back_s', 'frozen_odometry')}
        return GateLimits(**found, **self.stop.model_dump())


def load_gate_config(path: Path | None = None) -> GateConfig:
    """The shipped file, or another one. Raises ConfigError that names the field."""
    file = path or params_folder() / 'gate.yaml'
    found = load_strict(GateConfig, file)
    if found.stop.comfortable_brake > found.stop.emergency_brake:
        raise ConfigError(f'{file}: stop.comfortable_brake is above stop.emergency_brake')
    return found
