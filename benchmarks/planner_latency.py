"""Six images to command in the planner's function, p50 and p99, with one and two torch threads.

python -m benchmarks.planner_latency
"""

from __future__ import annotations

import cv2
import numpy as np

from raw2drive_ros.driving.bundle import load_bundle
from raw2drive_ros.driving.raw_driver import RawDriver
from raw2drive_ros.evaluation.episode import drive_route
from raw2drive_ros.evaluation.episode_driver import SensorDriver
from raw2drive_ros.settings import default_bundle
from raw2drive_ros.simulation.environment import DrivingEnv, SimulationConfig
from raw2drive_ros.simulation.route_id import RouteId


def main() -> None:
    """Drive two routes per number of threads; print a table."""
    cv2.setNumThreads(1)
    bundle = load_bundle(default_bundle())
    print('| torch threads | p50 ms | p99 ms | decisions |')
    print('|---|---|---|---|')
    for threads in (1, 2):
        driver = SensorDriver(RawDriver(bundle, threads), cameras=True)
        env = DrivingEnv(SimulationConfig(end_on_infraction=False))
        decide_ms: list[float] = []
        for seed in (0, 1):
            decide_ms += drive_route(env, driver, RouteId('LaneFollowing', seed), max_ticks=250).decide_ms[5:]
        p50, p99 = np.percentile(decide_ms, [50, 99])
        print(f'| {threads} | {p50:.1f} | {p99:.1f} | {len(decide_ms)} |')


if __name__ == '__main__':
    main()
