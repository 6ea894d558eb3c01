"""The ground with its markings as an image pyramid, and its projection into all cameras in any weather."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cache

import cv2
import numpy as np
from numpy.typing import NDArray

from raw2drive_ros.contracts.public import CameraCalibration, Float64
from raw2drive_ros.simulation.roads import RoadMap
from raw2drive_ros.simulation.variation import NO_VARIATION, Variation
from raw2drive_ros.simulation.weather import CLEAR, WEATHERS, Weather

PIXELS_PER_M = 8.0
LEVELS = 4
# Pixels of the first level in one of the last.
COARSEST = 2 ** (LEVELS - 1)
FAR_M = 110.0
# Coordinate of the ground points of pixels that show none within `FAR_M`.
NOWHERE_M = 1e5
# Where neighbouring image pixels show points that are closer than this, one sample per pixel is enough.
COARSE_M = 0.35
# Matrices of the warps lead from pixels of the frame to pixels of the texture.
WARP = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
# Distance assumed for everything beyond `FAR_M`.
HORIZON_M = 165.0
GRASS, SIDEWALK, ASPHALT = (86, 110, 62), (150, 148, 142), (72, 72, 76)
PAINT = {
    'white': (235, 235, 235),
    'yellow': (230, 190, 60),
    'stop': (240, 240, 240),
    'zebra': (240, 240, 240),
    'arrow': (235, 235, 235),
}
LINE_WIDTH_M = {'white': 0.18, 'yellow': 0.18, 'stop': 0.5}
DASH_M, GAP_M = 3.0, 3.0
SHIFT = 4
SPECKLE_PX = 256
# Share of brightness that wet asphalt and wet soil lose, and share of the sky reflected at a grazing angle.
WET_ASPHALT, WET_SOIL, WET_MIRROR = 0.4, 0.15, 0.45

Rgb = NDArray[np.uint8]


@dataclass(frozen=True, slots=True)
class PaintedGround:
    """pyramid: RGBX textures, each half as wide as the one before; rows grow with y (the fourth channel is 0, nobody's
    number in the id buffer; OpenCV remaps four channels in half the time of three). origin_m: (2,) `map` position of
    the centre of pixel (0, 0) of the first level. beyond: (3,) RGB outside the texture."""

    pyramid: list[Rgb]
    origin_m: Float64
    beyond: Float64


def paint_ground(
    road: RoadMap, weather: Weather = WEATHERS[CLEAR], variation: Variation = NO_VARIATION
) -> PaintedGround:
    """The ground where the light is brightest: everywhere by day, in the beam of the headlights at night."""
    points = np.concatenate(road.sidewalks_m + road.surfaces_m)
    origin = points.min(axis=0) - 6.0
    size = np.ceil((points.max(axis=0) + 6.0 - origin) * PIXELS_PER_M).astype(int)
    # Every level has to be exactly half as large as the one before, otherwise it is stretched by up to a pixel.
    size = -(-size // COARSEST) * COARSEST
    grass, sidewalk, asphalt = ground_colours(weather, variation)
    texture: Rgb = np.empty((int(size[1]), int(size[0]), 3), np.uint8)
    texture[:] = np.tile(np.round(grass).astype(np.uint8), (texture.shape[1], 1))

    def pixels(points_m: Float64) -> NDArray[np.int32]:
        return np.round((points_m - origin) * PIXELS_PER_M * 2**SHIFT).astype(np.int32)

    def paint(kind: str) -> list[float]:
        worn = variation.line_wear * asphalt + (1.0 - variation.line_wear) * np.array(PAINT[kind])
        return worn.tolist()

    for polygon in road.sidewalks_m:
        cv2.fillPoly(texture, [pixels(polygon)], sidewalk.tolist(), shift=SHIFT)
    for polygon in road.surfaces_m:
        cv2.fillPoly(texture, [pixels(polygon)], asphalt.tolist(), shift=SHIFT)
    for polygon in road.islands_m:
        cv2.fillPoly(texture, [pixels(polygon)], grass.tolist(), shift=SHIFT)
    for marking in road.markings:
        kind = marking.kind.removesuffix('_dashed')
        if kind in ('zebra', 'arrow'):
            cv2.fillPoly(texture, [pixels(marking.points_m)], paint(kind), shift=SHIFT)
            continue
        width = max(1, round(LINE_WIDTH_M[kind] * PIXELS_PER_M))
        lines = [marking.points_m]
        if marking.kind.endswith('_dashed'):
            lines = _dashes(marking.points_m)
        for line in lines:
            cv2.polylines(
                texture,
                [pixels(line)],
                isClosed=False,
                color=paint(kind),
                thickness=width,
                lineType=cv2.LINE_AA,
                shift=SHIFT,
            )
    speckle = _speckle()
    rows, columns = texture.shape[:2]
    for top in range(0, rows, SPECKLE_PX):
        for left in range(0, columns, SPECKLE_PX):
            tile = texture[top : top + SPECKLE_PX, left : left + SPECKLE_PX]
            np.add(tile, speckle[: tile.shape[0], : tile.shape[1]], out=tile)
    light = brightest(weather)
    if not variation.tone_curve_is_identity or (light != 1.0).any():
        table = variation.tone_mapped(np.arange(256.0)[:, None] * light)
        texture = cv2.LUT(texture, np.round(table)[:, None].astype(np.uint8))
    return PaintedGround(_pyramid(texture), origin, variation.tone_mapped(grass * light))


def _pyramid(texture: Rgb) -> list[Rgb]:
    """All levels of a texture, with a fourth channel of zeros."""
    first = cv2.cvtColor(texture, cv2.COLOR_RGB2RGBA)
    first[..., 3] = 0
    pyramid = [first]
    for _ in range(LEVELS - 1):
        last = pyramid[-1]
        half = (last.shape[1] // 2, last.shape[0] // 2)
        pyramid.append(cv2.resize(last, half, interpolation=cv2.INTER_AREA))
    return pyramid


@cache
def _speckle() -> Rgb:
    """Fixed noise that gives uniform surfaces some texture (optical flow); one tile, repeated to save time."""
    grey = np.random.default_rng(0).integers(0, 13, (SPECKLE_PX, SPECKLE_PX, 1), dtype=np.uint8)
    return np.repeat(grey, 3, axis=2)


def ground_colours(weather: Weather, variation: Variation) -> tuple[Float64, Float64, Float64]:
    """RGB (3,) of grass, sidewalk and asphalt in full light."""
    soil = 1.0 - WET_SOIL * weather.wet
    return (
        np.array(GRASS) * variation.grass * soil,
        np.array(SIDEWALK) * (variation.sidewalk * soil),
        np.array(ASPHALT) * (variation.asphalt * (1.0 - WET_ASPHALT * weather.wet)),
    )


def far_ground(weather: Weather, variation: Variation) -> Float64:
    """(3,) RGB of the ground between `FAR_M` and the horizon."""
    grass, _, _ = ground_colours(weather, variation)
    clear = math.exp(-HORIZON_M / weather.fog_m) * (1.0 - WET_MIRROR * weather.wet)
    own = variation.tone_mapped(grass * weather.light * weather.tint())
    return own * clear + variation.tone_mapped(np.array(weather.sky_horizon)) * (1.0 - clear)


def brightest(weather: Weather) -> Float64:
    """(3,) RGB gain where the light is brightest, see `paint_ground`."""
    return (weather.light + weather.headlights) * weather.tint()


def _dashes(points_m: Float64) -> list[Float64]:
    """The dashes of a polyline whose points are 1 m apart."""
    period, dash = int(DASH_M + GAP_M), int(DASH_M)
    return [points_m[i : i + dash + 1] for i in range(0, len(points_m) - 1, period)]


@dataclass(slots=True)
class _Band:
    """Rows of one camera that sample the same pyramid level. step: a sample stands for so many pixels, along each axis.
    from_sample: (3, 3), column and row of a sample within the band to a homogeneous ground point in the ego frame."""

    camera: int
    first_row: int
    last_row: int
    level: int
    step: int
    from_sample: Float64


@dataclass(slots=True)
class _View:
    """What one camera sees of the ground. ego_xy: (R, W, 2) ground points of its rows from `first_row` on. far_rows:
    so many of them hold points beyond `FAR_M` or above the horizon; far: (far_rows, W) bool, which."""

    first_row: int
    ego_xy: NDArray[np.float32]
    far_rows: int
    far: NDArray[np.bool_]
    gain: Rgb | None = None
    veil: Rgb | None = None


class GroundProjector:
    """Draws the ground into the frames of a rig: per camera and pyramid level one perspective warp of the texture."""

    def __init__(self, cameras: tuple[CameraCalibration, ...], scale: int) -> None:
        self.cameras = cameras
        self.bands: list[_Band] = []
        self.views: list[_View] = []
        for index, camera in enumerate(cameras):
            ego_xy, footprint, first = _ground_rays(camera, scale)
            far = ego_xy[..., 0] >= NOWHERE_M
            far_rows = int(np.flatnonzero(far.any(axis=1)).max(initial=-1)) + 1
            self.views.append(_View(first, ego_xy, far_rows, far[:far_rows]))
            if not len(ego_xy):
                continue
            wanted = np.clip(np.floor(np.log2(np.maximum(footprint * PIXELS_PER_M, 1.0))), 0, LEVELS - 1)
            # Footprints shrink from the horizon downwards, so each level is one contiguous band of rows.
            level_of_row = np.minimum.accumulate(wanted).astype(int)
            for level in range(LEVELS):
                rows = np.flatnonzero(level_of_row == level)
                if len(rows):
                    self._add_bands(index, first + int(rows[0]), first + int(rows[-1]) + 1, level, scale)

    def _add_bands(self, index: int, start: int, end: int, level: int, scale: int) -> None:
        """The rows from `start` to `end`; those near the car in steps of image pixels."""
        camera = self.cameras[index]
        near = end
        if level == 0:
            # Row below which a step of one image pixel is at most `COARSE_M` along the view ray.
            focal, height = camera.intrinsics[1, 1], camera.base_from_camera[2, 3]
            row = camera.intrinsics[1, 2] + math.sqrt(focal * height / COARSE_M)
            near = min(max(math.ceil(row) * scale, -(-start // scale) * scale), end)
        for first, last, step in ((start, near, 1), (near, end, scale)):
            if first < last:
                self.bands.append(
                    _Band(index, first, last, level, step, _ground_from_sample(camera, scale, first, step))
                )

    @property
    def first_rows(self) -> list[int]:
        """Per camera: the first row that shows the ground."""
        return [view.first_row for view in self.views]

    def light(self, weather: Weather, variation: Variation) -> None:
        """Set the effect of fog, wet road and headlights on the colours of `paint_ground`, per pixel."""
        plain = np.isinf(weather.fog_m) and not weather.wet and not weather.headlights
        air = variation.tone_mapped(np.array(weather.sky_horizon))
        for view, camera in zip(self.views, self.cameras, strict=True):
            view.gain = view.veil = None
            if plain or not len(view.ego_xy):
                continue
            position = camera.base_from_camera[:3, 3]
            delta = view.ego_xy - position[:2]
            reach = np.minimum(np.hypot(np.hypot(delta[..., 0], delta[..., 1]), position[2]), HORIZON_M)
            clear = np.exp(-reach / weather.fog_m)
            mirror = WET_MIRROR * weather.wet * np.clip(1.0 - position[2] / reach, 0.0, 1.0) ** 4
            lit = (weather.light + weather.beam(view.ego_xy)) / (weather.light + weather.headlights)
            gain = lit**variation.gamma * clear * (1.0 - mirror)
            veil = 1.0 - clear * (1.0 - mirror)
            view.gain = np.repeat(np.round(255.0 * gain)[..., None], 4, axis=2).astype(np.uint8)
            view.veil = np.round(veil[..., None] * np.append(air, 0.0)).astype(np.uint8)

    def draw(self, frames: Rgb, ground: PaintedGround, pose: tuple[float, float, float]) -> None:
        """Paint the ground into all frames (cameras, H, W, 4), in place."""
        x, y, yaw = pose
        cos, sin = math.cos(yaw), math.sin(yaw)
        width = frames.shape[2]
        beyond = (*ground.beyond.tolist(), 0.0)
        to_level = []
        for level in range(LEVELS):
            scale = PIXELS_PER_M / 2**level
            # The centre of pixel 0 of a level lies between the pixels 0 and 2**level - 1 of the first one.
            shift = 0.5 * (0.5**level - 1.0)
            column, row = (x - ground.origin_m[0]) * scale + shift, (y - ground.origin_m[1]) * scale + shift
            to_level.append(
                np.array([[scale * cos, -scale * sin, column], [scale * sin, scale * cos, row], [0.0, 0.0, 1.0]])
            )
        for band in self.bands:
            rows = frames[band.camera, band.first_row : band.last_row]
            seen = cv2.warpPerspective(
                ground.pyramid[band.level],
                to_level[band.level] @ band.from_sample,
                (width // band.step, len(rows) // band.step),
                rows if band.step == 1 else None,
                WARP,
                cv2.BORDER_CONSTANT,
                beyond,
            )
            if band.step > 1:
                cv2.resize(seen, (width, len(rows)), rows, 0, 0, cv2.INTER_NEAREST)
        for frame, view in zip(frames, self.views, strict=True):
            rows = frame[view.first_row :]
            if view.far_rows:
                rows[: view.far_rows][view.far] = beyond
            if view.gain is not None:
                cv2.multiply(rows, view.gain, rows, 1.0 / 255.0)
                cv2.add(rows, view.veil, rows)


def _ground_from_sample(camera: CameraCalibration, scale: int, first_row: int, step: int) -> Float64:
    """See `_Band`: the inverse of the projection of the plane z = 0."""
    intrinsics = camera.intrinsics * np.array([[scale], [scale], [1.0]])
    rotation, position = camera.base_from_camera[:3, :3], camera.base_from_camera[:3, 3]
    # Ground points (x, y, 1) in the optical frame: rotation.T @ ((x, y, 0) - position).
    plane = rotation.T @ np.column_stack([np.eye(3)[:, :2], -position])
    centres = np.array([[step, 0.0, 0.5 * step], [0.0, step, first_row + 0.5 * step], [0.0, 0.0, 1.0]])
    inverse: Float64 = np.linalg.inv(intrinsics @ plane) @ centres
    return inverse / np.abs(inverse).max()


def _ground_rays(camera: CameraCalibration, scale: int) -> tuple[NDArray[np.float32], Float64, int]:
    """((R, W, 2) ego-frame ground points, (R,) footprint in metres, first row) of the rows that see the ground."""
    height, width = camera.height * scale, camera.width * scale
    intrinsics = camera.intrinsics * np.array([[scale], [scale], [1.0]])
    position = camera.base_from_camera[:3, 3]

    def rays(u: Float64, v: Float64) -> Float64:
        columns, rows = np.meshgrid(u, v)
        optical = np.stack([columns, rows, np.ones_like(columns)], axis=-1) @ np.linalg.inv(intrinsics).T
        return optical @ camera.base_from_camera[:3, :3].T

    u, v = np.arange(width) + 0.5, np.arange(height) + 0.5
    # The rays at either end of a row point downwards most.
    below = (-rays(u[[0, -1]], v)[..., 2] > 1e-6).any(axis=1)
    horizon = int(np.argmax(below)) if below.any() else height
    seen = rays(u, v[horizon:])
    falling = -seen[..., 2]
    reach = position[2] / np.maximum(falling, 1e-6)
    ground = position[:2] + seen[..., :2] * reach[..., None]
    distance = np.hypot(ground[..., 0] - position[0], ground[..., 1] - position[1])
    visible = (falling > 1e-6) & (distance < FAR_M)
    first = int(np.argmax(visible.any(axis=1))) if visible.any() else len(visible)
    ground[(distance > FAR_M) | (falling <= 1e-6)] = NOWHERE_M
    # Geometric mean of the footprints across and along the view ray, halved by the supersampling later.
    across = distance / intrinsics[0, 0]
    along = distance * distance / (intrinsics[1, 1] * position[2])
    footprint = np.sqrt(across * along)
    # Per row: the mean over what is visible there (rows without any are above `first`).
    count = visible.sum(axis=1)
    row_footprint = np.where(visible, footprint, 0.0).sum(axis=1) / np.maximum(count, 1)
    return ground[first:].astype(np.float32), row_footprint[first:], horizon + first
