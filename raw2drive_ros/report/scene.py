"""One picture of a scenario, for people who write new ones: cameras and BEV after a few seconds of driving."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np

from raw2drive_ros.bev_channels import CHANNELS
from raw2drive_ros.evaluation.drivers import rule_episodes
from raw2drive_ros.report.colours import colour_masks
from raw2drive_ros.simulation.environment import DrivingEnv, SimulationConfig

TICKS = 60


def save_scene(target: Path, scenario: str, seed: int, image_size: tuple[int, int]) -> Path:
    """Drive `TICKS` ticks with the rule driver and write a PNG."""
    env = DrivingEnv(SimulationConfig(image_size, end_on_infraction=False))
    driver = rule_episodes()
    driver.reset(seed)
    tick, _ = env.reset(seed=seed, options={'scenario': scenario})
    for _ in range(TICKS):
        if env.done:
            break
        tick, *_ = env.step(driver.control(env, tick.sensors, tick).control)
    images = tick.sensors.images
    rows = [
        np.hstack([images[n] for n in ('front_left', 'front', 'front_right')]),
        np.hstack([images[n] for n in ('back_left', 'back', 'back_right')]),
    ]
    mosaic = np.vstack(rows)
    assert tick.privileged is not None
    bev = colour_masks(tick.privileged.bev.astype(np.float32), list(CHANNELS))
    side = mosaic.shape[0]
    bev = cv2.resize(bev, (side, side), interpolation=cv2.INTER_NEAREST)
    picture = np.hstack([mosaic, bev])
    if not cv2.imwrite(str(target), picture[..., ::-1]):
        raise OSError(f'{target}: cannot be written')
    return target
