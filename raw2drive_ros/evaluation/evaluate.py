"""Drives many routes and summarises them. The row of a route is on disk before the next drive starts; a resumed
evaluation does not drive it again."""

from __future__ import annotations

import multiprocessing
import signal
import sys
import threading
import traceback
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Protocol

from raw2drive_ros.contracts.errors import DriverFailedError
from raw2drive_ros.contracts.public import Decision
from raw2drive_ros.contracts.texts import shown
from raw2drive_ros.evaluation.driver_spec import DriverSpec
from raw2drive_ros.evaluation.episode import drive_route
from raw2drive_ros.evaluation.episode_driver import EpisodeDriver
from raw2drive_ros.evaluation.metrics import RouteResult, failed_route
from raw2drive_ros.evaluation.results import RowsFile, filmstrip_path, header_of
from raw2drive_ros.evaluation.statistics import summarise, timing_of
from raw2drive_ros.simulation.environment import DrivingEnv, SimulationConfig, Tick
from raw2drive_ros.simulation.protocol import PAIRS
from raw2drive_ros.simulation.route_id import RouteId


class EvaluationInterrupted(KeyboardInterrupt):
    """Ctrl-C during an evaluation. result: what it would have returned for what was driven; None for nothing."""

    def __init__(self, result: Any) -> None:
        super().__init__()
        self.result = result


OnRoute = Callable[[int, RouteResult], None]


class Observer(Protocol):
    """Watches drives, to keep a picture of those that fail."""

    def see(self, env: DrivingEnv, tick: Tick) -> None:
        """Called on every tick."""

    def save(self, path: Path) -> Path:
        """Write what was seen of the last drive."""


@dataclass(frozen=True, slots=True)
class Conditions:
    """How routes are driven. bench2drive_compat: score as Bench2Drive's tools do. observe: makes the observer of a
    process. filmstrips: folder for what the observer saves of failed drives. limits_s: time limits of routes; the
    others have their scene's own. references_s: times of the driver that the limits were set from. protocol: see
    `simulation.protocol`."""

    image_size: tuple[int, int] = (96, 160)
    bench2drive_compat: bool = False
    observe: Callable[[], Observer] | None = None
    filmstrips: Path | None = None
    limits_s: Mapping[RouteId, float] = field(default_factory=dict)
    references_s: Mapping[RouteId, float] = field(default_factory=dict)
    protocol: str = PAIRS

    def with_reference(self, result: RouteResult) -> RouteResult:
        """A row with the reference time of its route, if there is one."""
        return replace(result, reference_s=self.references_s.get(RouteId.parse(result.id)))


class RouteRunner:
    """One process's driver and simulator."""

    def __init__(self, driver: EpisodeDriver, conditions: Conditions) -> None:
        self.driver = driver
        self.conditions = conditions
        self.env = DrivingEnv(
            SimulationConfig(
                conditions.image_size,
                cameras=driver.needs_cameras,
                bev=driver.needs_bev,
                end_on_infraction=False,
                protocol=conditions.protocol,
            )
        )
        self.observer = conditions.observe() if conditions.observe is not None else None

    def drive(self, route: RouteId) -> tuple[RouteResult, list[float]]:
        """(row, wall time of each tick in ms). A drive that raises becomes a failed route: the others still count."""
        observer = self.observer

        def on_tick(tick: Tick, decision: Decision) -> None:
            if observer is not None:
                observer.see(self.env, tick)

        try:
            compat = self.conditions.bench2drive_compat
            limit_s = self.conditions.limits_s.get(route)
            drive = drive_route(self.env, self.driver, route, on_tick, bench2drive_compat=compat, time_limit_s=limit_s)
        except DriverFailedError as error:
            print(f'{route}: {shown(error)}', file=sys.stderr)
            return failed_route(route, str(error)), []
        except Exception as error:
            traceback.print_exc()
            return failed_route(route, f'{type(error).__name__}: {error}'), []
        if observer is not None and self.conditions.filmstrips is not None and not drive.result.success:
            observer.save(filmstrip_path(self.conditions.filmstrips, str(route)))
        return drive.result, drive.tick_ms


_runner: RouteRunner | None = None


def _make_runner(spec: DriverSpec, conditions: Conditions) -> RouteRunner:
    import cv2

    cv2.setNumThreads(1)
    driver = spec.build()
    # Drivers without a model do not import torch. On tensors as small as one state, more threads only wait for each
    # other.
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
    """Drive all routes; returns what `summarise` returns.

    lines: a results file. Its header record says that nothing is finished yet; routes that have a row in it are not
    driven again. Raises ResultsError as `RowsFile` does, and EvaluationInterrupted at Ctrl-C.
    """
    conditions = conditions or Conditions()
    file = RowsFile(lines, conditions_header(spec, suite, version, routes, conditions))
    tick_ms: list[float] = []
    jobs = [route for route in routes if route not in file.rows]
    with interruptible(spec.label, suite, version, file, tick_ms, conditions.protocol):
        for result, times in _driven(spec, conditions, jobs, workers):
            tick_ms += times
            row = conditions.with_reference(result)
            file.add(row)
            on_route(len(file.rows), row)
    rows = list(file.rows.values())
    return summarise(spec.label, suite, version, routes, rows, timing_of(tick_ms), conditions.protocol)


def conditions_header(
    spec: DriverSpec, suite: str, version: str, routes: Sequence[RouteId], conditions: Conditions
) -> dict[str, Any]:
    """The first record of a file of results that are driven under `conditions`."""
    return header_of(
        spec.identity(),
        suite,
        version,
        routes,
        protocol=conditions.protocol,
        bench2drive_compat=conditions.bench2drive_compat,
    )


@contextmanager
def interruptible(
    name: str, suite: str, version: str, file: RowsFile, tick_ms: list[float], protocol: str = PAIRS
) -> Iterator[None]:
    """Turns Ctrl-C in the block into EvaluationInterrupted, with a summary of the rows that the file has by then."""
    try:
        yield
    except KeyboardInterrupt as stop:
        rows = list(file.rows.values())
        so_far = None
        if rows:
            so_far = summarise(name, suite, version, list(file.rows), rows, timing_of(tick_ms), protocol)
        raise EvaluationInterrupted(so_far) from stop


@contextmanager
def without_interrupts() -> Iterator[None]:
    """Processes that are started in the block ignore Ctrl-C: the one that started them ends them."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)


def _driven(
    spec: DriverSpec, conditions: Conditions, jobs: list[RouteId], workers: int
) -> Iterator[tuple[RouteResult, list[float]]]:
    if workers <= 1:
        runner = _make_runner(spec, conditions)
        for route in jobs:
            yield runner.drive(route)
        return
    # Spawned, not forked: torch's threads do not survive a fork. `imap` keeps the order of the routes, so that the file
    # does not depend on the number of workers.
    with without_interrupts():
        pool = multiprocessing.get_context('spawn').Pool(workers, _start_worker, (spec, conditions))
    with pool:
        yield from pool.imap(_work, jobs)
