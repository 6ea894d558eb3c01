"""raw2drive record: the running graph into one MCAP bag."""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path

from raw2drive_ros.cli.domain_option import add_domain_argument, heard_nobody, nothing_there

EXAMPLES = """examples:
  raw2drive record --out runs/my_bag            until Ctrl-C; the bag is closed then
  raw2drive record --out runs/day --split-s 60  whole bags of a minute each
  raw2drive record --out runs/stops --snapshot-s 20   the last 20 s before each stop of the gate, or on demand:
                                                service /recorder/save (std_srvs/Trigger)

A kill loses at most what came in the last --flush-s seconds: raw2drive bag recover runs/my_bag --out runs/saved

See also: raw2drive collect, which drives and records without a graph."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
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
        return run_single({'recorder': parameters}, options.domain, sim_time=False)
    finally:
        if options.out.exists():
            print(f'bag: {options.out}; next: raw2drive bag info {options.out}')
            if heard_nobody(options.out):
                print(nothing_there(options.domain), file=sys.stderr)
