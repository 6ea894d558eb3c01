"""Six pinhole cameras in numpy and OpenCV: textured ground, then quads from far to near, a box filter, noise and rain.

Geometry is one vectorised pass over all cameras; only drawing the visible quads is a Python loop.
"""

from __future__ import annotations

import math
from collections import deque
from itertools import repeat

import cv2
import numpy as np

from raw2drive_ros.contracts.public import CameraCalibration, Float64, Image8
from raw2drive_ros.simulation.ground import GroundProjector, Rgb, far_ground, paint_ground
from raw2drive_ros.simulation.id_painter import SUPERSAMPLING, Counts, count_pixels, detail_m, no_counts
from raw2drive_ros.simulation.quads import SHIFT, QuadProjector
from raw2drive_ros.simulation.things import Things, scenery_of, things_in_sight
from raw2drive_ros.simulation.variation import NO_VARIATION, ImageEffects, Variation
from raw2drive_ros.simulation.weather import CLEAR, LAMP_REACH, WEATHERS, Weather
from raw2drive_ros.simulation.world import World

HAZE_M = 180.0
SUN_HEIGHT, SUN_ACROSS = 0.9, 0.43
# Light on a surface: ambient, and direct from the sun or, diffuse, from clouds (on the sides, and more on top).
AMBIENT, DIRECT, CLOUD_SIDE, CLOUD_ABOVE = 0.55, 0.45, 0.4, 0.4


class CameraRenderer:
    """Renders a world through a rig of cameras of one image size; `new_world` sets the world and keeps the tables.

    counts: (actors, cameras) int32 and signal_counts: (lights and stop signs, cameras) int32: the pixels of the images
    of the last `render` that show each of them. They are None where counting is off.
    """

    def __init__(self, cameras: tuple[CameraCalibration, ...], supersampling: int = SUPERSAMPLING) -> None:
        self.cameras = cameras
        self.scale = supersampling
        self.projector = QuadProjector(cameras, supersampling)
        self.width, self.height = self.projector.width, self.projector.height
        # Red, green, blue, and the number of the thing that is seen there.
        self.frames: Rgb = np.zeros((len(cameras), self.height, self.width, 4), np.uint8)
        self.detail_m = detail_m(self.projector)
        self.nominal_ground = GroundProjector(cameras, supersampling)
        self._mount(cameras)
        self.effects = ImageEffects(cameras[0].width, cameras[0].height * len(cameras))
        self.world: World | None = None
        self.counting = True
        self.counts: Counts | None = None
        self.signal_counts: Counts | None = None

    def _mount(self, cameras: tuple[CameraCalibration, ...]) -> None:
        self.mounted = cameras
        self.ground = self.nominal_ground if cameras is self.cameras else GroundProjector(cameras, self.scale)
        self.projector.mount(cameras)

    def new_world(
        self,
        world: World,
        weather: Weather = WEATHERS[CLEAR],
        variation: Variation = NO_VARIATION,
        rng: np.random.Generator | None = None,
    ) -> None:
        """Render `world` from now on. rng: for noise and rain in every frame; default: one with a fixed seed."""
        self.world, self.weather, self.variation = world, weather, variation
        mounted = variation.mounted(self.cameras)
        if mounted is not self.mounted:
            self._mount(mounted)
        self.air = variation.tone_mapped(np.array(weather.sky_horizon))
        self.painted = paint_ground(world.road, weather, variation)
        self.ground.light(weather, variation)
        self.skies = [
            _sky(camera, self.scale, rows, weather, variation)
            for camera, rows in zip(mounted, self.ground.first_rows, strict=True)
        ]
        self.scenery = scenery_of(world, night=weather.headlights > 0.0)
        self.effects.load(weather, variation, rng or np.random.default_rng(0))
        self.counts = self.signal_counts = None

    def render(self) -> dict[str, Image8]:
        """Camera name -> (H, W, 3) uint8 RGB of the world as it is now. Raises RuntimeError before `new_world`."""
        if self.world is None:
            raise RuntimeError('CameraRenderer.render: call new_world first')
        pose = self.world.ego_history[0]
        for frame, sky in zip(self.frames, self.skies, strict=True):
            frame[: len(sky)] = sky
        self.ground.draw(self.frames, self.painted, pose)
        self._draw_things(self.world, pose)
        stack = self.frames.reshape(-1, self.width, 4)
        if self.scale > 1:
            # All image heights are multiples of the box filter, so it never mixes two cameras.
            stack = cv2.resize(stack, (self.width // self.scale, len(stack) // self.scale), None, 0, 0, cv2.INTER_AREA)
        images = self.effects.apply(cv2.cvtColor(stack, cv2.COLOR_RGBA2RGB)).reshape(
            len(self.cameras), -1, self.width // self.scale, 3
        )
        return {camera.name: image for camera, image in zip(self.cameras, images, strict=True)}

    def _draw_things(self, world: World, pose: tuple[float, float, float]) -> None:
        """Draw all things into the frames, and count their pixels."""
        night = self.weather.headlights > 0.0
        things = things_in_sight(world, pose, self.scenery, night=night, detail_m=self.detail_m)
        drawing = None if things is None else self.projector.project(things)
        if self.counting:
            self.counts, self.signal_counts = no_counts(world, len(self.cameras))
        if things is None or drawing is None:
            return
        paint = self._paint(things, pose)[drawing.quad].tolist()
        frames = list(self.frames)
        drawn_on = [frames[index] for index in drawing.camera.tolist()]
        # A map without a loop body: half of the time of this step would be the interpreter's otherwise.
        deque(map(cv2.fillConvexPoly, drawn_on, drawing.polygons, paint, repeat(cv2.LINE_8), repeat(SHIFT)), 0)
        if self.counting:
            self.counts, self.signal_counts = count_pixels(self.frames[..., 3], self.scale, drawing, things, world)

    def _paint(self, things: Things, pose: tuple[float, float, float]) -> Float64:
        """(Q, 4) RGB and number of all quads in this weather, with haze by their distance from the ego."""
        weather = self.weather
        azimuth = self.variation.sun_azimuth_rad - pose[2]
        sun = np.array([SUN_ACROSS * math.cos(azimuth), SUN_ACROSS * math.sin(azimuth), SUN_HEIGHT])
        clouds = CLOUD_SIDE + CLOUD_ABOVE * things.normals[:, 2]
        direct = weather.sun * np.maximum(things.normals @ sun, 0.0) + (1.0 - weather.sun) * clouds
        light = weather.light * (AMBIENT + DIRECT * direct)
        if weather.headlights:
            light += weather.beam(things.quad_place_m)
        gain = np.where(things.emissive[:, None], 1.0, light[:, None] * weather.tint())
        colours = self.variation.tone_mapped(things.colours * gain)
        thickness = 1.0 / HAZE_M + np.where(things.emissive, 1.0 / LAMP_REACH, 1.0) / weather.fog_m
        clear = np.exp(-things.distance_m * thickness)[:, None]
        return np.column_stack([self.air + (colours - self.air) * clear, things.number])


def _sky(camera: CameraCalibration, scale: int, rows: int, weather: Weather, variation: Variation) -> Rgb:
    """(rows, W, 4) uint8: a vertical gradient down to the horizon, then distant grass down to the drawn ground."""
    v = (np.arange(rows) + 0.5) / scale
    rise = (camera.intrinsics[1, 2] - v) / camera.intrinsics[1, 1]
    part = np.clip(rise / 0.6, 0.0, 1.0)[:, None]
    column = np.array(weather.sky_horizon) * (1 - part) + np.array(weather.sky_top) * part
    column = variation.tone_mapped(column)
    column[rise < 0] = far_ground(weather, variation)
    column = np.column_stack([column, np.zeros(rows)])
    return np.repeat(column[:, None], camera.width * scale, axis=1).astype(np.uint8)
