"""What a step of one world costs alone and in a batch, on one core: by number of vehicles, with and without BEV masks
and cameras.

python -m benchmarks.world_batch [--worlds 8]
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Sequence

import cv2

from benchmarks.simulator import table, traffic
from raw2drive_ros.contracts.public import Control
from raw2drive_ros.simulation.draws import TRAIN_SEED_START
from raw2drive_ros.simulation.environment import DrivingEnv, SimulationConfig
from raw2drive_ros.simulation.route_id import RouteId
from raw2drive_ros.simulation.world_batch import WorldBatch

TICKS, SAMPLES = 50, 5
COMMAND = Control(0.12)
COUNTS = (0, 10, 20)
TYPES = ('NonSignalizedJunctionLeftTurn', 'SequentialLaneChange')
CONFIGS = {
    'neither (observation vector)': SimulationConfig(cameras=False, bev=False),
    'BEV (observation bev)': SimulationConfig(cameras=False, visibility=False),
    'six cameras 96x160 (observation cameras)': SimulationConfig(bev=False, visibility=False),
}


def ms_per_step(batch: WorldBatch, scenario: str, *, together: bool) -> float:
    """CPU time per step and world, over the first `TICKS` ticks of as many routes as there are worlds."""
    for i in range(len(batch.envs)):
        batch.reset(i, RouteId(scenario, TRAIN_SEED_START + i))
    steps, started = 0, time.process_time()
    for _ in range(TICKS):
        driving = batch.driving
        steps += len(driving)
        for part in [driving] if together else [[i] for i in driving]:
            batch.step(dict.fromkeys(part, COMMAND))
    return 1e3 * (time.process_time() - started) / steps


def compared(config: SimulationConfig, worlds: int, scenarios: Sequence[str]) -> list[str]:
    """Cells: ms alone, ms in the batch, and how many times as fast; the two take turns, the least of each counts."""
    batch = WorldBatch([DrivingEnv(config) for _ in range(worlds)])
    cells = []
    for scenario in scenarios:
        times = {False: [], True: []}
        for _ in range(SAMPLES):
            for together, found in times.items():
                found.append(ms_per_step(batch, scenario, together=together))
        alone, together = min(times[False]), min(times[True])
        cells.append(f'{alone:.2f} / {together:.2f} = {alone / together:.2f}')
    return cells


def main() -> None:
    """Measure every case; print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument('--worlds', type=int, default=8)
    options = parser.parse_args()
    cv2.setNumThreads(1)
    scenarios = [*map(traffic, COUNTS), *TYPES]
    rows = {name: compared(config, options.worlds, scenarios) for name, config in CONFIGS.items()}
    columns = [*(f'{count} vehicles' for count in COUNTS), *TYPES]
    table(f'ms per step alone / in a batch of {options.worlds} = times as fast (CPU, best of {SAMPLES})', columns, rows)


if __name__ == '__main__':
    main()
