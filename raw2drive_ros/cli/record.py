"""raw2drive record: the running graph into one MCAP bag."""

from __future__ import annotations

import argparse
import json
from pathlib import Path

EXAMPLES = """examples:
  raw2drive record --out runs/my_bag            until Ctrl-C; the bag is closed then

See also: raw2drive collect, which drives and records without a graph."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument('--out', type=Path, required=True, help='folder of the bag; must not exist')
    parser.add_argument('--note', default='', help='kept in the bag')
    parser.add_argument('--domain', type=int, default=0, help='ROS domain')


def run(options: argparse.Namespace) -> int:
    from raw2drive_ros.cli.single import run_single
    from raw2drive_ros.recording.bag_writer import BagExistsError

    if options.out.exists():
        raise BagExistsError(f'{options.out} exists already; choose another name or remove it')
    parameters = {'bag': str(options.out.resolve()), 'provenance': json.dumps({'note': options.note})}
    try:
        return run_single({'recorder': parameters}, options.domain, sim_time=False)
    finally:
        if options.out.exists():
            print(f'bag: {options.out}; next: raw2drive bag info {options.out}')
