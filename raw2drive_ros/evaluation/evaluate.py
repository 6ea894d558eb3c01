"""Many drives, one summary; per-route lines are on disk before the next drive starts, and are not driven twice."""

from __future__ import annotations

import json
import multiprocessing
import sys
import time
import traceback
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from raw2drive_ros.contract import Decision
from raw2drive_ros.driving.bundle import load_bundle
from raw2drive_ros.errors import ResultsError
from raw2drive_ros.evaluation.drivers import make_driver
from raw2drive_ros.evaluation.episode import drive_route
from raw2drive_ros.evaluation.episode_driver import BlindfoldedDriver, EpisodeDriver
from raw2drive_ros.evaluation.metrics import RouteResult, failed_route
from raw2drive_ros.evaluation.statistics import Results, by_ability, flaky, summary
from raw2drive_ros.evaluation.table_actions import through_table
from raw2drive_ros.settings import default_teacher
from raw2drive_ros.simulation.environment import DrivingEnv, SimulationConfig, Tick
from raw2drive_ros.simulation.route_id import RouteId

OnRoute = Callable[[int, RouteResult], None]


class Observer(Protocol):
    """Watches drives, to keep a picture of those that fail."""

    def see(self, env: DrivingEnv, tick: Tick) -> None:
        """Called on every tick."""

    def save(self, path: Path) -> Path:
        """Write what was seen of the last drive."""


@dataclass(frozen=True, slots=True)
class DriverSpec:
    """What a worker process builds its driver from; see `drivers.make_driver` and, for table, `through_table`."""

    name: str
    bundle: Path | None = None
    run: Path | None = None
    threads: int = 1
    blind: bool = False
    table: bool = False

    def build(self) -> EpisodeDriver:
        driver = make_driver(self.name, self.bundle, self.run, 0.0, self.threads)
        if self.table:
            driver = through_table(self.name, driver)
        return BlindfoldedDriver(driver) if self.blind else driver

    def identity(self) -> str:
        """Tells results of different drivers apart: by their weights, not by where those lie."""
        weights = ''
        if self.name == 'raw' and self.bundle is not None:
            weights = load_bundle(self.bundle).identity
        elif self.name == 'privileged':
            # Late: the bridge imports this module and trains nothing.
            from raw2drive_ros.world_model.teacher import teacher_identity

            weights = teacher_identity(self.run or default_teacher())
        options = ['blind'] * self.blind + ['table'] * self.table
        return ' '.join(filter(None, (self.name, weights, *options)))


@dataclass(frozen=True, slots=True)
class Conditions:
    """How routes are driven. bench2drive_compat: score as Bench2Drive's tools do. observe, filmstrips: what watches
    drives, and the folder for what it saved of the failed ones."""

    image_size: tuple[int, int] = (96, 160)
    bench2drive_compat: bool = False
    observe: Callable[[], Observer] | None = None
    filmstrips: Path | None = None


def timing_of(tick_ms: list[float], lost: int = 0) -> dict[str, Any]:
    """p50 and p99 of the tick time, and the rate that it allows."""
    if not tick_ms:
        return {'tick_ms': {'p50': None, 'p99': None}, 'ticks_per_s': None, 'messages_lost': lost}
    p50, p99 = np.percentile(tick_ms, [50, 99])
    rate = 1000.0 / float(np.mean(tick_ms))
    return {
        'tick_ms': {'p50': round(float(p50), 3), 'p99': round(float(p99), 3)},
        'ticks_per_s': round(rate, 1),
        'messages_lost': lost,
    }


class RouteRunner:
    """One process's driver and simulator."""

    def __init__(self, driver: EpisodeDriver, conditions: Conditions) -> None:
        self.driver = driver
        self.conditions = conditions
        self.env = DrivingEnv(
            SimulationConfig(
                conditions.image_size, cameras=driver.needs_cameras, bev=driver.needs_bev, end_on_infraction=False
            )
        )
        self.observer = conditions.observe() if conditions.observe is not None else None

    def drive(self, route: RouteId) -> tuple[RouteResult, list[float]]:
        """A drive that raises becomes a failed route: the others still count."""
        observer = self.observer

        def on_tick(tick: Tick, decision: Decision) -> None:
            if observer is not None:
                observer.see(self.env, tick)

        try:
            compat = self.conditions.bench2drive_compat
            drive = drive_route(self.env, self.driver, route, on_tick, bench2drive_compat=compat)
        except Exception as error:
            traceback.print_exc()
            return failed_route(route, f'{type(error).__name__}: {error}'), []
        if observer is not None and self.conditions.filmstrips is not None and not drive.result.success:
            observer.save(filmstrip_path(self.conditions.filmstrips, str(route)))
        return drive.result, drive.tick_ms


def filmstrips_of(results_file: Path) -> Path:
    """Folder of the pictures of failed routes that belong to a file of results."""
    return results_file.with_suffix('.filmstrips')


def filmstrip_path(filmstrips: Path, route_id: str) -> Path:
    """The pictures of one failed route."""
    return filmstrips / f'{route_id.replace("/", "_")}.jpg'


_runner: RouteRunner | None = None


def _make_runner(spec: DriverSpec, conditions: Conditions) -> RouteRunner:
    import cv2

    cv2.setNumThreads(1)
    driver = spec.build()
    # Drivers without a model do without torch. Several threads on one small state only wait for each other.
    if torch := sys.modules.get('torch'):
        torch.set_num_threads(spec.threads)
    return RouteRunner(driver, conditions)


def _start_worker(spec: DriverSpec, conditions: Conditions) -> None:
    global _runner
    _runner = _make_runner(spec, conditions)


def _work(route: RouteId) -> tuple[RouteResult, list[float]]:
    assert _runner is not None
    return _runner.drive(route)


def evaluate(
    spec: DriverSpec,
    suite: str,
    version: str,
    routes: Sequence[RouteId],
    conditions: Conditions | None = None,
    lines: Path | None = None,
    on_route: OnRoute = lambda done, result: None,
    workers: int = 1,
) -> dict[str, Any]:
    """Drive all routes; the result's form for machines.

    lines: a JSON-lines file. Its first record says that nothing is finished yet; routes that it holds already are
    not driven again. Raises ResultsError when it belongs to another driver or suite.
    """
    conditions = conditions or Conditions()
    compat = conditions.bench2drive_compat
    file = RowsFile(lines, header_of(spec.identity(), suite, version, routes, bench2drive_compat=compat))
    tick_ms: list[float] = []
    jobs = [route for route in routes if route not in file.rows]
    for result, times in _driven(spec, conditions, jobs, workers):
        tick_ms += times
        file.add(result)
        on_route(len(file.rows), result)
    return summarise(spec.name, suite, version, routes, list(file.rows.values()), timing_of(tick_ms))


def _driven(
    spec: DriverSpec, conditions: Conditions, jobs: list[RouteId], workers: int
) -> Iterator[tuple[RouteResult, list[float]]]:
    if workers <= 1:
        runner = _make_runner(spec, conditions)
        for route in jobs:
            yield runner.drive(route)
        return
    # Spawned, not forked: torch's threads do not survive a fork. In order, so that files do not depend on workers.
    with multiprocessing.get_context('spawn').Pool(workers, _start_worker, (spec, conditions)) as pool:
        yield from pool.imap(_work, jobs)


def summarise(
    driver: str,
    suite: str,
    version: str,
    routes: Sequence[RouteId],
    rows: Sequence[RouteResult],
    timing: dict[str, Any],
) -> dict[str, Any]:
    """The one form of results for machines. Routes without a row count as zero and are listed under `missing`."""
    header = {'driver': driver, 'suite': suite, 'version': version}
    results = Results(header | {'routes': [str(route) for route in routes]}, [row.to_json() for row in rows])
    return {
        **header,
        'routes': [row for row in results.by_id().values() if row is not None],
        'missing': [str(route) for route in results.missing],
        'summary': summary(results),
        'abilities': by_ability(results),
        'flaky': flaky(results),
        'timing': timing,
    }


def header_of(
    identity: str, suite: str, version: str, routes: Sequence[RouteId], *, bench2drive_compat: bool = False
) -> dict[str, Any]:
    """The first record of a file of results."""
    return {
        'status': 'failed, no data',
        'started': round(time.time(), 1),
        'driver': identity,
        'suite': suite,
        'version': version,
        'bench2drive_compat': bench2drive_compat,
        'routes': [str(route) for route in routes],
    }


class RowsFile:
    """rows: finished routes by id, those of an earlier call included. Without a path nothing is written."""

    def __init__(self, path: Path | None, header: dict[str, Any]) -> None:
        self.path = path
        self.rows: dict[RouteId, RouteResult] = {}
        if path is None:
            return
        path.parent.mkdir(parents=True, exist_ok=True)
        if path.exists():
            self._take_over(path, header)
        else:
            path.write_text(json.dumps(header) + '\n')

    def add(self, row: RouteResult) -> None:
        self.rows[RouteId.parse(row.id)] = row
        if self.path is not None:
            with self.path.open('a') as file:
                file.write(json.dumps(row.to_json()) + '\n')

    def _take_over(self, path: Path, header: dict[str, Any]) -> None:
        text = path.read_text()
        # What follows the last line break was being written when its writer died.
        whole = text[: text.rfind('\n') + 1]
        try:
            first, *rest = (json.loads(line) for line in whole.splitlines())
            found = {RouteId.parse(row['id']): RouteResult(**row) for row in rest}
            wanted = set(header['routes'])
            strange = [route for route in first['routes'] if route not in wanted]
        except (ValueError, TypeError, KeyError) as error:
            raise ResultsError(f'{path}: damaged results ({error}); move it away or give another --out') from error
        same = ('driver', 'suite', 'version', 'bench2drive_compat')
        different = [f'{key} {first.get(key)!r}, not {header[key]!r}' for key in same if first.get(key) != header[key]]
        if strange:
            different.append(f'{strange[0]}, which is not asked for now')
        if different:
            raise ResultsError(f'{path}: holds results of {"; ".join(different)}: give another --out')
        self.rows = found
        if whole != text or first['routes'] != header['routes']:
            lines = [json.dumps(first | {'routes': header['routes']}), *whole.splitlines()[1:]]
            partial = path.with_name(path.name + '.partial')
            partial.write_text('\n'.join(lines) + '\n')
            partial.replace(path)
