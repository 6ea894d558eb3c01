"""The last seconds of a drive as a filmstrip of top-down pictures: what a failure looked like, at a glance."""

from __future__ import annotations

from collections import deque
from pathlib import Path

import cv2
import numpy as np

from raw2drive_ros.artifact import write_whole
from raw2drive_ros.report.panels import Rgb, text
from raw2drive_ros.simulation.bev import BevRenderer
from raw2drive_ros.simulation.environment import DrivingEnv, Tick
from raw2drive_ros.simulation.world import World
from raw2drive_ros.tables.bev_channels import CHANNELS, SIZE_PX
from raw2drive_ros.tables.bev_colours import colour_masks
from raw2drive_ros.tables.rates import DECISION_HZ

PICTURES = 7
EVERY_TICKS = round(0.8 * DECISION_HZ)
CAPTION_PX, GAP_PX = 18, 2
JPEG_QUALITY = 75


class FilmstripRecorder:
    """Call `see` on every tick and `save` after the drive. A new world starts a new filmstrip.

    Moments are kept as copies of the world and drawn by `save` alone, because most drives need no filmstrip.
    """

    def __init__(self) -> None:
        self.world: World | None = None
        self.moments: deque[World] = deque(maxlen=PICTURES - 1)
        self.ticks = 0

    def see(self, env: DrivingEnv, tick: Tick) -> None:
        if env.world is not self.world:
            self.world, self.ticks = env.world, 0
            self.moments.clear()
        if self.world is not None and self.ticks % EVERY_TICKS == 0:
            self.moments.append(self.world.fork())
        self.ticks += 1

    def draw(self) -> Rgb:
        """(H, W, 3) RGB: the kept moments, and the world as it is now. Raises RuntimeError before the first tick."""
        if self.world is None:
            raise RuntimeError('FilmstripRecorder: nothing was seen')
        renderer = BevRenderer(self.world)
        tiles = [_tile(renderer, moment, self.world.time_s) for moment in (*self.moments, self.world)]
        gap = np.full((tiles[0].shape[0], GAP_PX, 3), 255, np.uint8)
        parts = [part for tile in tiles for part in (gap, tile)][1:]
        return np.hstack(parts)

    def save(self, path: Path) -> Path:
        """Write a JPEG; it appears whole or not at all. Raises OSError."""
        done, encoded = cv2.imencode('.jpg', self.draw()[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY])
        if not done:
            raise OSError(f'{path}: the filmstrip cannot be encoded')
        path.parent.mkdir(parents=True, exist_ok=True)
        write_whole(path, encoded.tobytes())
        return path


def _tile(renderer: BevRenderer, moment: World, end_s: float) -> Rgb:
    renderer.world = moment
    picture = colour_masks(renderer.render().astype(np.float32), list(CHANNELS))
    caption = np.full((CAPTION_PX, SIZE_PX, 3), 28, np.uint8)
    ago = moment.time_s - end_s
    text(caption, f'{ago:+.1f} s' if ago else 'end', (4, 13))
    text(caption, f'{abs(moment.ego.speed) * 3.6:.0f} km/h', (66, 13))
    return np.vstack([picture, caption])
