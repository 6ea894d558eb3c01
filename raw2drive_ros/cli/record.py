"""raw2drive record: the running graph into one MCAP bag."""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path

from raw2drive_ros.cli.domain_option import add_domain_argument, heard_nobody, nothing_there
from raw2drive_ros.cli.graph_options import add_graph_arguments

EXAMPLES = """examples:
  raw2drive record --out runs/my_bag            until Ctrl-C; the bag is closed then
  raw2drive record --out runs/day --split-s 60  whole bags of a minute each
  raw2drive record --out runs/stops --snapshot-s 20   the last 20 s before each stop of the gate, or on demand:
                                                service /recorder/save (std_srvs/Trigger)

When time goes back (a simulation is reset, a bag is played in a loop, the system clock is set back) a new bag begins:
NAME/NAME_001 inside the folder of the bag NAME, and so on. A message's log_time is when it was received, by this
machine's clock; its publish_time is its own stamp, by which everything here reads.
raw2drive bag doctor tells the delay.

A kill loses at most what came in the last --flush-s seconds: raw2drive bag recover runs/my_bag --out runs/saved

See also: raw2drive collect, which drives and records without a graph."""

# To write down what has arrived and close the bag takes a moment, on a busy machine several seconds.
CLOSE_WITHIN_S = 30.0


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add_graph_arguments(parser)
    parser.add_argument('--out', type=Path, required=True, help='folder of the bag; must not exist')
    parser.add_argument('--note', default='', help='kept in the bag')
    parser.add_argument('--split-s', type=float, default=0.0, help='begin a new bag every so many seconds')
    parser.add_argument('--split-mb', type=float, default=0.0, help='and after so many megabytes')
    parser.add_argument('--snapshot-s', type=float, default=0.0, help='keep the last seconds, write them when asked')
    parser.add_argument('--flush-s', type=float, default=0.5, help='what a kill can lose')
    parser.add_argument('--fail-on-loss', action='store_true', help='exit code 1 when a message was lost')
    add_domain_argument(parser)


def run(options: argparse.Namespace) -> int:
    from raw2drive_ros.graph.foreground import run_single
    from raw2drive_ros.recording.bag_writer import require_new

    require_new(options.out)
    parameters = {
        'bag': str(options.out.resolve()),
        'provenance': json.dumps({'note': options.note}),
        'fail_on_loss': options.fail_on_loss,
        **{name: getattr(options, name) for name in ('split_s', 'split_mb', 'snapshot_s', 'flush_s')},
    }
    try:
        return run_single(
            {'recorder': parameters},
            options.domain,
            namespace=options.namespace,
            sim_time=False,
            end_within_s=CLOSE_WITHIN_S,
        )
    finally:
        if options.out.exists():
            _tell(options.out)
            if heard_nobody(options.out):
                print(nothing_there(options.domain), file=sys.stderr)


def _tell(out: Path) -> None:
    from raw2drive_ros.contracts.errors import BagError
    from raw2drive_ros.recording.bag_info import provenance_of
    from raw2drive_ros.recording.bag_reader import find_bags

    print(f'bag: {out}; next: raw2drive bag info {out}')
    try:
        for bag in find_bags([out]):
            began = provenance_of(bag).get('began', '')
            if began.startswith('time went back'):
                print(f'{began}: {bag} holds another drive')
    except BagError:
        # Nothing was closed: the recorder itself has said why.
        return
