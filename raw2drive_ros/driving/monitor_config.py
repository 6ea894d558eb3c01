"""`params/monitor.yaml`, validated, together with the planner's share of `params/timing.yaml`."""

from __future__ import annotations

from pathlib import Path

from pydantic import Field

from raw2drive_ros.driving.sensor_monitor import MonitorLimits
from raw2drive_ros.settings import Strict, load_strict, params_folder
from raw2drive_ros.tables.rates import DECISION_HZ
from raw2drive_ros.timing import Timing


class MonitorConfig(Strict):
    """See `MonitorLimits`."""

    blind_levels: int = Field(ge=0, le=255)
    blind_frames: int = Field(ge=1)
    frozen_frames: int = Field(ge=1)
    moving_mps: float = Field(gt=0)
    max_force_mps2: float = Field(gt=9.81)
    max_rate_radps: float = Field(gt=0)
    absurd_samples: int = Field(ge=1)
    memory_s: float = Field(gt=0)

    def limits(self, timing: Timing) -> MonitorLimits:
        return MonitorLimits(
            period_s=1.0 / DECISION_HZ,
            age_s=timing.input_age_s,
            degraded_gap_s=timing.degraded_gap_s,
            stop_gap_s=timing.stop_gap_s,
            gaps=timing.gap_count,
            **self.model_dump(),
        )


def load_monitor_config(path: Path | None = None) -> MonitorConfig:
    """The shipped file, or another one. Raises ConfigError that names the field."""
    return load_strict(MonitorConfig, path or params_folder() / 'monitor.yaml')
