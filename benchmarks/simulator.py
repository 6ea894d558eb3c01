"""What a simulator step costs on one core: cameras and BEV on or off, by number of vehicles, cameras, by weather.

python -m benchmarks.simulator [--profile]
"""

from __future__ import annotations

import argparse
import cProfile
import pstats
import time
from collections.abc import Sequence
from typing import Any

import cv2
import numpy as np

from raw2drive_ros.contracts.public import Control
from raw2drive_ros.simulation.environment import DrivingEnv, SimulationConfig
from raw2drive_ros.simulation.layout import RoadLayout, Straight
from raw2drive_ros.simulation.renderer import CameraRenderer
from raw2drive_ros.simulation.scenario import REGISTRY, RouteSpec, Scenario, Scene, TrafficSpec

STEPS, SAMPLES = 150, 5
SPARSE_M, DENSE_M = 9.0, 3.0
CASES = {
    'six cameras 96x160 + BEV': SimulationConfig(),
    'six cameras 224x400 + BEV': SimulationConfig((224, 400)),
    'BEV only': SimulationConfig(cameras=False),
    'neither': SimulationConfig(cameras=False, bev=False),
}
CURVES = {
    'six cameras 96x160': SimulationConfig(bev=False),
    'BEV': SimulationConfig(cameras=False),
    'neither': SimulationConfig(cameras=False, bev=False),
}
TABLE_COUNTS, CURVE_COUNTS, CAMERA_VEHICLES = (0, 5, 10, 20), (0, 1, 2, 5, 10, 20, 40), 10
WEATHERS = ('ClearNoon', 'HardRainNight', 'FogNoon')


def traffic(count: int, spacing_m: float = SPARSE_M) -> str:
    """Register a straight three-lane road with `count` vehicles ahead of the ego, each one lane to the side of and
    `spacing_m` ahead of the one before; returns the name of the scenario."""

    def draw(rng) -> Scene:
        cars = tuple(TrafficSpec('forward', 20.0 + spacing_m * i, 6.0, lane=i % 3) for i in range(count))
        return Scene(RoadLayout((Straight(400),), 3, 0, 12.0), RouteSpec(1, start_speed_mps=5.0), cars)

    name = f'Benchmark{count}x{spacing_m:.0f}m'
    REGISTRY[name] = Scenario(name, (), draw)
    return name


def ms_per_step(env: DrivingEnv, scenario: str, weather: str = 'ClearNoon', seed: int = 0) -> float:
    """CPU time of a step, on average over one episode."""
    env.reset(seed=seed, options={'scenario': scenario, 'weather': weather})
    started = time.process_time()
    steps = 0
    while steps < STEPS and not env.done:
        env.step(Control(0.12))
        steps += 1
    return 1e3 * (time.process_time() - started) / steps


def compared(cases: Sequence[tuple[Any, ...]]) -> list[float]:
    """ms per step of each case, least of `SAMPLES` episodes; cases take turns, so that other load slows all of them."""
    return np.min([[ms_per_step(*case, seed=seed) for case in cases] for seed in range(SAMPLES)], axis=0).tolist()


def with_cameras(count: int) -> DrivingEnv:
    """An environment with the first `count` cameras of the rig and without BEV."""
    env = DrivingEnv(SimulationConfig(cameras=count > 0, bev=False))
    if count:
        env.rig = env.rig[:count]
        env.renderer = CameraRenderer(env.rig, env.simulation.supersampling)
    return env


def table(title: str, columns: Sequence[object], rows: dict[str, list[str]]) -> None:
    """Print a Markdown table; rows: name -> cells."""
    print(f'\n| {title} | ' + ' | '.join(str(column) for column in columns) + ' |')
    print('|---' * (len(columns) + 1) + '|')
    for name, cells in rows.items():
        print(f'| {name} | ' + ' | '.join(cells) + ' |')


def with_slope(counts: Sequence[int], costs: list[float]) -> list[str]:
    """Cells of a row: the costs, and the slope of a least-squares line (cost per vehicle or camera)."""
    slope = float(np.polyfit(counts, costs, 1)[0])
    return [f'{cost:.2f}' for cost in costs] + [f'{slope:.3f}']


def main() -> None:
    """Measure every case; print the tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('--profile', action='store_true')
    options = parser.parse_args()
    cv2.setNumThreads(1)
    rows = {}
    for name, config in CASES.items():
        env = DrivingEnv(config)
        costs = compared([(env, traffic(count)) for count in TABLE_COUNTS])
        rows[name] = [f'{1e3 / cost:.0f}' for cost in costs]
    table(f'steps/s (CPU time, best of {SAMPLES})', [f'{count} vehicles' for count in TABLE_COUNTS], rows)

    rows = {}
    for name, config in CURVES.items():
        env = DrivingEnv(config)
        rows[name] = with_slope(CURVE_COUNTS, compared([(env, traffic(count, DENSE_M)) for count in CURVE_COUNTS]))
    table('ms per step, by vehicles', [*CURVE_COUNTS, 'per vehicle'], rows)

    busy = traffic(CAMERA_VEHICLES)
    counts = range(len(DrivingEnv().rig) + 1)
    costs = compared([(with_cameras(count), busy) for count in counts])
    rows = {f'{CAMERA_VEHICLES} vehicles': with_slope(counts, costs)}
    table('ms per step, by cameras of 96x160', [*counts, 'per camera'], rows)

    env = DrivingEnv(SimulationConfig())
    costs = compared([(env, busy, weather) for weather in WEATHERS])
    rows = {f'six cameras 96x160 + BEV, {CAMERA_VEHICLES} vehicles': [f'{cost:.2f}' for cost in costs]}
    table('ms per step, by weather', WEATHERS, rows)

    if options.profile:
        profile = cProfile.Profile()
        profile.runcall(ms_per_step, DrivingEnv(), busy)
        pstats.Stats(profile).sort_stats('tottime').print_stats(15)


if __name__ == '__main__':
    main()
