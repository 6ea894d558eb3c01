"""Many drives, one summary; per-route lines are on disk before the next drive starts."""

from __future__ import annotations

import json
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from raw2drive_ros.evaluation.drivers import EpisodeDriver
from raw2drive_ros.evaluation.episode import drive_route
from raw2drive_ros.evaluation.metrics import RouteResult, summarise
from raw2drive_ros.evaluation.routes import SUITE_VERSION
from raw2drive_ros.simulation.environment import DrivingEnv, SimulationConfig


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


def evaluate(
    name: str,
    driver: EpisodeDriver,
    suite: str,
    routes: list[tuple[str, int]],
    image_size: tuple[int, int] = (96, 160),
    lines: Path | None = None,
    on_route: Callable[[int, RouteResult], None] = lambda index, result: None,
) -> dict[str, Any]:
    """Drive all routes. lines: a JSON-lines file, whose first record says that nothing is finished yet."""
    config = SimulationConfig(image_size, cameras=driver.needs_cameras, bev=driver.needs_bev, end_on_infraction=False)
    env = DrivingEnv(config)
    if lines is not None:
        lines.parent.mkdir(parents=True, exist_ok=True)
        header = {'status': 'failed, no data', 'driver': name, 'suite': suite, 'started': time.time()}
        lines.write_text(json.dumps(header) + '\n')
    results: list[RouteResult] = []
    tick_ms: list[float] = []
    for index, (scenario, seed) in enumerate(routes):
        drive = drive_route(env, driver, scenario, seed)
        results.append(drive.result)
        tick_ms += drive.tick_ms
        if lines is not None:
            with lines.open('a') as file:
                file.write(json.dumps(drive.result.to_json()) + '\n')
        on_route(index, drive.result)
    return summarise(name, suite, SUITE_VERSION, results, timing_of(tick_ms))
