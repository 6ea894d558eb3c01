"""One colour per mask class, wherever masks are shown."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

# Drawn in this order; names that a preset lacks are skipped.
COLOURS = {
    'road': (70, 70, 74),
    'route': (40, 150, 95),
    'line': (220, 220, 220),
    'lane_line': (220, 220, 220),
    'centre_line': (200, 150, 50),
    'crosswalk_or_stop_line': (240, 240, 240),
    'vehicle_past': (40, 80, 130),
    'vulnerable_past': (130, 40, 130),
    'vehicle': (80, 160, 255),
    'vehicle@now': (80, 160, 255),
    'agent': (80, 160, 255),
    'emergency': (255, 80, 80),
    'emergency_vehicle@now': (255, 80, 80),
    'vulnerable': (255, 0, 255),
    'walker@now': (255, 0, 255),
    'cyclist@now': (0, 255, 255),
    'obstacle': (255, 160, 0),
    'obstacle@now': (255, 160, 0),
    'stop': (255, 0, 0),
    'stop_light': (255, 0, 0),
    'light_red@now': (255, 0, 0),
    'light_yellow@now': (255, 200, 0),
    'light_green@now': (0, 255, 0),
    'stop_sign': (255, 0, 120),
    'stop_sign@now': (255, 0, 120),
    'ego': (255, 240, 40),
}


def colour_masks(masks: NDArray[np.float32], names: list[str]) -> NDArray[np.uint8]:
    """(C, H, W) probabilities -> (H, W, 3) uint8 RGB, blended class by class with the probability as alpha."""
    picture = np.zeros((*masks.shape[1:], 3), np.float32)
    for name, colour in COLOURS.items():
        if name in names:
            alpha = masks[names.index(name)][..., None]
            picture = picture * (1 - alpha) + np.array(colour, np.float32) * alpha
    return picture.astype(np.uint8)
