"""raw2drive drive: planner and safety gate on whatever vehicle is in the graph."""

from __future__ import annotations

import argparse
from pathlib import Path

EXAMPLES = """examples:
  raw2drive drive                                   the shipped policy, wall-clock gate
  raw2drive drive --bundle runs/bundle --lock-step  for a bridge in lock-step
  raw2drive drive --sim-time                        for a simulation in real time: stamps are those of /clock

The gate's stop is latched; re-activate with the service /safety_gate/activate (std_srvs/Trigger)."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument('--bundle', type=Path, help='policy bundle (default: the shipped one)')
    parser.add_argument('--lock-step', action='store_true', help='measure silence by /clock instead of the wall')
    parser.add_argument('--sim-time', action='store_true', help='stamps are those of /clock, silence goes by the wall')
    parser.add_argument('--image-transport', choices=('raw', 'compressed'), default='raw', help='image topics in use')
    parser.add_argument('--domain', type=int, default=0, help='ROS domain')


def run(options: argparse.Namespace) -> int:
    from raw2drive_ros.cli.single import run_single
    from raw2drive_ros.driving.bundle import load_bundle
    from raw2drive_ros.paths import default_bundle

    bundle = (options.bundle or default_bundle()).resolve()
    load_bundle(bundle)
    simulated = options.lock_step or options.sim_time
    nodes = {
        'safety_gate': {'clock': 'ros' if options.lock_step else 'steady', 'simulated': simulated},
        'planner': {'bundle': str(bundle), 'image_transport': options.image_transport},
    }
    return run_single(nodes, options.domain, sim_time=simulated)
