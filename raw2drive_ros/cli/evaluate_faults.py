"""raw2drive evaluate faults: the raw policy under every plan of a file, one row a plan."""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Any

from raw2drive_ros.cli.parser import at_least, note
from raw2drive_ros.cli.route_options import add_route_arguments, chosen_routes

EXAMPLES = """examples:
  raw2drive evaluate faults --seeds 3
  raw2drive evaluate faults --routes LaneFollowing --seeds 3 --workers 2 --out runs/faults.jsonl
  raw2drive evaluate faults --plans my_plans.yaml --routes LaneFollowing --seeds 1 --json

In process and in lock-step; `raw2drive demo --fault PLAN` shows one plan in the whole graph, `raw2drive faults list`
says what each plan does."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument('--plans', default='matrix', help='name of a file in params/faults, or a YAML file')
    parser.add_argument('--bundle', type=Path, help='policy bundle (default: the shipped one)')
    add_route_arguments(parser)
    parser.add_argument('--threads', type=int, default=1, help='torch threads')
    parser.add_argument('--workers', type=int, default=1, help='processes that drive at the same time')
    parser.add_argument('--out', type=Path, help='a JSON line per drive')
    parser.add_argument('--json', action='store_true', help='print the result as JSON')


def run(options: argparse.Namespace) -> int:
    from raw2drive_ros.evaluation.evaluate import EvaluationInterrupted
    from raw2drive_ros.evaluation.fault_matrix import FaultMatrix
    from raw2drive_ros.progress import bar
    from raw2drive_ros.settings import default_bundle

    at_least(options, 1, 'workers', 'threads')
    routes = chosen_routes(options)[2]
    bundle = options.bundle or default_bundle()
    matrix = FaultMatrix(options.plans, bundle, options.threads, options.workers, options.out)
    jobs = matrix.jobs(routes)
    stopped = False
    try:
        with bar('driving under faults', len(jobs), 'drives') as advance:
            found = matrix.drive(jobs, advance)
    except EvaluationInterrupted as stop:
        found, stopped = stop.result or [], True
    if options.json:
        print(json.dumps({'routes': [str(route) for route in routes], 'plans': found}))
    elif found:
        _print(found, len(routes))
    if stopped:
        done = sum(row['drives'] for row in found)
        note(f'interrupted after {done} of {len(jobs)} drives: the last plan may lack some')
        return 130
    return 0


def _print(found: list[dict[str, Any]], routes: int) -> None:
    from rich.table import Table

    from raw2drive_ros.cli.table import add_column, wide_console
    from raw2drive_ros.evaluation.fault_matrix import NO_FAULT

    table = Table(title=f'{routes} routes under each fault; seconds from the beginning of the fault')
    for name in ('fault', 'stopped', 'reaction s', 'standing s', 'score', 'collisions', 'what gate and planner say'):
        add_column(table, name, right=name not in ('fault', 'what gate and planner say'))
    for row in found:
        table.add_row(
            row['plan'],
            f'{row["stopped"]} of {row["touched"]}' if row['plan'] != NO_FAULT else str(row['stopped']),
            f'{row["reaction_s"]["median"]:.1f} (max {row["reaction_s"]["max"]:.1f})' if row['reaction_s'] else '-',
            f'{row["standing_s"]["median"]:.1f} (max {row["standing_s"]["max"]:.1f})' if row['standing_s'] else '-',
            f'{row["driving_score"]:.1f}',
            str(row['collisions']),
            '; '.join(row['causes'] or row['reasons']) or '-',
        )
    wide_console().print(table)
