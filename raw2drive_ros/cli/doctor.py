"""raw2drive doctor: prints what is installed, which transport is in force, and the latency budget."""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path
from typing import Any

from raw2drive_ros.cli.parser import refuse

EXAMPLES = """examples:
  raw2drive doctor
  raw2drive doctor --quick          without the latency measurement
  raw2drive doctor --json"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument('--quick', action='store_true', help='skip the latency measurement')
    parser.add_argument('--bundle', type=Path, help='policy bundle to measure (default: the shipped one)')
    parser.add_argument('--json', action='store_true')


def run(options: argparse.Namespace) -> int:
    from raw2drive_ros.graph.doctor import examine

    if options.quick:
        refuse(options, ['bundle'], 'its latency is what --quick does not measure')
    body = examine(options.bundle, quick=options.quick)
    if options.json:
        print(json.dumps(body))
    else:
        _print(body)
    return 1 if body['problems'] else 0


def _print(body: dict[str, Any]) -> None:
    print(f'python {body["python"]} on {body["machine"]}, {body["cores"]} cores')
    for name, version in body['versions'].items():
        print(f'  {name} {version}')
    transport = body['transport']
    shipped = 'shipped profile, ' + ('OPEN to the network' if transport['network'] else 'this machine only')
    state = shipped if transport['shipped_profile_in_force'] else f'OTHER profile {transport["in_force"]}'
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
