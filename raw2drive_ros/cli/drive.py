"""raw2drive drive: planner and safety gate on whatever vehicle is in the graph."""

from __future__ import annotations

import argparse
from pathlib import Path

from raw2drive_ros.cli.domain_option import add_domain_argument

EXAMPLES = """examples:
  raw2drive drive                                   the shipped policy, wall-clock gate
  raw2drive drive --bundle runs/bundle --lock-step  for a bridge in lock-step
  raw2drive drive --gate my_car.yaml                your car's limits (a copy of params/gate.yaml)
  raw2drive drive --sim-time                        for a simulation in real time: stamps are those of /clock

When the planner dies, the gate stops the car before everything ends, and so it does on Ctrl-C.
The gate's stop is latched; once the car stands: raw2drive call /safety_gate/activate [--domain N]"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument('--bundle', type=Path, help='policy bundle (default: the shipped one)')
    parser.add_argument('--lock-step', action='store_true', help='measure silence by /clock instead of the wall')
    parser.add_argument('--sim-time', action='store_true', help='stamps are those of /clock, silence goes by the wall')
    parser.add_argument('--image-transport', choices=('raw', 'compressed'), default='raw', help='image topics in use')
    parser.add_argument('--gate', type=Path, help='file like params/gate.yaml: limits and stops of your car')
    parser.add_argument('--monitor', type=Path, help='file like params/monitor.yaml: what counts as a bad sensor')
    add_domain_argument(parser)


def run(options: argparse.Namespace) -> int:
    from raw2drive_ros.driving.bundle import load_bundle
    from raw2drive_ros.driving.gate_config import load_gate_config
    from raw2drive_ros.driving.monitor_config import load_monitor_config
    from raw2drive_ros.graph.foreground import run_single
    from raw2drive_ros.settings import default_bundle

    bundle = (options.bundle or default_bundle()).resolve()
    load_bundle(bundle)
    load_gate_config(options.gate)
    load_monitor_config(options.monitor)
    simulated = options.lock_step or options.sim_time
    nodes = {
        'safety_gate': {
            'clock': 'ros' if options.lock_step else 'steady',
            'simulated': simulated,
            'config': str(options.gate.resolve()) if options.gate else '',
        },
        'planner': {
            'bundle': str(bundle),
            'image_transport': options.image_transport,
            'monitor': str(options.monitor.resolve()) if options.monitor else '',
        },
    }
    # The gate stops the car before it ends, both when the planner dies and when it is asked to end.
    return run_single(nodes, options.domain, sim_time=simulated, end_within_s=10.0, survivor='safety_gate')
