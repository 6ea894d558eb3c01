"""Simulator steps per second on one core: cameras and BEV on or off, by number of vehicles; and a profile.

python -m benchmarks.simulator [--profile]
"""

from __future__ import annotations

import argparse
import cProfile
import pstats
import time

import cv2

from raw2drive_ros.contract import Control
from raw2drive_ros.simulation.environment import DrivingEnv, SimulationConfig
from raw2drive_ros.simulation.layout import RoadLayout, Straight
from raw2drive_ros.simulation.scenario import REGISTRY, RouteSpec, Scenario, Scene, TrafficSpec

STEPS, SAMPLES = 150, 5


def traffic(count: int) -> None:
    """Register a straight three-lane road with `count` vehicles around the ego."""

    def draw(rng) -> Scene:
        cars = tuple(TrafficSpec('forward', 20.0 + 9.0 * i, 6.0, lane=i % 3) for i in range(count))
        return Scene(RoadLayout((Straight(400),), 3, 0, 12.0), RouteSpec(1, start_speed_mps=5.0), cars)

    REGISTRY[f'Benchmark{count}'] = Scenario(f'Benchmark{count}', (), draw)


def steps_per_second(config: SimulationConfig, scenario: str) -> float:
    env = DrivingEnv(config)
    rates = []
    for sample in range(SAMPLES):
        env.reset(seed=sample, options={'scenario': scenario})
        started = time.process_time()
        steps = 0
        while steps < STEPS and not env.done:
            env.step(Control(0.12))
            steps += 1
        rates.append(steps / (time.process_time() - started))
    return max(rates)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('--profile', action='store_true')
    options = parser.parse_args()
    cv2.setNumThreads(1)
    cases = {
        'six cameras 96x160 + BEV': SimulationConfig(),
        'six cameras 224x400 + BEV': SimulationConfig((224, 400)),
        'BEV only': SimulationConfig(cameras=False),
        'neither': SimulationConfig(cameras=False, bev=False),
    }
    counts = (0, 5, 10, 20)
    for count in counts:
        traffic(count)
    print('| steps/s (CPU time, best of 5) | ' + ' | '.join(f'{c} vehicles' for c in counts) + ' |')
    print('|---' * (len(counts) + 1) + '|')
    for name, config in cases.items():
        rates = [steps_per_second(config, f'Benchmark{count}') for count in counts]
        print(f'| {name} | ' + ' | '.join(f'{rate:.0f}' for rate in rates) + ' |')
    if options.profile:
        profile = cProfile.Profile()
        profile.runcall(steps_per_second, SimulationConfig(), 'Benchmark10')
        pstats.Stats(profile).sort_stats('tottime').print_stats(15)


if __name__ == '__main__':
    main()
