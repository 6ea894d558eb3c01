"""The raw policy under every fault plan: what stopped the car, how quickly, and at what cost in score."""

from __future__ import annotations

import json
import multiprocessing
import statistics
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2

from raw2drive_ros.driving.bundle import load_bundle
from raw2drive_ros.driving.monitor_config import load_monitor_config
from raw2drive_ros.driving.raw_planner import RawPlanner
from raw2drive_ros.evaluation.evaluate import EvaluationInterrupted, without_interrupts
from raw2drive_ros.evaluation.faulty_drive import drive_with_faults
from raw2drive_ros.faults.injector import Injector
from raw2drive_ros.faults.plan import Fault, load_plans
from raw2drive_ros.simulation.environment import DrivingEnv, SimulationConfig
from raw2drive_ros.simulation.route_id import RouteId
from raw2drive_ros.timing import load_timing

NO_FAULT = 'none'
Row = dict[str, Any]


@dataclass(frozen=True, slots=True)
class Job:
    """One drive: a plan's name and faults, a route."""

    plan: str
    faults: list[Fault]
    seed: int
    route: RouteId


@dataclass(frozen=True, slots=True)
class FaultMatrix:
    """plans: name or path of a YAML file of plans. lines: file that is written at the end, one JSON line per drive."""

    plans: str
    bundle: Path
    threads: int = 1
    workers: int = 1
    lines: Path | None = None

    def jobs(self, routes: list[RouteId]) -> list[Job]:
        """Every route without faults and under every plan. Raises ConfigError."""
        file = load_plans(self.plans)
        plans = {NO_FAULT: []} | file.plans
        return [Job(name, faults, file.seed, route) for name, faults in plans.items() for route in routes]

    def drive(self, jobs: list[Job], on_drive: Callable[[int, str], None]) -> list[Row]:
        """One summary per plan, in the order of the plans. on_drive: gets the number of drives done and the last plan.

        Raises BundleError before any process starts, EvaluationInterrupted at Ctrl-C.
        """
        load_bundle(self.bundle)
        rows: list[Row] = []
        setup = (self.bundle, self.threads)
        with without_interrupts():
            pool = multiprocessing.get_context('spawn').Pool(self.workers, _start, setup)
        try:
            with pool:
                for row in pool.imap(_drive, jobs):
                    rows.append(row)
                    on_drive(len(rows), row['plan'])
        except KeyboardInterrupt as stop:
            raise EvaluationInterrupted(self._finish(rows) if rows else None) from stop
        return self._finish(rows)

    def _finish(self, rows: list[Row]) -> list[Row]:
        """Write the rows and summarise them by plan."""
        if self.lines:
            self.lines.parent.mkdir(parents=True, exist_ok=True)
            self.lines.write_text(''.join(json.dumps(row) + '\n' for row in rows))
        plans = dict.fromkeys(row['plan'] for row in rows)
        return [summary(name, [row for row in rows if row['plan'] == name]) for name in plans]


def summary(plan: str, rows: list[Row]) -> Row:
    """Statistics of the drives under one plan.

    reaction_s, standing_s: seconds from the beginning of the fault until gate or vehicle began to stop the car, and
    until the car stood."""
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


_state: tuple[DrivingEnv, RawPlanner] | None = None


def _start(bundle: Path, threads: int) -> None:
    global _state
    cv2.setNumThreads(1)
    planner = RawPlanner(load_bundle(bundle), load_monitor_config().limits(load_timing()), threads)
    _state = DrivingEnv(SimulationConfig(bev=False, end_on_infraction=False)), planner


def _drive(job: Job) -> Row:
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


def _plain(fault: Fault) -> Row:
    """A fault for JSON, which has no infinity."""
    return {key: str(value) if value == float('inf') else value for key, value in fault.model_dump().items()}
