"""What it costs to know what is seen: a step with and without `SimulationConfig.visibility`, and with scenery.

python -m benchmarks.visibility
"""

from __future__ import annotations

import time
from dataclasses import dataclass

import cv2
import numpy as np

from benchmarks.simulator import table, traffic
from raw2drive_ros.contracts.public import Control
from raw2drive_ros.simulation.environment import DrivingEnv, SimulationConfig
from raw2drive_ros.simulation.world import World

STEPS, SAMPLES = 60, 5
COUNTS = (10, 20)
ITEMS = 70
CONFIGS = {
    'six cameras 96x160 + BEV': SimulationConfig(visibility=False),
    'six cameras 96x160 + BEV, visibility': SimulationConfig(),
    'BEV': SimulationConfig(cameras=False, visibility=False),
    'BEV, visibility': SimulationConfig(cameras=False),
}
# (kind, length, width, height, gap to the road) in metres, colour.
KINDS = (
    ('house', 11.0, 9.0, 7.0, 6.0, (205, 190, 165)),
    ('tree', 4.0, 4.0, 7.0, 3.0, (66, 102, 48)),
    ('tree', 3.0, 3.0, 5.0, 7.0, (88, 108, 44)),
    ('wall', 12.0, 0.3, 1.6, 3.0, (150, 120, 100)),
    ('hedge', 9.0, 1.0, 1.2, 3.0, (52, 88, 42)),
    ('hill', 50.0, 24.0, 6.0, 40.0, (92, 118, 66)),
    ('pole', 0.2, 0.2, 6.0, 1.8, (110, 110, 110)),
)


@dataclass(frozen=True, slots=True)
class Item:
    """One thing beside the road, as `World.scenery` holds them."""

    kind: str
    x_m: float
    y_m: float
    yaw_rad: float
    length_m: float
    width_m: float
    height_m: float
    colour: tuple[int, int, int]
    seed: int


def scenery(world: World, count: int) -> tuple[Item, ...]:
    """Things on both sides of the road, evenly along the route."""
    found = []
    for i, s_m in enumerate(np.linspace(5.0, world.route.length_m - 5.0, count).tolist()):
        kind, length, width, height, gap, colour = KINDS[i % len(KINDS)]
        side = 1.0 if i % 2 else -1.0
        x, y, yaw = world.route.pose(s_m, side * (8.0 + gap + width / 2))
        found.append(Item(kind, x, y, yaw, length, width, height, colour, i))
    return tuple(found)


def ms_per_step(env: DrivingEnv, scenario: str, seed: int, items: int) -> float:
    """CPU time of a step, on average over one episode."""
    env.reset(seed=seed, options={'scenario': scenario})
    assert env.world is not None
    if items:
        env.world.scenery = scenery(env.world, items)
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
    columns = [(count, items) for count in COUNTS for items in (0, ITEMS)]
    costs = np.full((len(envs), len(columns)), np.inf)
    for seed in range(SAMPLES):
        for column, (count, items) in enumerate(columns):
            for row, env in enumerate(envs.values()):
                costs[row, column] = min(costs[row, column], ms_per_step(env, traffic(count), seed, items))
    heads = [f'{count} vehicles' + (f', {items} items' if items else '') for count, items in columns]
    rows = {name: [f'{ms:.2f} ({1e3 / ms:.0f}/s)' for ms in line] for name, line in zip(envs, costs, strict=True)}
    for number, name in ((0, 'cameras'), (2, 'BEV alone')):
        rows[f'more with visibility: {name}'] = [
            f'{100.0 * (seeing / blind - 1.0):+.0f} %'
            for blind, seeing in zip(costs[number], costs[number + 1], strict=True)
        ]
    table(f'ms per step (CPU time, least of {SAMPLES} episodes)', heads, rows)


if __name__ == '__main__':
    main()
