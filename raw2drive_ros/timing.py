"""`params/timing.yaml`, validated: ages, deadlines, the gate's rate. Rates that are fixed: `tables/rates.py`."""

from __future__ import annotations

from pathlib import Path

from pydantic import Field

from raw2drive_ros.settings import Strict, load_strict, params_folder


class Timing(Strict):
    """Seconds and hertz."""

    gate_rate_hz: float = Field(ge=20)
    comfortable_after_s: float = Field(gt=0)
    emergency_after_s: float = Field(gt=0)
    proposal_age_s: float = Field(gt=0)
    odometry_after_s: float = Field(gt=0)
    clock_back_s: float = Field(ge=0)
    activation_expires_s: float = Field(gt=0)
    frozen_odometry: int = Field(gt=0)
    input_age_s: float = Field(gt=0)
    degraded_gap_s: float = Field(gt=0)
    stop_gap_s: float = Field(gt=0)
    gap_count: int = Field(ge=2)
    command_hold_s: float = Field(gt=0)
    command_brake: float = Field(gt=0, le=1)
    lock_step_timeout_s: float = Field(gt=0)
    discovery_timeout_s: float = Field(gt=0)


def load_timing(path: Path | None = None) -> Timing:
    """Read `path`, or the shipped file. Raises ConfigError that names the field."""
    return load_strict(Timing, path or params_folder() / 'timing.yaml')
