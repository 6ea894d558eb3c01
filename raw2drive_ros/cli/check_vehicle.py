"""raw2drive check-vehicle: does the vehicle in the graph keep its side of the contract?"""

from __future__ import annotations

import argparse
import json
import tempfile
from pathlib import Path
from typing import Any

from raw2drive_ros.cli.domain_option import add_domain_argument
from raw2drive_ros.cli.graph_options import add_graph_arguments

# Before it ends, the probe brakes until the car stands.
BRAKE_WITHIN_S = 8.0

MOSAIC = Path('runs/check-vehicle.png')

EXAMPLES = """examples:
  raw2drive check-vehicle --domain 12                 listens only
  raw2drive check-vehicle --domain 12 --allow-motion  also brakes, drives, steers, falls silent, sends NaN, and lets a
                                                      second publisher command: only where nobody can be hurt, 40 m
                                                      free ahead, with the safety gate stopped
  raw2drive sim --real-time & raw2drive check-vehicle --sim-time --allow-motion      our own bridge

Time is the vehicle's: /clock where it is published, stamps of odometry otherwise. Pictures are compared with the motion
of the car, so --allow-motion (or a car that somebody drives) finds most. Look at the mosaic too.

Exit code 0: no error. 1: at least one. docs/vehicle_interface.md is the contract."""

COLOURS = {'error': 'red', 'warning': 'yellow', 'passed': 'green', 'skipped': 'dim'}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add_graph_arguments(parser)
    parser.add_argument('--bundle', type=Path, help='policy bundle whose cameras are wanted (default: the shipped one)')
    parser.add_argument('--image-transport', choices=('raw', 'compressed'), default='raw', help='image topics in use')
    parser.add_argument('--seconds', type=float, default=5.0, help='how long to listen')
    parser.add_argument('--allow-motion', action='store_true', help='also drive the car')
    parser.add_argument('--sim-time', action='store_true', help='a vehicle without /clock is an error')
    parser.add_argument('--mosaic', type=Path, default=MOSAIC, help=f'PNG of all cameras, labelled (default: {MOSAIC})')
    add_domain_argument(parser)
    parser.add_argument('--json', action='store_true', help='print the verdicts as JSON')


def run(options: argparse.Namespace) -> int:
    from raw2drive_ros.contracts.errors import GraphError, UsageError
    from raw2drive_ros.driving.bundle import load_bundle
    from raw2drive_ros.graph.processes import running_graph
    from raw2drive_ros.settings import default_bundle

    if not options.seconds > 0:
        raise UsageError('--seconds must be positive')
    bundle = (options.bundle or default_bundle()).resolve()
    load_bundle(bundle)
    with tempfile.TemporaryDirectory(prefix='raw2drive_') as folder:
        report = Path(folder) / 'report.json'
        parameters = {
            'bundle': str(bundle),
            'image_transport': options.image_transport,
            'seconds': options.seconds,
            'allow_motion': options.allow_motion,
            'wants_sim_time': options.sim_time,
            'report': str(report),
            'mosaic': str(options.mosaic.resolve()),
        }
        with running_graph(Path(folder), options.domain, options.namespace) as graph:
            graph.start('vehicle_probe', parameters, sim_time=False, end_within_s=BRAKE_WITHIN_S)
            graph.processes['vehicle_probe'].wait()
            if not report.is_file():
                raise GraphError(f'vehicle_probe: {graph.last_words("vehicle_probe")}')
            verdicts = json.loads(report.read_text())
    if options.json:
        print(json.dumps(verdicts))
    else:
        _print(verdicts)
    return int(any(verdict['severity'] == 'error' for verdict in verdicts))


def _print(verdicts: list[dict[str, Any]]) -> None:
    from rich.console import Console
    from rich.table import Table

    table = Table(title='What the vehicle does')
    for name in ('check', '', 'seen', 'remedy'):
        table.add_column(name, overflow='fold')
    for verdict in sorted(verdicts, key=lambda v: list(COLOURS).index(v['severity'])):
        severity = verdict['severity']
        table.add_row(verdict['check'], f'[{COLOURS[severity]}]{severity}[/]', verdict['text'], verdict['remedy'])
    console = Console(width=150)
    console.print(table)
    counts = {name: sum(v['severity'] == name for v in verdicts) for name in COLOURS}
    console.print(', '.join(f'{count} {name}' for name, count in counts.items()))
