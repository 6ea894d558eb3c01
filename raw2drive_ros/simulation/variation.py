"""Variation of camera images between drives of one route (exposure, mounting, ground colours, sun), not of physics.

`ImageEffects` adds noise and rain to finished images.
"""

from __future__ import annotations

import math
import zlib
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from raw2drive_ros.contracts.public import CameraCalibration, Float64
from raw2drive_ros.simulation.camera_rig import moved
from raw2drive_ros.simulation.draws import Rng
from raw2drive_ros.simulation.route_id import RouteId
from raw2drive_ros.simulation.weather import Weather

SUN_AZIMUTH_RAD = math.atan2(0.25, 0.35)
MOUNTING_SIGMA_RAD, MOUNTING_SIGMA_M = math.radians(0.3), 0.01
# Streaks of rain: length as a share of the image width, slant, brightness as a share of the sky's, and grey levels that
# the ego's lamps add at night.
STREAK_LENGTH, STREAK_SLANT, STREAK_LIGHT, STREAK_LIT = 0.07, 0.15, 0.28, 56.0
# The tile of noise and rain is wider than an image by this, and twice as high as the stack of images.
TILE_MARGIN_PX = 64
# Part of the seed: keeps the generator of the images apart from the one that draws the route.
PICTURES = 0x9C7

Triple = tuple[float, float, float]


@dataclass(frozen=True, slots=True)
class Variation:
    """exposure: gain. gamma: exponent of the tone curve. noise: standard deviation of a pixel in grey levels of
    255. mounting: per camera ((3,) rotation vector in rad, (3,) shift in metres, both in `base_link`), empty = as
    calibrated. asphalt, sidewalk, grass: gains of the ground's colours. line_wear: share of the
    markings that is worn away, [0, 1]. sun_azimuth_rad: azimuth of the sun in `map`.
    """

    exposure: float = 1.0
    gamma: float = 1.0
    noise: float = 0.0
    mounting: tuple[tuple[Triple, Triple], ...] = ()
    asphalt: float = 1.0
    sidewalk: float = 1.0
    grass: Triple = (1.0, 1.0, 1.0)
    line_wear: float = 0.0
    sun_azimuth_rad: float = SUN_AZIMUTH_RAD

    @property
    def tone_curve_is_identity(self) -> bool:
        """Whether exposure and gamma change nothing."""
        return self.exposure == 1.0 and self.gamma == 1.0

    def tone_mapped(self, colours: Float64) -> Float64:
        """Colours after the tone curve, [0, 255]."""
        positive = np.maximum(colours, 0.0)
        if not self.tone_curve_is_identity:
            positive = 255.0 * self.exposure * (positive / 255.0) ** self.gamma
        return np.minimum(positive, 255.0)

    @staticmethod
    def draw(rng: Rng, cameras: int) -> Variation:
        turns = rng.normal(0.0, MOUNTING_SIGMA_RAD, (cameras, 3)).tolist()
        shifts = rng.normal(0.0, MOUNTING_SIGMA_M, (cameras, 3)).tolist()
        return Variation(
            exposure=float(np.exp(rng.normal(0.0, 0.08))),
            gamma=float(np.exp(rng.normal(0.0, 0.06))),
            noise=float(rng.uniform(0.5, 3.0)),
            mounting=tuple((tuple(turn), tuple(shift)) for turn, shift in zip(turns, shifts, strict=True)),
            asphalt=float(rng.uniform(0.75, 1.35)),
            sidewalk=float(rng.uniform(0.8, 1.15)),
            grass=tuple((rng.uniform(0.75, 1.15) * rng.uniform([0.85, 0.92, 0.8], [1.35, 1.08, 1.2])).tolist()),
            line_wear=float(rng.uniform(0.0, 0.4)),
            sun_azimuth_rad=float(rng.uniform(-math.pi, math.pi)),
        )

    def mounted(self, cameras: tuple[CameraCalibration, ...]) -> tuple[CameraCalibration, ...]:
        """The cameras at their actual poses; the published calibrations stay the nominal ones."""
        if not self.mounting:
            return cameras
        return tuple(moved(camera, *by) for camera, by in zip(cameras, self.mounting, strict=True))


NO_VARIATION = Variation()


def picture_rng(route: RouteId) -> Rng:
    """The random generator of an episode's images: the same on every machine and in every weather."""
    return np.random.default_rng([route.seed, zlib.crc32(route.type.encode()), route.repetition, PICTURES])


class ImageEffects:
    """Noise and rain for a (height, width, 3) stack of images: a random crop of one tile in every frame."""

    def __init__(self, width: int, height: int) -> None:
        self.width, self.height = width, height
        self._normal: NDArray[np.float32] | None = None
        self._brighter: NDArray[np.uint8] | None = None
        self._darker: NDArray[np.uint8] | None = None

    def load(self, weather: Weather, variation: Variation, rng: Rng) -> None:
        """Prepare the tile. rng: places the crop; not used where there is neither noise nor rain."""
        self.rng = rng
        sigma = math.hypot(weather.noise, variation.noise)
        self._brighter = self._darker = None
        if not sigma and not weather.rain:
            return
        if self._normal is None:
            shape = (2 * self.height, self.width + TILE_MARGIN_PX, 3)
            self._normal = np.random.default_rng(0).standard_normal(shape, np.float32)
        noise = np.rint(self._normal * np.float32(sigma))
        self._darker = np.maximum(-noise, 0.0).astype(np.uint8)
        self._brighter = np.maximum(noise, 0.0).astype(np.uint8)
        if weather.rain:
            self._brighter = cv2.add(self._brighter, self._streaks(weather))

    def _streaks(self, weather: Weather) -> NDArray[np.uint8]:
        rows, columns = 2 * self.height, self.width + TILE_MARGIN_PX
        tile = np.zeros((rows, columns), np.uint8)
        length = STREAK_LENGTH * self.width
        rng = np.random.default_rng(1)
        count = round(weather.rain * rows * columns / length)
        starts = rng.uniform((0.0, 0.0), (columns, rows), (count, 2))
        falls = rng.uniform(0.5, 1.5, (count, 1)) * length * np.array([STREAK_SLANT, 1.0])
        brightest = STREAK_LIGHT * sum(weather.sky_horizon) / 3.0 + STREAK_LIT * weather.headlights
        light = brightest * rng.uniform(0.5, 1.0, count)
        for line, grey in zip(np.rint(np.stack([starts, starts + falls], 1)).astype(np.int32), light, strict=True):
            cv2.line(tile, line[0].tolist(), line[1].tolist(), float(grey), 1, cv2.LINE_AA)
        return cv2.cvtColor(tile, cv2.COLOR_GRAY2RGB)

    def apply(self, images: NDArray[np.uint8]) -> NDArray[np.uint8]:
        """Add noise and rain to (height, width, 3) uint8 images in place, and return them."""
        if self._brighter is None or self._darker is None:
            return images
        top, left = self.rng.integers((self.height, TILE_MARGIN_PX)).tolist()
        part = slice(top, top + self.height), slice(left, left + self.width)
        cv2.add(images, self._brighter[part], images)
        return cv2.subtract(images, self._darker[part], images)
