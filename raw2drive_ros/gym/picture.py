"""The picture that `render` returns."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from raw2drive_ros.report.panels import canvas_of, put, put_mosaic
from raw2drive_ros.simulation.environment import Tick
from raw2drive_ros.tables.bev_channels import CHANNELS
from raw2drive_ros.tables.bev_colours import colour_masks

TILE = (240, 144)
SIDE = 2 * TILE[1]


def picture_of(tick: Tick) -> NDArray[np.uint8]:
    """(288, 1008, 3) uint8 RGB of a tick with images and masks: the cameras, and right of them the masks."""
    assert tick.privileged is not None
    canvas = canvas_of(3 * TILE[0] + SIDE, SIDE)
    put_mosaic(canvas, tick.sensors.images, 0, 0, TILE)
    masks = colour_masks(tick.privileged.bev.astype(np.float32), list(CHANNELS))
    put(canvas, masks, 3 * TILE[0], 0, SIDE, SIDE, smooth=False)
    return canvas
