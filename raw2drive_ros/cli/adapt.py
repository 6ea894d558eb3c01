"""raw2drive adapt: commands for a vehicle that takes another message than ours."""

from __future__ import annotations

import argparse
from pathlib import Path

from msg_adapters.vehicle_commands import ADAPTERS
from raw2drive_ros.cli.domain_option import add_domain_argument
from raw2drive_ros.cli.graph_options import add_graph_arguments

EXAMPLES = 'what vehicles take:\n' + '\n'.join(
    f'  {name:10} {adapter.msgtype:42} {adapter.topic}' for name, adapter in ADAPTERS.items()
)
EXAMPLES += """

examples:
  raw2drive adapt twist                                   /control/command as TwistStamped on /cmd_vel
  raw2drive adapt ackermann --topic /car/drive --config my_car.yaml

Speeds are asked for as far ahead as --horizon says, from the speed on /vehicle/odometry; without that, or without a
command for 0.3 s, a standstill. my_car.yaml is the file that the safety gate takes, with the car's own figures."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add_graph_arguments(parser)
    parser.add_argument('output', choices=tuple(ADAPTERS), help='what the vehicle takes')
    parser.add_argument('--topic', default='', help='where it listens (default: see below)')
    parser.add_argument('--config', type=Path, help="the car's figures (default: params/gate.yaml)")
    parser.add_argument('--horizon', type=float, default=0.5, help='seconds; of its speed controller')
    add_domain_argument(parser)
    parser.add_argument('--sim-time', action='store_true', help='the vehicle publishes /clock')


def run(options: argparse.Namespace) -> int:
    from raw2drive_ros.contracts.errors import UsageError
    from raw2drive_ros.driving.gate_config import load_gate_config
    from raw2drive_ros.graph.foreground import run_single

    if not options.horizon > 0:
        raise UsageError('--horizon must be positive')
    load_gate_config(options.config)
    parameters = {
        'output': options.output,
        'topic': options.topic,
        'config': str(options.config.resolve()) if options.config else '',
        'horizon_s': options.horizon,
    }
    return run_single(
        {'command_adapter': parameters}, options.domain, namespace=options.namespace, sim_time=options.sim_time
    )
