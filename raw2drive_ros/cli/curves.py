"""raw2drive curves: the metrics of training runs as one picture."""

from __future__ import annotations

import argparse
from pathlib import Path

EXAMPLES = """examples:
  raw2drive curves runs/stage1
  raw2drive curves runs/stage1 runs/stage1_no_advice --out compared.png

Losses, overlap of the mask classes, policy, learning rate, seconds per step, validation; of a recipe's run also
success per scenario type, round by round. A run may be drawn while it trains."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument('runs', nargs='+', type=Path, metavar='RUN', help='run folder of raw2drive train')
    parser.add_argument('--out', type=Path, default=Path('curves.png'), help='PNG to write (default: curves.png)')


def run(options: argparse.Namespace) -> int:
    from raw2drive_ros.contracts.errors import UsageError
    from raw2drive_ros.report.curves import read_runs, save_curves

    if options.out.suffix.lower() != '.png':
        raise UsageError(f'--out {options.out}: give a name that ends in .png')
    runs = read_runs(options.runs)
    panels = save_curves(options.out, runs)
    print(f'{options.out}: {panels} panels of {", ".join(found.name for found in runs)}')
    return 0
