"""evaluate --faults: the raw policy under every plan of a file, one row a plan."""

from __future__ import annotations

import argparse
import json
import multiprocessing
import statistics
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from raw2drive_ros.faults.plan import Fault
    from raw2drive_ros.simulation.route_id import RouteId

NO_FAULT = 'none'


@dataclass(frozen=True, slots=True)
class Job:
    """One drive: a plan's name and faults, a route."""

    plan: str
    faults: list[Fault]
    seed: int
    route: RouteId


def run_under_faults(options: argparse.Namespace, routes: list[RouteId]) -> int:
    """Drive every route without and with every plan; prints a table or JSON, `--out` keeps a line per drive."""
    from raw2drive_ros.faults.plan import load_plans
    from raw2drive_ros.progress import bar
    from raw2drive_ros.settings import default_bundle

    file = load_plans(options.faults)
    plans = {NO_FAULT: []} | file.plans
    jobs = [Job(name, faults, file.seed, route) for name, faults in plans.items() for route in routes]
    rows: list[dict[str, Any]] = []
    setup = (options.bundle or default_bundle(), options.threads)
    with (
        multiprocessing.get_context('spawn').Pool(options.workers, _start, setup) as pool,
        bar('driving under faults', len(jobs), 'drives') as advance,
    ):
        for row in pool.imap(_drive, jobs):
            rows.append(row)
            advance(len(rows), row['plan'])
    if options.out:
        options.out.parent.mkdir(parents=True, exist_ok=True)
        options.out.write_text(''.join(json.dumps(row) + '\n' for row in rows))
    summary = [_summary(name, [row for row in rows if row['plan'] == name]) for name in plans]
    if options.json:
        print(json.dumps({'routes': [str(route) for route in routes], 'plans': summary}))
    else:
        _print(summary, len(routes))
    return 0


def _summary(plan: str, rows: list[dict[str, Any]]) -> dict[str, Any]:
    stops = [row['reaction_s'] for row in rows if row['reaction_s'] is not None]
    stands = [row['standing_s'] for row in rows if row['standing_s'] is not None]
    return {
        'plan': plan,
        'drives': len(rows),
        'touched': sum(bool(row['touched']) for row in rows),
        'stopped': len(stops),
        'reaction_s': {'median': statistics.median(stops), 'max': max(stops)} if stops else None,
        'standing_s': {'median': statistics.median(stands), 'max': max(stands)} if stands else None,
        'driving_score': statistics.fmean(row['driving_score'] for row in rows),
        'collisions': sum(row['collisions'] for row in rows),
        'reasons': sorted({row['reason'].split(' for ')[0] for row in rows if row['reason']}),
        'causes': sorted({cause.split(':')[0] for row in rows for cause in row['causes']}),
    }


def _print(summary: list[dict[str, Any]], routes: int) -> None:
    from rich.console import Console
    from rich.table import Table

    table = Table(title=f'{routes} routes under each fault; seconds from the beginning of the fault')
    for name in ('fault', 'stopped', 'reaction s', 'standing s', 'score', 'collisions', 'what gate and planner say'):
        table.add_column(name, justify='left' if name in ('fault', 'what gate and planner say') else 'right')
    for row in summary:
        table.add_row(
            row['plan'],
            f'{row["stopped"]} of {row["touched"]}' if row['plan'] != NO_FAULT else str(row['stopped']),
            f'{row["reaction_s"]["median"]:.1f} (max {row["reaction_s"]["max"]:.1f})' if row['reaction_s'] else '-',
            f'{row["standing_s"]["median"]:.1f} (max {row["standing_s"]["max"]:.1f})' if row['standing_s'] else '-',
            f'{row["driving_score"]:.1f}',
            str(row['collisions']),
            '; '.join(row['causes'] or row['reasons']) or '-',
        )
    Console(width=160).print(table)


_state: tuple[Any, Any] | None = None


def _start(bundle: Path, threads: int) -> None:
    import cv2

    from raw2drive_ros.driving.bundle import load_bundle
    from raw2drive_ros.driving.monitor_config import load_monitor_config
    from raw2drive_ros.driving.raw_planner import RawPlanner
    from raw2drive_ros.simulation.environment import DrivingEnv, SimulationConfig
    from raw2drive_ros.timing import load_timing

    global _state
    cv2.setNumThreads(1)
    planner = RawPlanner(load_bundle(bundle), load_monitor_config().limits(load_timing()), threads)
    _state = DrivingEnv(SimulationConfig(bev=False, end_on_infraction=False)), planner


def _drive(job: Job) -> dict[str, Any]:
    from raw2drive_ros.evaluation.faulty_drive import drive_with_faults
    from raw2drive_ros.faults.injector import Injector

    assert _state is not None
    env, planner = _state
    drive = drive_with_faults(env, planner, Injector(job.faults, job.seed), job.route)
    start_s = min((fault.start_s for fault in job.faults), default=0.0)
    collisions = sum(n for name, n in drive.result.infractions.items() if name.startswith('collision'))
    return {
        'plan': job.plan,
        'route': str(job.route),
        'faults': [_plain(fault) for fault in job.faults],
        'touched': drive.counts,
        'reaction_s': None if drive.stop_s is None else drive.stop_s - start_s,
        'standing_s': None if drive.stand_s is None else drive.stand_s - start_s,
        'state': drive.stop_state,
        'reason': drive.reason,
        'causes': drive.causes,
        'driving_score': drive.result.driving_score,
        'collisions': collisions,
    }


def _plain(fault: Fault) -> dict[str, Any]:
    """A fault for JSON, which has no infinity."""
    return {key: str(value) if value == float('inf') else value for key, value in fault.model_dump().items()}
