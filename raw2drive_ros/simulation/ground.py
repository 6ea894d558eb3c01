"""The painted ground as an image pyramid, and its projection into all cameras at once."""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from raw2drive_ros.contract import CameraCalibration, Float64
from raw2drive_ros.simulation.roads import RoadMap

PIXELS_PER_M = 8.0
LEVELS = 4
FAR_M = 110.0
GRASS, SIDEWALK, ASPHALT = (86, 110, 62), (150, 148, 142), (72, 72, 76)
PAINT = {'white': (235, 235, 235), 'yellow': (230, 190, 60), 'stop': (240, 240, 240), 'zebra': (240, 240, 240)}
LINE_WIDTH_M = {'white': 0.18, 'yellow': 0.18, 'stop': 0.5}
DASH_M, GAP_M = 3.0, 3.0
SHIFT = 4

Rgb = NDArray[np.uint8]


def paint_ground(road: RoadMap) -> tuple[list[Rgb], Float64]:
    """(pyramid of RGB textures, (2,) `map` position of the texture's pixel (0, 0)). Row grows with y."""
    points = np.concatenate(road.sidewalks_m + road.surfaces_m)
    origin = points.min(axis=0) - 6.0
    size = np.ceil((points.max(axis=0) + 6.0 - origin) * PIXELS_PER_M).astype(int)
    texture: Rgb = np.empty((int(size[1]), int(size[0]), 3), np.uint8)
    texture[:] = GRASS

    def pixels(points_m: Float64) -> NDArray[np.int32]:
        return np.round((points_m - origin) * PIXELS_PER_M * 2**SHIFT).astype(np.int32)

    for polygon in road.sidewalks_m:
        cv2.fillPoly(texture, [pixels(polygon)], SIDEWALK, shift=SHIFT)
    for polygon in road.surfaces_m:
        cv2.fillPoly(texture, [pixels(polygon)], ASPHALT, shift=SHIFT)
    for marking in road.markings:
        kind = marking.kind.removesuffix('_dashed')
        if kind == 'zebra':
            cv2.fillPoly(texture, [pixels(marking.points_m)], PAINT[kind], shift=SHIFT)
            continue
        width = max(1, round(LINE_WIDTH_M[kind] * PIXELS_PER_M))
        lines = [marking.points_m]
        if marking.kind.endswith('_dashed'):
            lines = _dashes(marking.points_m)
        for line in lines:
            cv2.polylines(texture, [pixels(line)], False, PAINT[kind], width, cv2.LINE_AA, SHIFT)
    # A fixed speckle gives the asphalt something to flow; deterministic, and tiled to save time.
    speckle = np.random.default_rng(0).integers(0, 13, (256, 256, 1), dtype=np.uint8)
    rows, columns = texture.shape[:2]
    for top in range(0, rows, 256):
        for left in range(0, columns, 256):
            tile = texture[top : top + 256, left : left + 256]
            np.add(tile, speckle[: tile.shape[0], : tile.shape[1]], out=tile)
    pyramid = [texture]
    for _ in range(LEVELS - 1):
        last = pyramid[-1]
        half = (max(1, last.shape[1] // 2), max(1, last.shape[0] // 2))
        pyramid.append(cv2.resize(last, half, interpolation=cv2.INTER_AREA))
    return pyramid, origin


def _dashes(points_m: Float64) -> list[Float64]:
    """Cut a 1 m polyline into dashes and gaps."""
    period, dash = int(DASH_M + GAP_M), int(DASH_M)
    return [points_m[i : i + dash + 1] for i in range(0, len(points_m) - 1, period)]


@dataclass(slots=True)
class _Band:
    """Rows of one camera that read the same pyramid level."""

    camera: int
    first_row: int
    last_row: int
    level: int


class GroundProjector:
    """Where each pixel of a rig sees the ground, in the ego frame; fixed for a fixed calibration."""

    def __init__(self, cameras: tuple[CameraCalibration, ...], scale: int) -> None:
        self.bands: list[_Band] = []
        maps: dict[int, list[NDArray[np.float32]]] = {level: [] for level in range(LEVELS)}
        for index, camera in enumerate(cameras):
            ego_xy, footprint, first = _ground_rays(camera, scale)
            if first >= len(ego_xy):
                continue
            wanted = np.clip(np.floor(np.log2(np.maximum(footprint * PIXELS_PER_M, 1.0))), 0, LEVELS - 1)
            # Footprints shrink downwards, so each level is one contiguous band of rows.
            level_of_row = np.minimum.accumulate(wanted[first:]).astype(int)
            for level in range(LEVELS):
                rows = np.flatnonzero(level_of_row == level)
                if len(rows):
                    start, end = first + int(rows[0]), first + int(rows[-1]) + 1
                    self.bands.append(_Band(index, start, end, level))
                    maps[level].append(ego_xy[start:end])
        self.maps = {level: np.concatenate(parts) for level, parts in maps.items() if parts}

    def draw(self, frames: list[Rgb], pyramid: list[Rgb], origin: Float64, pose: tuple[float, float, float]) -> None:
        """Paint the ground into every frame (modified in place)."""
        x, y, yaw = pose
        cos, sin = math.cos(yaw), math.sin(yaw)
        colours: dict[int, Rgb] = {}
        for level, ego_xy in self.maps.items():
            scale = PIXELS_PER_M / 2**level
            affine = np.array(
                [
                    [scale * cos, -scale * sin, (x - origin[0]) * scale],
                    [scale * sin, scale * cos, (y - origin[1]) * scale],
                ]
            )
            where = cv2.transform(ego_xy, affine)
            colours[level] = cv2.remap(
                pyramid[level],
                where,
                None,
                cv2.INTER_LINEAR,
                borderMode=cv2.BORDER_CONSTANT,
                borderValue=GRASS,
            )
        taken = dict.fromkeys(colours, 0)
        for band in self.bands:
            rows = band.last_row - band.first_row
            start = taken[band.level]
            frames[band.camera][band.first_row : band.last_row] = colours[band.level][start : start + rows]
            taken[band.level] = start + rows


def _ground_rays(camera: CameraCalibration, scale: int) -> tuple[NDArray[np.float32], Float64, int]:
    """((H, W, 2) ego-frame ground points, (H,) footprint in metres, first row below the horizon)."""
    height, width = camera.height * scale, camera.width * scale
    intrinsics = camera.intrinsics * np.array([[scale], [scale], [1.0]])
    u, v = np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5)
    rays = np.stack([u, v, np.ones_like(u)], axis=-1) @ np.linalg.inv(intrinsics).T
    rays = rays @ camera.base_from_camera[:3, :3].T
    position = camera.base_from_camera[:3, 3]
    falling = -rays[..., 2]
    reach = position[2] / np.maximum(falling, 1e-6)
    ground = position[:2] + rays[..., :2] * reach[..., None]
    distance = np.hypot(*(ground - position[:2]).transpose(2, 0, 1))
    visible = (falling > 1e-6) & (distance < FAR_M)
    first = int(np.argmax(visible.any(axis=1))) if visible.any() else height
    ground[distance > FAR_M] = 1e5
    # Geometric mean of the footprints across and along the view ray, halved by the supersampling later.
    across = distance / intrinsics[0, 0]
    along = distance * distance / (intrinsics[1, 1] * position[2])
    footprint = np.sqrt(across * along)
    # Per row: the mean over what is visible there (rows without any are above `first`).
    seen = visible.sum(axis=1)
    row_footprint = np.where(visible, footprint, 0.0).sum(axis=1) / np.maximum(seen, 1)
    return ground.astype(np.float32), row_footprint, first
