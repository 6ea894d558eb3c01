"""raw2drive report: files of results as one HTML page, or as statistics for machines."""

from __future__ import annotations

import argparse
import json
from pathlib import Path

from raw2drive_ros.cli.deprecation import warn_old
from raw2drive_ros.cli.parser import at_least, refuse

EXAMPLES = """examples:
  raw2drive report runs/expert.jsonl --out report.html
  raw2drive report runs/expert.jsonl runs/rule.jsonl runs/raw.jsonl --out report.html
  raw2drive report runs/expert.jsonl runs/rule.jsonl --json

The files come from `raw2drive evaluate --out`. Drives that a file should hold and does not count as zero.
Drivers are compared on the routes that they have in common; suite and version have to be the same."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument('files', nargs='+', type=Path, metavar='FILE', help='JSON lines of raw2drive evaluate --out')
    parser.add_argument('--out', type=Path, default=Path('report.html'), help='page to write (default: report.html)')
    parser.add_argument('--filmstrips', type=int, default=40, help='pictures of failed drives per driver (default: 40)')
    parser.add_argument('--strips', type=int, help=argparse.SUPPRESS)
    parser.add_argument('--json', action='store_true', help='print the statistics as JSON and write no page')


def run(options: argparse.Namespace) -> int:
    from raw2drive_ros.report.comparison import read_all, statistics_of, write_comparison

    if options.strips is not None:
        warn_old('--strips', '--filmstrips')
        options.filmstrips = options.strips
    at_least(options, 0, 'filmstrips')
    if options.json:
        refuse(options, ['out', 'filmstrips'], 'is of the page, which --json does not write')
        print(json.dumps(statistics_of(options.files, read_all(options.files))))
        return 0
    page = write_comparison(options.out, options.files, options.filmstrips)
    print(f'{page}: {page.stat().st_size / 1e6:.1f} MB')
    return 0
