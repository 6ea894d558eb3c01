"""Painted lines are seen where the calibration says, at every distance and in every direction of the map."""

import math
from types import SimpleNamespace

import numpy as np
import pytest

from raw2drive_ros.simulation.camera_rig import camera_rig
from raw2drive_ros.simulation.ground import LEVELS, GroundProjector, paint_ground
from raw2drive_ros.simulation.roads import Marking

REACH_M, NEAR_M = 45.0, 3.0
SUPERSAMPLING = 2


def line_from(x_m: float, y_m: float, yaw_rad: float, length_m: float) -> np.ndarray:
    along = np.arange(0.0, length_m, 1.0)[:, None]
    return np.array([x_m, y_m]) + along * np.array([math.cos(yaw_rad), math.sin(yaw_rad)])


def plain(around: list[np.ndarray], shown: list[np.ndarray], pad_m: tuple[float, float]) -> SimpleNamespace:
    """A plane of asphalt around some lines, with white lines `shown`. pad_m: moves the texture's origin."""
    points = np.concatenate(around)
    low, high = points.min(axis=0) - 8.0 - np.array(pad_m), points.max(axis=0) + 8.3
    square = np.array([low, (high[0], low[1]), high, (low[0], high[1])])
    lines = [Marking('white', line) for line in shown]
    return SimpleNamespace(sidewalks_m=[], islands_m=[], surfaces_m=[square], markings=lines)


def line_errors_m(yaw_rad: float, pad_m: tuple[float, float]) -> np.ndarray:
    """Distances (m) between a line beside the ego and where the rows of the front camera show it, up to 45 m away."""
    camera = camera_rig()[0]
    ego = np.array([13.3, -7.9])
    left_m = 1.75
    normal = np.array([-math.sin(yaw_rad), math.cos(yaw_rad)])
    start = ego + left_m * normal
    line = [line_from(*start, yaw_rad, 80.0)]
    projector = GroundProjector((camera,), SUPERSAMPLING)
    pictures = []
    for shown in (line, []):
        frames = np.zeros((1, camera.height * SUPERSAMPLING, camera.width * SUPERSAMPLING, 4), np.uint8)
        projector.draw(frames, paint_ground(plain(line, shown, pad_m)), (*ego, yaw_rad))
        pictures.append(frames[0, ..., :3].sum(axis=2, dtype=float))
    bright = np.maximum(pictures[0] - pictures[1], 0.0)
    focal = camera.intrinsics[0, 0] * SUPERSAMPLING
    middle_u, middle_v = camera.intrinsics[:2, 2] * SUPERSAMPLING
    mount = camera.base_from_camera[:3, 3]
    errors = []
    for row in range(projector.first_rows[0], len(bright)):
        away = focal * mount[2] / (row + 0.5 - middle_v)
        weight = bright[row]
        if not NEAR_M < away < REACH_M or not weight.any():
            continue
        column = (weight @ (np.arange(len(weight)) + 0.5)) / weight.sum()
        seen_left = mount[1] - (column - middle_u) * away / focal
        errors.append(seen_left - left_m)
    assert len(errors) > 50
    return np.abs(np.array(errors))


@pytest.mark.parametrize('pad_m', [(0.0, 0.0), (3.1, 5.7)])
@pytest.mark.parametrize('yaw_rad', [0.0, 0.5 * math.pi, math.pi, -0.5 * math.pi, 0.7, -2.2])
def test_painted_lines_are_seen_where_the_calibration_says(yaw_rad, pad_m) -> None:
    assert np.percentile(line_errors_m(yaw_rad, pad_m), 99) <= 0.15


def test_every_level_of_the_texture_covers_the_same_ground() -> None:
    line = [line_from(0.0, 0.0, 0.3, 61.0)]
    ground = paint_ground(plain(line, line, (0.4, 0.9)))
    first = np.array(ground.pyramid[0].shape[:2])
    assert len(ground.pyramid) == LEVELS
    for level, texture in enumerate(ground.pyramid):
        assert (np.array(texture.shape[:2]) * 2**level == first).all()
