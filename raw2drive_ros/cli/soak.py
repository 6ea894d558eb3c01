"""raw2drive soak: the whole graph in lock-step for hours; what it holds of the machine has to stay flat."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from raw2drive_ros.evaluation.soak import Sample

from raw2drive_ros.cli.domain_option import add_domain_argument
from raw2drive_ros.cli.parser import at_least, refuse

EXAMPLES = """examples:
  raw2drive soak --hours 24 --out runs/soak          24 simulated hours, some six hours on two cores
  raw2drive soak --hours 24 --out runs/soak          again after Ctrl-C or a restart: the hours that are missing
  raw2drive soak --hours 24 --graphs 2               two graphs that share the hours: sooner on two cores
  raw2drive soak --hours 0 --out runs/soak           only the verdict on what was measured already

Bridge (all routes of a suite, again and again), planner, gate, and a recorder that keeps the last seconds in memory.
Memory (without what is shared), handles, threads and shared-memory segments of every process and the size of the log
folder are sampled; from an hour (simulated) after the graph's start on, memory and logs may grow by a MiB per hour, and
the rest not at all. Exit code 1 when one does, or when a process ends; 3 when no start
lasted twice the warm-up, so that there is no verdict."""

NO_VERDICT = 3


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument('--hours', type=float, default=24.0, help='simulated hours in all (24)')
    parser.add_argument('--out', type=Path, default=Path('runs/soak'), help='folder of samples, logs and picture')
    parser.add_argument('--suite', default='b2d220', help='routes that are driven')
    parser.add_argument('--bundle', type=Path, help='policy bundle (default: the shipped one)')
    parser.add_argument('--graphs', type=int, default=1, help='graphs that run at once and share the hours (1)')
    parser.add_argument('--every', type=float, default=20.0, help='seconds (wall) between samples')
    parser.add_argument('--warm-up', type=float, default=1.0, help='simulated hours that are not judged')
    add_domain_argument(parser, free=True)
    parser.add_argument('--json', action='store_true', help='print the verdict as JSON')


def run(options: argparse.Namespace) -> int:
    from raw2drive_ros.contracts.errors import UsageError
    from raw2drive_ros.evaluation.soak import drop_half_line, read_samples, totals
    from raw2drive_ros.graph.soak import SAMPLES, SoakPlan, soak
    from raw2drive_ros.progress import bar
    from raw2drive_ros.settings import default_bundle

    if not (0 <= options.hours < 10_000 and options.every > 0 and options.warm_up >= 0):
        raise UsageError('--hours and --warm-up must not be negative, --every must be positive')
    at_least(options, 1, 'graphs')
    if options.graphs > 1:
        refuse(options, ['domain'], 'several graphs choose their domains themselves')
    options.out.mkdir(parents=True, exist_ok=True)
    file = options.out / SAMPLES
    drop_half_line(file)
    before = read_samples(file)
    missing_h = options.hours - totals(before)['simulated_h']
    try:
        if missing_h > 0:
            plan = SoakPlan(
                options.out,
                options.suite,
                (options.bundle or default_bundle()).resolve(),
                first_part=1 + max((s.part for s in before), default=0),
                graphs=options.graphs,
                sample_every_s=options.every,
                domain=options.domain if options.graphs == 1 else None,
            )
            with bar('soaking', round(missing_h * 3600.0), 'simulated seconds') as advance:
                soak(plan, missing_h, advance)
    finally:
        code = _report(options, read_samples(file))
    return code


def _report(options: argparse.Namespace, samples: list[Sample]) -> int:
    import json

    from raw2drive_ros.evaluation.soak import to_json, totals, trends
    from raw2drive_ros.report.soak_plot import save_soak

    found = trends(samples, options.warm_up)
    summed = totals(samples)
    grown = [trend for trend in found if not trend.steady]
    if samples:
        save_soak(options.out / 'soak.png', samples)
    if options.json:
        print(
            json.dumps(summed | {'steady': not grown if found else None, 'trends': [to_json(trend) for trend in found]})
        )
        return 1 if grown else 0 if found else NO_VERDICT
    _print(found)
    print(
        f'{summed["simulated_h"]:.2f} simulated hours in {summed["wall_h"]:.2f} h of running graphs, '
        f'{summed["episodes"]} episodes, {summed["parts"]} starts; picture: {options.out / "soak.png"}'
    )
    if not found:
        print(f'no verdict: no start lasted twice the warm-up of {options.warm_up:g} h')
    for trend in grown:
        print(f'GROWS: {trend.name} in part {trend.part}: {trend.per_hour:+.2f} per hour, allowed {trend.allowed:g}')
    return 1 if grown else 0 if found else NO_VERDICT


def _print(found: list[Any]) -> None:
    from rich.table import Table

    from raw2drive_ros.cli.table import add_column, wide_console

    if not found:
        return
    table = Table(title='medians of the first and last quarter after warm-up; growth by simulated hour', box=None)
    for column in ('start: what', 'first', 'last', 'highest', 'growth/h', ''):
        add_column(table, column, right=column not in ('start: what', ''))
    for t in found:
        values = (f'{value:.1f}' for value in (t.first, t.last, t.highest))
        table.add_row(f'{t.part}: {t.name}', *values, f'{t.per_hour:+.2f}', 'steady' if t.steady else 'GROWS')
    wide_console().print(table)
