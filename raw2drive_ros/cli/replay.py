"""raw2drive replay: a bag's sensor topics into the graph, with /clock."""

from __future__ import annotations

import argparse
import json
from dataclasses import asdict
from pathlib import Path

from raw2drive_ros.cli.domain_option import add_domain_argument
from raw2drive_ros.cli.graph_options import add_graph_arguments

EXAMPLES = """examples:
  raw2drive replay runs/demo/bag                 for a planner that runs elsewhere (raw2drive drive --sim-time)
  raw2drive replay runs/demo/bag --rate 0.5
  raw2drive replay runs/demo/bag --start 12 --loop --paused     then raw2drive call /player/step, /player/pause false
  raw2drive replay runs/demo/bag --verify        decide again in process and compare with the recorded commands
  raw2drive replay runs/demo/bag --verify --bundle runs/new_bundle     where and by how much does it decide differently?

--verify ends with 0 when every decision is the same, bit for bit, and with 1 otherwise. A bag in which time goes back
holds several drives: each is verified, or played, by itself. Proposals that were lost in the recording are counted by
the numbers that they carry; decisions of which the bag does not hold what led to them are counted, and not compared."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add_graph_arguments(parser)
    parser.add_argument('bag', type=Path)
    parser.add_argument('--rate', type=float, default=1.0, help='speed relative to recorded time')
    parser.add_argument('--start', type=float, default=0.0, help="seconds after the bag's beginning")
    parser.add_argument('--loop', action='store_true', help='begin again at the end')
    parser.add_argument('--paused', action='store_true', help='wait for /player/pause or /player/step')
    parser.add_argument('--json', action='store_true', help='--verify: print the comparison as JSON')
    parser.add_argument(
        '--verify', action='store_true', help="compare the bundle's decisions with the bag's, bit for bit"
    )
    parser.add_argument('--bundle', type=Path, help='policy bundle for --verify (default: the shipped one)')
    add_domain_argument(parser)


def run(options: argparse.Namespace) -> int:
    from raw2drive_ros.contracts.errors import UsageError
    from raw2drive_ros.recording.bag_reader import open_bag
    from raw2drive_ros.recording.line_reader import lasts_s, time_lines

    if options.bundle is not None and not options.verify:
        raise UsageError('--bundle goes with --verify; otherwise the planner that is running decides')
    if not options.rate > 0 or not options.start >= 0:
        raise UsageError('--rate must be positive, --start not negative')
    with open_bag(options.bag) as reader:
        if not reader.message_count:
            raise UsageError(f'{options.bag}: holds no messages')
        # Where time goes back, its drives are played one after the other.
        whole_s = lasts_s(time_lines(reader)) if options.start else 0.0
    if options.start > whole_s:
        raise UsageError(f'--start {options.start:g}: the bag lasts {whole_s:.1f} s')
    if options.verify:
        from raw2drive_ros.evaluation.verify import verify_bag
        from raw2drive_ros.settings import default_bundle

        outcome = verify_bag(options.bag, options.bundle or default_bundle())
        print(json.dumps(asdict(outcome)) if options.json else outcome.text)
        return 0 if outcome.equal else 1
    from raw2drive_ros.graph.foreground import run_single

    parameters = {
        'bag': str(options.bag.resolve()),
        'rate': options.rate,
        'start_s': options.start,
        'loop': options.loop,
        'paused': options.paused,
    }
    return run_single({'player': parameters}, options.domain, namespace=options.namespace, sim_time=False)
