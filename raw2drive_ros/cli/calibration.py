"""raw2drive calibration: what a privileged world model and its critic predict against what bags recorded."""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path
from typing import Any

from raw2drive_ros.cli.parser import at_least

EXAMPLES = """examples:
  raw2drive calibration --run runs/stage1 --bags runs/bags/policy2a
  raw2drive calibration --run runs/teacher --bags runs/teacher/bags/06_0_privileged --out calibration.png --json

continue: chance of a terminal step within 1, 5 and 10 imagined steps on the recorded actions.
reward: of filtered states. value: against the discounted return of the rest of the episode, 0 after a terminal
step; where an episode was stopped otherwise, the critic's value at its last tick goes on from there, and states
within 1 / (1 - gamma) steps of it are left out.
Best on bags that the policy drove itself: of another driver's the critic does not claim to know the return."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        '--run', dest='training_run', type=Path, required=True, help='stage-1 run, checkpoint or teacher bundle'
    )
    parser.add_argument('--bags', type=Path, nargs='+', required=True, help='bags, or folders of bags')
    parser.add_argument('--out', type=Path, default=Path('calibration.png'), help='PNG to write')
    parser.add_argument('--json', action='store_true', help='print the numbers as JSON')
    parser.add_argument('--samples', type=int, default=4, help='imagined futures of each state (default: 4)')
    parser.add_argument('--threads', type=int, default=1, help='torch threads')
    parser.add_argument('--cache', type=Path, default=Path('runs/cache'), help='where bags are unpacked to')


def run(options: argparse.Namespace) -> int:
    import torch

    from raw2drive_ros.contracts.errors import UsageError
    from raw2drive_ros.contracts.texts import shown
    from raw2drive_ros.progress import bar
    from raw2drive_ros.recording.bag_reader import search_bags
    from raw2drive_ros.report.calibration import CalibrationProbe, Traces, joined, numbers
    from raw2drive_ros.report.calibration_plot import save_calibration
    from raw2drive_ros.training.dataset import load_bag
    from raw2drive_ros.training.export import training_metadata
    from raw2drive_ros.world_model.teacher import load_teacher

    at_least(options, 1, 'samples', 'threads')
    if options.out.suffix.lower() != '.png':
        raise UsageError(f'--out {options.out}: give a name that ends in .png')
    torch.set_num_threads(options.threads)
    search = search_bags(options.bags)
    for line in search.left_out():
        print(shown(line), file=sys.stderr)
    paths = search.bags
    teacher = load_teacher(options.training_run)
    probe = CalibrationProbe(teacher, options.samples)
    learnt = set(training_metadata(options.training_run).get('training_bags', ()))
    traces: list[Traces] = []
    drivers: dict[str, int] = {}
    seen = 0
    with bar('calibrating', len(paths), 'bags') as advance:
        for number, path in enumerate(paths):
            bag = load_bag(path, options.cache, teacher.config, cameras=False)

            def progress(ticks: int, number: int = number, name: str = path.name, total: int = len(bag)) -> None:
                advance(number + ticks / total, name)

            traces += probe.traces(bag, progress)
            drivers[bag.driver or 'unknown'] = drivers.get(bag.driver or 'unknown', 0) + 1
            seen += bag.identity in learnt
    found: dict[str, Any] = {
        'run': str(options.training_run),
        'steps': teacher.steps,
        'bags': len(paths),
        'bags_learnt_from': seen,
        'drivers': drivers,
        'samples': options.samples,
    }
    found |= numbers(traces, probe.gamma)
    title = f'{options.training_run.resolve().name}, {teacher.steps} steps, {len(paths)} bags ({_drivers(found)})'
    picture = save_calibration(options.out, title, found, joined(traces))
    if options.json:
        print(json.dumps(found | {'picture': str(picture)}))
        return 0
    _print(found)
    print(picture)
    return 0


def _drivers(found: dict[str, Any]) -> str:
    return ', '.join(f'{name} x{count}' for name, count in found['drivers'].items())


def _print(found: dict[str, Any]) -> None:
    from rich.table import Table

    from raw2drive_ros.cli.table import wide_console

    console = wide_console()
    ends = ', '.join(f'{count} {name}' for name, count in found['episodes'].items())
    console.print(f'{found["bags"]} bags ({_drivers(found)}), {found["ticks"]} ticks, episodes that end: {ends}')
    if found['bags_learnt_from']:
        console.print(f'{found["bags_learnt_from"]} of these bags were trained on: expect worse on others')
    table = Table(title='continue: terminal step within so many, on the recorded actions')
    _columns(table, 'steps', 'states', 'ended %', 'predicted %', 'Brier', 'of the rate', 'unknown')
    for steps, row in found['continue'].items():
        shares = [_text(None if row[name] is None else 100.0 * row[name], 2) for name in ('happened', 'predicted')]
        briers = [_text(row[name], 5) for name in ('brier', 'brier_of_rate')]
        table.add_row(steps, str(row['states']), *shares, *briers, str(row['left_out']))
    console.print(table)
    table = Table(title=f'reward, and value (by end of the episode) against the return, gamma {found["gamma"]:g}')
    _columns(table, 'of', 'states', 'true', 'predicted', 'bias', 'rmse', 'R2', 'corr.')
    rows = {'reward': found['reward']} | {f'value {name}': row for name, row in found['value'].items()}
    for name, row in rows.items():
        keys = ('true', 'predicted', 'bias', 'rmse', 'r2', 'correlation')
        table.add_row(name, str(row['states']), *(_text(row[key], 3) for key in keys))
    console.print(table)
    table = Table(title='reward by decile of the predicted one')
    _columns(table, 'decile', 'from', 'to', 'mean error')
    for number, part in enumerate(found['reward']['deciles'], 1):
        table.add_row(str(number), *(_text(part[key], 3) for key in ('low', 'high', 'error')))
    console.print(table)


def _columns(table: Any, first: str, *others: str) -> None:
    from raw2drive_ros.cli.table import add_column

    add_column(table, first)
    for name in others:
        add_column(table, name, right=True)


def _text(value: float | None, digits: int) -> str:
    return '-' if value is None else f'{value:.{digits}f}'
