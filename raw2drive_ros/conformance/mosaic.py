"""All cameras in one labelled picture for the eye: what each should show, drawn over what it shows."""

from __future__ import annotations

import math

import cv2
import numpy as np

from raw2drive_ros.conformance.observation import Observation
from raw2drive_ros.conformance.views import Move, predicted_flow, project
from raw2drive_ros.contracts.public import CameraCalibration, Float64, Image8

TILE_PX, TITLE_PX, TEXT_PX, GAP_PX = 480, 30, 70, 8
HORIZON, RANGE, ARROW, INK, PAPER = (230, 40, 40), (255, 255, 255), (255, 220, 0), (20, 20, 20), (245, 245, 245)
# Distances that are drawn on the ground, and the drive whose motion the arrows show.
RANGES_M, DRIVE_M = (5.0, 10.0, 20.0), 1.0
TITLE = 'red: horizon by K and mounting.  white: ground at 5, 10, 20 m.  yellow: its motion when driving 1 m ahead'


def mosaic(seen: Observation, rig: tuple[CameraCalibration, ...]) -> Image8:
    """(H, W, 3) RGB: cameras that look ahead in the first row, the others in the second, the car's left on the left.

    rig: the cameras of the bundle; drawn is the vehicle's own calibration where it is known.
    """
    rows: list[list[CameraCalibration]] = [[], []]
    for camera in sorted(rig, key=lambda c: -_left(c)):
        rows[0 if abs(_azimuth_rad(camera)) < math.radians(75.0) else 1].append(camera)
    tiles = [[_tile(seen, camera) for camera in row] for row in rows if row]
    height = max(tile.shape[0] for row in tiles for tile in row)
    width = max(len(row) for row in tiles) * (TILE_PX + GAP_PX) + GAP_PX
    sheet: Image8 = np.full((TITLE_PX + len(tiles) * (height + GAP_PX), width, 3), PAPER, np.uint8)
    _write(sheet, TITLE, (GAP_PX, 20))
    for i, row in enumerate(tiles):
        for j, tile in enumerate(row):
            top, left = TITLE_PX + i * (height + GAP_PX), GAP_PX + j * (TILE_PX + GAP_PX)
            sheet[top : top + tile.shape[0], left : left + TILE_PX] = tile
    return sheet


def expectation(camera: CameraCalibration) -> tuple[str, str]:
    """Two lines: where the camera looks, and what its picture must show."""
    azimuth = math.degrees(_azimuth_rad(camera))
    side = 'ahead' if abs(azimuth) < 1.0 else 'back' if abs(azimuth) > 179.0 else ''
    side = side or f'{abs(azimuth):.0f} degrees to the {"left" if azimuth > 0 else "right"}'
    return (
        f'{camera.name}: looks {side}',
        f'sky above the red line; driving ahead, the ground moves {_direction(camera)}',
    )


def _left(camera: CameraCalibration) -> float:
    """How far to the car's left a camera looks, -1 (right) to 1; sorts the tiles of a row."""
    return math.sin(_azimuth_rad(camera))


def _azimuth_rad(camera: CameraCalibration) -> float:
    """Direction of the optical axis in `base_link`, left positive."""
    axis = camera.base_from_camera[:3, 2]
    return math.atan2(axis[1], axis[0])


def _direction(camera: CameraCalibration) -> str:
    """Where in the picture the ground at its bottom moves while the car drives ahead."""
    bottom = np.array([[camera.width / 2.0, camera.height - 1.0]])
    x, y = np.nan_to_num(predicted_flow(camera, bottom, Move(0.1, 0.0, 0.0))[0])
    if abs(x) > abs(y):
        return 'to the right' if x > 0 else 'to the left'
    return 'down, towards the car' if y > 0 else 'up, away from the car'


def _tile(seen: Observation, camera: CameraCalibration) -> Image8:
    camera = seen.calibrations.get(camera.name, camera)
    height = round(TILE_PX * camera.height / camera.width)
    tile: Image8 = np.full((height + TEXT_PX, TILE_PX, 3), PAPER, np.uint8)
    image = seen.images.get(camera.name)
    if image is not None:
        tile[:height] = cv2.resize(image, (TILE_PX, height), interpolation=cv2.INTER_CUBIC)
    picture = tile[:height]
    scale = TILE_PX / camera.width
    _horizon(picture, camera, scale)
    _ranges(picture, camera, scale)
    _arrows(picture, camera, scale)
    where, what = expectation(camera)
    if image is None:
        _write(picture, 'no picture', (TILE_PX // 2 - 40, height // 2))
    _write(tile, where, (4, height + 22), large=True)
    _write(tile, what, (4, height + 46))
    return tile


def _horizon(picture: Image8, camera: CameraCalibration, scale: float) -> None:
    azimuths = _azimuth_rad(camera) + np.radians(np.arange(-80.0, 80.1, 2.0))
    far = np.column_stack([np.cos(azimuths), np.sin(azimuths), np.zeros_like(azimuths), np.zeros_like(azimuths)])
    _polyline(picture, project(camera, far) * scale, HORIZON)


def _ranges(picture: Image8, camera: CameraCalibration, scale: float) -> None:
    azimuths = _azimuth_rad(camera) + np.radians(np.arange(-80.0, 80.1, 2.0))
    x, y = camera.base_from_camera[:2, 3]
    for reach in RANGES_M:
        ones = np.ones_like(azimuths)
        ground = np.column_stack([x + reach * np.cos(azimuths), y + reach * np.sin(azimuths), 0.0 * ones, ones])
        _polyline(picture, project(camera, ground) * scale, RANGE)


def _arrows(picture: Image8, camera: CameraCalibration, scale: float) -> None:
    columns, rows = np.meshgrid(np.linspace(0.1, 0.9, 5), np.linspace(0.65, 0.9, 2))
    pixels = np.column_stack([columns.ravel() * camera.width, rows.ravel() * camera.height])
    flow = predicted_flow(camera, pixels, Move(DRIVE_M, 0.0, 0.0))
    for start, change in zip(pixels, flow, strict=True):
        if np.isfinite(change).all() and np.linalg.norm(change) < camera.width:
            first, last = (tuple(int(v) for v in point * scale) for point in (start, start + change))
            cv2.arrowedLine(picture, first, last, ARROW, 1, cv2.LINE_AA, tipLength=0.25)


def _polyline(picture: Image8, pixels: Float64, colour: tuple[int, int, int]) -> None:
    visible = pixels[np.isfinite(pixels).all(axis=1) & (np.abs(pixels) < 1e4).all(axis=1)]
    if len(visible) > 1:
        cv2.polylines(picture, [np.round(visible).astype(np.int32)], isClosed=False, color=colour, lineType=cv2.LINE_AA)


def _write(image: Image8, text: str, place: tuple[int, int], *, large: bool = False) -> None:
    size = 0.6 if large else 0.42
    cv2.putText(image, text, place, cv2.FONT_HERSHEY_SIMPLEX, size, INK, 1, cv2.LINE_AA)
