"""raw2drive doctor: what is installed, which transport is in force, and where the milliseconds go."""

from __future__ import annotations

import argparse
import json
import os
import platform
import shutil
import sys
from importlib import metadata
from pathlib import Path
from typing import Any

EXAMPLES = """examples:
  raw2drive doctor
  raw2drive doctor --quick          without the latency measurement
  raw2drive doctor --json"""

PACKAGES = ('torch', 'numpy', 'opencv-python-headless', 'highway-env', 'gymnasium', 'rosbags', 'rclpy', 'av')


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument('--quick', action='store_true', help='skip the latency measurement')
    parser.add_argument('--bundle', type=Path, help='policy bundle to measure (default: the shipped one)')
    parser.add_argument('--json', action='store_true')


def run(options: argparse.Namespace) -> int:
    problems: list[str] = []
    body: dict[str, Any] = {
        'python': platform.python_version(),
        'machine': platform.machine(),
        'cores': os.cpu_count(),
        'versions': _versions(problems),
        'transport': _transport(problems),
        'disk_free_mb': round(shutil.disk_usage('.').free / 1e6),
        'shared_memory_free_mb': _shared_memory(problems),
        'timing': _timing(),
    }
    if not options.quick:
        body['latency_ms'] = _latency(options.bundle, problems)
        body['stopping'] = _stopping(options.bundle, problems)
    body['problems'] = problems
    if options.json:
        print(json.dumps(body))
    else:
        _print(body)
    return 1 if problems else 0


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
    from raw2drive_ros.nodes.transport import configure_transport, profile_in_force, shipped_profile

    before = profile_in_force()
    problems += configure_transport()
    current = profile_in_force()
    return {
        'set_by_user': before,
        'in_force': current,
        'shipped_profile_in_force': current is not None and Path(current).resolve() == shipped_profile().resolve(),
        'discovery_range': os.environ.get('ROS_AUTOMATIC_DISCOVERY_RANGE'),
        'domain': os.environ.get('ROS_DOMAIN_ID', '0'),
    }


def _shared_memory(problems: list[str]) -> int | None:
    folder = Path('/dev/shm')
    if not folder.is_dir():
        problems.append('/dev/shm is missing: DDS falls back to UDP and may lose images')
        return None
    free = shutil.disk_usage(folder).free
    if free < 200e6:
        problems.append(
            f'{free / 1e6:.0f} MB free in /dev/shm; each node needs 32 MB: run `fastdds shm clean`, or '
            'give a container --shm-size=1g'
        )
    return round(free / 1e6)


def _timing() -> dict[str, float]:
    """The contract, and the time from a dead planner to full braking that follows from it."""
    from raw2drive_ros.rates import DECISION_HZ, PHYSICS_HZ
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
    import numpy as np

    from raw2drive_ros.driving.bundle import load_bundle
    from raw2drive_ros.driving.raw_driver import RawDriver
    from raw2drive_ros.errors import BundleError
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
    """Dead planner to standing car: the contract's sum at the speed that was measured, and the measurement."""
    from dataclasses import asdict

    from raw2drive_ros.errors import BundleError
    from raw2drive_ros.evaluation.stopping import computed, measured
    from raw2drive_ros.rates import DECISION_HZ
    from raw2drive_ros.settings import default_bundle

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


def _print(body: dict[str, Any]) -> None:
    print(f'python {body["python"]} on {body["machine"]}, {body["cores"]} cores')
    for name, version in body['versions'].items():
        print(f'  {name} {version}')
    transport = body['transport']
    state = 'shipped profile' if transport['shipped_profile_in_force'] else f'OTHER profile {transport["in_force"]}'
    print(f'transport: {state}, discovery {transport["discovery_range"]}, domain {transport["domain"]}')
    print(f'free: {body["disk_free_mb"]} MB on disk, {body["shared_memory_free_mb"]} MB shared memory')
    timing = body['timing']
    print(
        f'dead planner: comfortable stop begins after at most {timing["dead_planner_to_comfortable_stop_s"]:.2f} s, '
        f'emergency stop after {timing["dead_planner_to_emergency_stop_s"]:.2f} s'
    )
    if body.get('latency_ms'):
        latency = body['latency_ms']
        budget = 1000.0 / timing['decision_rate_hz']
        print(
            f'images to command: p50 {latency["images_to_command_p50"]} ms, '
            f'p99 {latency["images_to_command_p99"]} ms of {budget:.0f} ms'
        )
    tick_s = 1.0 / timing['decision_rate_hz']
    how = {'computed': 'computed for a car', 'measured': f'measured in lock-step (whole ticks of {tick_s:g} s)'}
    for name, found in (body.get('stopping') or {}).items():
        print(
            f'dead planner at {found["speed_mps"]:.1f} m/s, {how[name]}: detection {found["detection_s"]:.2f} + '
            f'reaction {found["reaction_s"]:.2f} + settle {found["settle_s"]:.2f} = {found["total_s"]:.2f} s, '
            f'{found["distance_m"]:.1f} m'
        )
    for problem in body['problems']:
        print(f'PROBLEM: {problem}', file=sys.stderr)
    print('all well' if not body['problems'] else f'{len(body["problems"])} problems')
