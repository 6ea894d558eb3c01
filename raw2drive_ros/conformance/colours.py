"""Are red and blue exchanged? Only where sky and plants both say so.

Either alone proves nothing: a sunset is red, and the light of a lamp colours everything. Light that makes the sky
redder than blue makes plants redder too; a sky redder than blue above plants bluer than red does not occur.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from raw2drive_ros.conformance.observation import Observation, Verdict
from raw2drive_ros.conformance.views import rays
from raw2drive_ros.contracts.public import CameraCalibration, Float64, Image8

# Rays that rise or fall more steeply than this (as a share of their length) see sky or ground.
STEEP = 0.1
# Grey levels by which red and blue must differ in sky and plants; by which green exceeds both in plants.
SKY_LEVELS, PLANT_LEVELS, GREEN_LEVELS = 8.0, 4.0, 8.0
LEAST_SHARE = 0.02
CHECK = 'cameras: order of the colours'


def red_over_blue(camera: CameraCalibration, image: Image8) -> tuple[float | None, float | None]:
    """Median of red minus blue in the sky and in the plants of a (H, W, 3) picture, in grey levels; None where there is
    too little of either."""
    height, width = image.shape[:2]
    columns, rows = np.meshgrid(np.arange(0, width, 2), np.arange(0, height, 2))
    pixels = np.column_stack([columns.ravel(), rows.ravel()]).astype(np.float64)
    directions = rays(camera, pixels)
    rise = directions[:, 2] / np.linalg.norm(directions, axis=1)
    colours = image[rows.ravel(), columns.ravel()].astype(np.float64)
    red, green, blue = colours.T
    plants = (rise < -STEEP) & (green > np.maximum(red, blue) + GREEN_LEVELS)
    return _median(red - blue, rise > STEEP), _median(red - blue, plants)


def _median(values: Float64, chosen: Float64) -> float | None:
    return float(np.median(values[chosen])) if chosen.mean() > LEAST_SHARE else None


def judge_colours(seen: Observation, trusted: list[str]) -> Iterator[Verdict]:
    """One verdict for all cameras. trusted: those whose pictures are the right way up."""
    exchanged, right, unknown = [], [], []
    for name in trusted:
        camera, image = seen.calibrations.get(name), seen.images.get(name)
        if camera is None or image is None or image.shape[:2] != (camera.height, camera.width):
            continue
        sky, plants = red_over_blue(camera, image)
        if sky is not None and plants is not None and sky > SKY_LEVELS and plants < -PLANT_LEVELS:
            exchanged.append(f'{name} (sky {sky:+.0f}, plants {plants:+.0f})')
        elif sky is not None and sky < -SKY_LEVELS:
            right.append(name)
        else:
            unknown.append(name)
    if exchanged:
        text = f'red minus blue, in grey levels: {", ".join(exchanged)}'
        yield Verdict(CHECK, 'error', text, 'red and blue are exchanged: the bytes are BGR and the encoding says rgb8')
    elif right:
        yield Verdict(CHECK, 'passed', f'the sky is bluer than red: {", ".join(right)}')
    elif unknown:
        text = 'cannot tell: no blue sky over plants'
        yield Verdict(CHECK, 'skipped', text, 'look at the mosaic: are the colours natural?')
