"""raw2drive replay: a bag's sensor topics into the graph, with /clock."""

from __future__ import annotations

import argparse
from pathlib import Path

EXAMPLES = """examples:
  raw2drive replay runs/demo/bag                 for a planner that runs elsewhere
  raw2drive replay runs/demo/bag --rate 0.5
  raw2drive replay runs/demo/bag --verify        decide again in process and compare with the recorded commands"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument('bag', type=Path)
    parser.add_argument('--rate', type=float, default=1.0, help='speed relative to recorded time')
    parser.add_argument(
        '--verify', action='store_true', help="compare the bundle's decisions with the bag's, bit for bit"
    )
    parser.add_argument('--bundle', type=Path, help='policy bundle for --verify (default: the shipped one)')
    parser.add_argument('--domain', type=int, default=0, help='ROS domain')


def run(options: argparse.Namespace) -> int:
    from raw2drive_ros.recording.bag_reader import open_bag

    with open_bag(options.bag):
        pass
    if options.verify:
        from raw2drive_ros.evaluation.verify import verify_bag
        from raw2drive_ros.paths import default_bundle

        outcome = verify_bag(options.bag, options.bundle or default_bundle())
        print(outcome.text)
        return 0 if outcome.equal else 1
    from raw2drive_ros.cli.single import run_single

    parameters = {'bag': str(options.bag.resolve()), 'rate': options.rate}
    return run_single({'player': parameters}, options.domain, sim_time=False)
