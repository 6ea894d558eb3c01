"""How many pixels of each actor, light and sign the cameras show: counted in an id buffer.

`CameraRenderer` keeps the buffer in the fourth channel of its frames, so that the same polygons in the same order make
picture and counts. `IdPainter` draws the buffer alone, for worlds without camera images, and counts the same.
"""

from __future__ import annotations

from collections import deque
from itertools import pairwise, repeat

import cv2
import numpy as np
from numpy.typing import NDArray

from raw2drive_ros.contracts.public import CameraCalibration
from raw2drive_ros.simulation.quads import SHIFT, Drawing, QuadProjector
from raw2drive_ros.simulation.things import Things, counted_things, scenery_of, things_in_sight
from raw2drive_ros.simulation.variation import NO_VARIATION, Variation
from raw2drive_ros.simulation.weather import CLEAR, WEATHERS, Weather
from raw2drive_ros.simulation.world import World

# Cars that appear smaller than this many pixels per metre have no wheels.
DETAIL_PX_PER_M = 3.3
SUPERSAMPLING = 2

Counts = NDArray[np.int32]


def detail_m(projector: QuadProjector) -> float:
    """Distance up to which cars are drawn with wheels, side windows and shadows."""
    return float(projector.focal.max()) / projector.scale / DETAIL_PX_PER_M


def no_counts(world: World, cameras: int) -> tuple[Counts, Counts]:
    """(actors, cameras) and (lights and stop signs, cameras) zeros."""
    actors, signals = counted_things(world)
    return np.zeros((actors, cameras), np.int32), np.zeros((signals, cameras), np.int32)


def count_pixels(
    buffer: NDArray[np.uint8], scale: int, drawing: Drawing, things: Things, world: World
) -> tuple[Counts, Counts]:
    """Pixels of the final images that show each thing: (actors, cameras) and (lights and stop signs, cameras).

    buffer: (cameras, H, W) numbers of `Things`, rendered at `scale` times the final resolution; of the pixels that
    become one, the first is counted.
    """
    cameras, height, width = buffer.shape
    found = np.zeros((len(things.rows) + 1, cameras), np.int32)
    numbered = np.flatnonzero(things.number[drawing.quad])
    bounds = np.searchsorted(drawing.camera[numbered], np.arange(cameras + 1)).tolist()
    for camera, (begin, end) in enumerate(pairwise(bounds)):
        if begin == end:
            continue
        part = numbered[begin:end]
        left, top = np.maximum(drawing.low[part].min(axis=0) // scale * scale, 0.0).astype(int).tolist()
        right, bottom = np.minimum(drawing.high[part].max(axis=0) + 2.0, (width, height)).astype(int).tolist()
        left, top = max(0, left - scale), max(0, top - scale)
        seen = buffer[camera, top:bottom:scale, left:right:scale]
        found[:, camera] = np.bincount(seen.ravel(), minlength=len(found))
    counts, signals = no_counts(world, cameras)
    together = np.concatenate([counts, signals])
    together[things.rows] = found[1:]
    return together[: len(counts)], together[len(counts) :]


class IdPainter:
    """Counts pixels of a world without drawing its pictures; `new_world` sets the world, `count` looks at it.

    counts: (actors, cameras) int32. signal_counts: (lights and stop signs, cameras) int32, see `count_pixels`.
    """

    def __init__(self, cameras: tuple[CameraCalibration, ...], supersampling: int = SUPERSAMPLING) -> None:
        self.cameras = cameras
        self.projector = QuadProjector(cameras, supersampling)
        self.buffer = np.zeros((len(cameras), self.projector.height, self.projector.width), np.uint8)
        self.world: World | None = None

    def new_world(self, world: World, weather: Weather = WEATHERS[CLEAR], variation: Variation = NO_VARIATION) -> None:
        """Count in `world` from now on."""
        self.world, self.night = world, weather.headlights > 0.0
        self.projector.mount(variation.mounted(self.cameras))
        self.scenery = scenery_of(world, night=self.night)

    def count(self) -> tuple[Counts, Counts]:
        """(counts, signal_counts) of the world as it is now. Raises RuntimeError before `new_world`."""
        if self.world is None:
            raise RuntimeError('IdPainter.count: call new_world first')
        pose = self.world.ego_history[0]
        things = things_in_sight(self.world, pose, self.scenery, night=self.night, detail_m=detail_m(self.projector))
        drawing = None if things is None else self.projector.project(things)
        self.counts, self.signal_counts = no_counts(self.world, len(self.cameras))
        if things is not None and drawing is not None:
            self.buffer.fill(0)
            frames = list(self.buffer)
            numbers = things.number[drawing.quad].tolist()
            drawn_on = [frames[index] for index in drawing.camera.tolist()]
            deque(map(cv2.fillConvexPoly, drawn_on, drawing.polygons, numbers, repeat(cv2.LINE_8), repeat(SHIFT)), 0)
            self.counts, self.signal_counts = count_pixels(
                self.buffer, self.projector.scale, drawing, things, self.world
            )
        return self.counts, self.signal_counts
