"""Nodes of the driver's side and their parameters: what `raw2drive drive` and `driver.launch.py` start."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any


@dataclass(frozen=True, slots=True, kw_only=True)
class DriverOptions:
    """Options of `raw2drive drive` under their names there; times in seconds. gate, monitor: None: the shipped file."""

    bundle: Path
    lock_step: bool = False
    sim_time: bool = False
    image_transport: str = 'raw'
    sensor_reliability: str = 'reliable'
    interpolate_age: float = 0.0
    camera_skew: float = 0.0
    gate: Path | None = None
    monitor: Path | None = None


def is_simulated(options: DriverOptions) -> bool:
    """Whether the stamps are those of /clock."""
    return options.lock_step or options.sim_time


def driver_nodes(options: DriverOptions) -> dict[str, dict[str, Any]]:
    """Executable -> its parameters, without `use_sim_time`; files with absolute paths."""
    return {
        'safety_gate': {
            'clock': 'ros' if options.lock_step else 'steady',
            'simulated': is_simulated(options),
            'config': str(options.gate.resolve()) if options.gate else '',
            'sensor_reliability': options.sensor_reliability,
        },
        'planner': {
            'bundle': str(options.bundle.resolve()),
            'image_transport': options.image_transport,
            'sensor_reliability': options.sensor_reliability,
            'interpolate_age_s': float(options.interpolate_age),
            'camera_skew_s': float(options.camera_skew),
            'monitor': str(options.monitor.resolve()) if options.monitor else '',
        },
    }
