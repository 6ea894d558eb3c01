"""Many drives, one summary; per-route lines are on disk before the next drive starts, and are not driven twice."""

from __future__ import annotations

import json
import multiprocessing
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from raw2drive_ros.driving.bundle import load_bundle
from raw2drive_ros.evaluation.drivers import Blindfold, EpisodeDriver, make_driver
from raw2drive_ros.evaluation.episode import drive_route
from raw2drive_ros.evaluation.metrics import RouteResult, summarise
from raw2drive_ros.simulation.environment import DrivingEnv, SimulationConfig

Routes = list[tuple[str, int]]
OnRoute = Callable[[int, RouteResult], None]


class ResultsError(RuntimeError):
    """A file of results belongs to another evaluation, or is damaged."""


@dataclass(frozen=True, slots=True)
class DriverSpec:
    """What a worker process builds its driver from; see `drivers.make_driver`."""

    name: str
    bundle: Path | None = None
    run: Path | None = None
    threads: int = 1
    blind: bool = False

    def build(self) -> EpisodeDriver:
        driver = make_driver(self.name, self.bundle, self.run, 0.0, self.threads)
        return Blindfold(driver) if self.blind else driver

    def identity(self) -> str:
        """Tells results of different drivers apart: by their weights, not by where those lie."""
        weights = ''
        if self.name == 'raw' and self.bundle is not None:
            weights = load_bundle(self.bundle).identity
        elif self.name == 'privileged' and self.run is not None:
            # Late: the bridge imports this module and trains nothing.
            from raw2drive_ros.training.checkpoint import newest_checkpoint

            checkpoint = newest_checkpoint(self.run / 'checkpoints')
            weights = f'{self.run} {checkpoint.name if checkpoint else ""}'
        return ' '.join(filter(None, (self.name, weights, 'blind' if self.blind else '')))


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

    def __init__(self, driver: EpisodeDriver, image_size: tuple[int, int]) -> None:
        self.driver = driver
        self.env = DrivingEnv(
            SimulationConfig(image_size, cameras=driver.needs_cameras, bev=driver.needs_bev, end_on_infraction=False)
        )

    def drive(self, scenario: str, seed: int) -> tuple[RouteResult, list[float]]:
        drive = drive_route(self.env, self.driver, scenario, seed)
        return drive.result, drive.tick_ms


_runner: RouteRunner | None = None


def _start_worker(spec: DriverSpec, image_size: tuple[int, int]) -> None:
    import cv2
    import torch

    global _runner
    cv2.setNumThreads(1)
    torch.set_num_threads(spec.threads)
    _runner = RouteRunner(spec.build(), image_size)


def _work(job: tuple[int, str, int]) -> tuple[int, RouteResult, list[float]]:
    assert _runner is not None
    index, scenario, seed = job
    return index, *_runner.drive(scenario, seed)


def evaluate(
    spec: DriverSpec,
    suite: str,
    version: str,
    routes: Routes,
    image_size: tuple[int, int] = (96, 160),
    lines: Path | None = None,
    on_route: OnRoute = lambda done, result: None,
    workers: int = 1,
) -> dict[str, Any]:
    """Drive all routes; the result's form for machines.

    lines: a JSON-lines file. Its first record says that nothing is finished yet; routes that it holds
    already are not driven again. Raises ResultsError when it belongs to another driver or suite.
    """
    results: dict[int, RouteResult] = {}
    if lines is not None:
        results = _resume(lines, {'driver': spec.identity(), 'suite': suite, 'version': version}, routes)
    tick_ms: list[float] = []
    jobs = [(i, kind, seed) for i, (kind, seed) in enumerate(routes) if i not in results]
    for index, result, times in _driven(spec, image_size, jobs, workers):
        results[index] = result
        tick_ms += times
        if lines is not None:
            with lines.open('a') as file:
                file.write(json.dumps(result.to_json()) + '\n')
        on_route(len(results), result)
    return summarise(spec.name, suite, version, [results[i] for i in range(len(routes))], timing_of(tick_ms))


def _driven(
    spec: DriverSpec, image_size: tuple[int, int], jobs: list[tuple[int, str, int]], workers: int
) -> Iterator[tuple[int, RouteResult, list[float]]]:
    if workers <= 1:
        runner = RouteRunner(spec.build(), image_size)
        for index, kind, seed in jobs:
            yield index, *runner.drive(kind, seed)
        return
    # Spawned, not forked: torch's threads do not survive a fork.
    with multiprocessing.get_context('spawn').Pool(workers, _start_worker, (spec, image_size)) as pool:
        yield from pool.imap_unordered(_work, jobs)


def _resume(lines: Path, header: dict[str, str], routes: Routes) -> dict[int, RouteResult]:
    """Results that the file holds already; a new file gets its header."""
    lines.parent.mkdir(parents=True, exist_ok=True)
    if not lines.exists():
        record = {'status': 'failed, no data', 'started': time.time()} | header
        lines.write_text(json.dumps(record) + '\n')
        return {}
    text = lines.read_text()
    whole = text if text.endswith('\n') else text[: text.rfind('\n') + 1]
    if whole != text:
        # The last line was being written when its writer died.
        lines.write_text(whole)
    try:
        first, *rest = (json.loads(line) for line in whole.splitlines())
        found = {row['id']: RouteResult(**row) for row in rest}
    except (ValueError, TypeError, KeyError) as error:
        raise ResultsError(f'{lines}: damaged results ({error}); move it away or give another --out') from error
    different = [f'{key} {first.get(key)!r}, not {value!r}' for key, value in header.items() if first.get(key) != value]
    if different:
        raise ResultsError(f'{lines}: holds results of {"; ".join(different)}: give another --out')
    wanted = {f'{kind}/{seed}': i for i, (kind, seed) in enumerate(routes)}
    return {wanted[name]: row for name, row in found.items() if name in wanted}
