"""Checks and measurements of an installation: versions, transport, shared memory, latency, and the time of a stop.

Packages are imported late, because these checks also have to run where one of them is missing.
"""

from __future__ import annotations

import os
import platform
import shutil
from importlib import metadata
from pathlib import Path
from typing import Any

PACKAGES = ('torch', 'numpy', 'opencv-python-headless', 'highway-env', 'gymnasium', 'rosbags', 'rclpy', 'av')
# Each node's transport takes 32 MB of shared memory.
LEAST_SHARED_MEMORY_BYTES = 200e6


def examine(bundle: Path | None = None, *, quick: bool = False) -> dict[str, Any]:
    """All findings as a dictionary for JSON; `problems` holds a sentence for each thing that is wrong.

    bundle: policy bundle to measure; None: the shipped one. quick: leave out `latency_ms` and `stopping`, which drive
    some seconds in the simulation. May set environment variables of the transport, as every node does at its start.
    """
    problems: list[str] = []
    found: dict[str, Any] = {
        'python': platform.python_version(),
        'machine': platform.machine(),
        'cores': os.cpu_count(),
        'versions': _versions(problems),
        'transport': _transport(problems),
        'disk_free_mb': round(shutil.disk_usage('.').free / 1e6),
        'shared_memory_free_mb': _shared_memory(problems),
        'timing': _timing(),
    }
    if not quick:
        found['latency_ms'] = _latency(bundle, problems)
        found['stopping'] = _stopping(bundle, problems)
    found['problems'] = problems
    return found


def _versions(problems: list[str]) -> dict[str, str]:
    found = {}
    for name in PACKAGES:
        try:
            found[name] = metadata.version(name)
        except metadata.PackageNotFoundError:
            if name == 'rclpy':
                problems.append('rclpy is missing: pip install "raw2drive_ros[ros]", or source a ROS 2 Jazzy setup')
            else:
                problems.append(f'{name} is missing: pip install {name}')
    return found


def _transport(problems: list[str]) -> dict[str, Any]:
    from raw2drive_ros.nodes.transport import configure_transport, network_is_open, profile_in_force, shipped_profile

    before = profile_in_force()
    problems += configure_transport()
    current = profile_in_force()
    return {
        'set_by_user': before,
        'in_force': current,
        'shipped_profile_in_force': current is not None and Path(current).resolve() == shipped_profile().resolve(),
        'network': network_is_open(),
        'discovery_range': os.environ.get('ROS_AUTOMATIC_DISCOVERY_RANGE'),
        'domain': os.environ.get('ROS_DOMAIN_ID', '0'),
    }


def _shared_memory(problems: list[str]) -> int | None:
    folder = Path('/dev/shm')
    if not folder.is_dir():
        problems.append('/dev/shm is missing: DDS falls back to UDP and may lose images')
        return None
    free = shutil.disk_usage(folder).free
    if free < LEAST_SHARED_MEMORY_BYTES:
        problems.append(
            f'{free / 1e6:.0f} MB free in /dev/shm; each node needs 32 MB: run `fastdds shm clean`, or '
            'give a container --shm-size=1g'
        )
    return round(free / 1e6)


def _timing() -> dict[str, float]:
    """Rates and times of the contract, and the longest time from a dead planner to each kind of stop that follows."""
    from raw2drive_ros.tables.rates import DECISION_HZ, PHYSICS_HZ
    from raw2drive_ros.timing import load_timing

    timing = load_timing()
    period = 1.0 / timing.gate_rate_hz
    rates = {'decision_rate_hz': float(DECISION_HZ), 'physics_rate_hz': float(PHYSICS_HZ)}
    stops = {
        'dead_planner_to_comfortable_stop_s': timing.comfortable_after_s + period,
        'dead_planner_to_emergency_stop_s': timing.emergency_after_s + period,
    }
    return rates | timing.model_dump() | stops


def _latency(bundle: Path | None, problems: list[str]) -> dict[str, Any] | None:
    """Percentiles of the time from images to command over 100 ticks, the first five of which do not count."""
    import numpy as np

    from raw2drive_ros.contracts.errors import BundleError
    from raw2drive_ros.driving.bundle import load_bundle
    from raw2drive_ros.driving.raw_driver import RawDriver
    from raw2drive_ros.evaluation.episode import drive_route
    from raw2drive_ros.evaluation.episode_driver import SensorDriver
    from raw2drive_ros.settings import default_bundle
    from raw2drive_ros.simulation.environment import DrivingEnv, SimulationConfig
    from raw2drive_ros.simulation.route_id import RouteId

    try:
        driver = RawDriver(load_bundle(bundle or default_bundle()))
    except BundleError as error:
        problems.append(str(error))
        return None
    env = DrivingEnv(SimulationConfig(end_on_infraction=False))
    drive = drive_route(env, SensorDriver(driver, cameras=True), RouteId('LaneFollowing', 0), max_ticks=100)
    p50, p99 = np.percentile(drive.decide_ms[5:], [50, 99])
    return {'images_to_command_p50': round(float(p50), 2), 'images_to_command_p99': round(float(p99), 2)}


def _stopping(bundle: Path | None, problems: list[str]) -> dict[str, Any] | None:
    """From a dead planner to a standing car: as the contract computes it at the measured speed, and as measured."""
    from dataclasses import asdict

    from raw2drive_ros.contracts.errors import BundleError
    from raw2drive_ros.evaluation.stopping import computed, measured
    from raw2drive_ros.settings import default_bundle
    from raw2drive_ros.tables.rates import DECISION_HZ

    try:
        seen = measured(bundle or default_bundle())
    except BundleError:
        return None
    promised = computed(seen.speed_mps)
    period_s = 1.0 / DECISION_HZ
    if seen.total_s > promised.total_s + period_s:
        problems.append(f'a stop took {seen.total_s:.2f} s, the contract adds up to {promised.total_s:.2f} s')
    return {
        name: asdict(found) | {'total_s': found.total_s} for name, found in (('computed', promised), ('measured', seen))
    }
