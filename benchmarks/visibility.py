"""What it costs to know what is seen: a step with and without `SimulationConfig.visibility`, and with scenery.

python -m benchmarks.visibility
"""

from __future__ import annotations

import time

import cv2
import numpy as np

from benchmarks.simulator import table, traffic
from raw2drive_ros.contracts.public import Control
from raw2drive_ros.simulation.environment import DrivingEnv, SimulationConfig

STEPS, SAMPLES = 60, 5
COUNTS = (10, 20)
CONFIGS = {
    'six cameras 96x160 + BEV': SimulationConfig(visibility=False),
    'six cameras 96x160 + BEV, visibility': SimulationConfig(),
    'BEV': SimulationConfig(cameras=False, visibility=False),
    'BEV, visibility': SimulationConfig(cameras=False),
}


def ms_per_step(env: DrivingEnv, scenario: str, seed: int, *, scenery: bool) -> float:
    """CPU time of a step, on average over one episode."""
    env.reset(seed=seed, options={'scenario': scenario})
    assert env.world is not None
    if not scenery:
        env.world.scenery = ()
        env.prepare_pictures()
    started = time.process_time()
    steps = 0
    while steps < STEPS and not env.done:
        env.step(Control(0.12))
        steps += 1
    return 1e3 * (time.process_time() - started) / steps


def main() -> None:
    """Measure all cases in turn, so that other load slows all of them; print the table."""
    cv2.setNumThreads(1)
    envs = {name: DrivingEnv(config) for name, config in CONFIGS.items()}
    columns = [(count, scenery) for count in COUNTS for scenery in (False, True)]
    costs = np.full((len(envs), len(columns)), np.inf)
    for seed in range(SAMPLES):
        for column, (count, scenery) in enumerate(columns):
            for row, env in enumerate(envs.values()):
                costs[row, column] = min(costs[row, column], ms_per_step(env, traffic(count), seed, scenery=scenery))
    heads = [f'{count} vehicles' + (', scenery' if scenery else '') for count, scenery in columns]
    rows = {name: [f'{ms:.2f} ({1e3 / ms:.0f}/s)' for ms in line] for name, line in zip(envs, costs, strict=True)}
    for number, name in ((0, 'cameras'), (2, 'BEV alone')):
        rows[f'more with visibility: {name}'] = [
            f'{100.0 * (seeing / blind - 1.0):+.0f} %'
            for blind, seeing in zip(costs[number], costs[number + 1], strict=True)
        ]
    table(f'ms per step (CPU time, least of {SAMPLES} episodes)', heads, rows)


if __name__ == '__main__':
    main()
