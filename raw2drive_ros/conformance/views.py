"""Where the ground goes in a picture while the car moves, if the picture is that of a given camera."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from raw2drive_ros.contracts.public import CameraCalibration, Float64

# Ground further away than this counts as infinitely far: it moves by the car's rotation only.
FAR_M = 40.0
# Focal lengths that are tried in place of the declared one, as a share of it.
LENSES = (0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 1.0, 1.12, 1.25, 1.43, 1.67, 2.0, 2.5)


@dataclass(frozen=True, slots=True)
class Move:
    """Motion of `base_link` between two pictures, in the axes of the first: metres and radians (left positive)."""

    x_m: float
    y_m: float
    yaw_rad: float

    @property
    def matrix(self) -> Float64:
        """(3, 3) for homogeneous ground points: from the axes of the first picture to those of the second."""
        cos, sin = math.cos(self.yaw_rad), math.sin(self.yaw_rad)
        turn = np.array([[cos, sin], [-sin, cos]])
        return np.vstack([np.column_stack([turn, -turn @ (self.x_m, self.y_m)]), (0.0, 0.0, 1.0)])


def other_lens(camera: CameraCalibration, factor: float) -> CameraCalibration:
    """The camera with `factor` times its focal length."""
    intrinsics = camera.intrinsics.copy()
    intrinsics[[0, 1], [0, 1]] *= factor
    return replace(camera, intrinsics=intrinsics)


def turned_round(camera: CameraCalibration) -> CameraCalibration:
    """The camera mounted upside down: half a turn about its optical axis."""
    return _reflected(camera, across=-1.0, along=-1.0)


def mirrored(camera: CameraCalibration) -> CameraCalibration:
    """The camera with left and right of its picture exchanged, as a mirror does."""
    return _reflected(camera, across=-1.0, along=1.0)


def _reflected(camera: CameraCalibration, *, across: float, along: float) -> CameraCalibration:
    intrinsics, pose = camera.intrinsics.copy(), camera.base_from_camera.copy()
    if across < 0:
        intrinsics[0, 2] = camera.width - intrinsics[0, 2]
    if along < 0:
        intrinsics[1, 2] = camera.height - intrinsics[1, 2]
    pose[:3, :3] = pose[:3, :3] @ np.diag([across, along, 1.0])
    return replace(camera, intrinsics=intrinsics, base_from_camera=pose)


def rays(camera: CameraCalibration, pixels: Float64) -> Float64:
    """(N, 3) directions in `base_link` of (N, 2) pixels; not of unit length."""
    homogeneous = np.column_stack([pixels, np.ones(len(pixels))])
    return homogeneous @ np.linalg.inv(camera.intrinsics).T @ camera.base_from_camera[:3, :3].T


def project(camera: CameraCalibration, points: Float64) -> Float64:
    """(N, 2) pixels of (N, 4) homogeneous points in `base_link` (w = 0: a direction); NaN behind the camera."""
    pose = camera.base_from_camera
    seen = (points[:, :3] - points[:, 3:] * pose[:3, 3]) @ pose[:3, :3]
    with np.errstate(divide='ignore', invalid='ignore'):
        depth = np.where(seen[:, 2:] > 1e-6, seen[:, 2:], np.nan)
        return (seen / depth @ camera.intrinsics.T)[:, :2]


def ground_plane(camera: CameraCalibration) -> Float64:
    """(3, 3) homography from the ground (x, y, 1) in `base_link` to homogeneous pixels; the third is the depth."""
    camera_from_base = np.linalg.inv(camera.base_from_camera)
    return camera.intrinsics @ camera_from_base[:3, [0, 1, 3]]


def predicted_flow(camera: CameraCalibration, pixels: Float64, move: Move) -> Float64:
    """(N, 2) by how many pixels the ground seen at (N, 2) `pixels` moves; what is above the horizon only turns.

    NaN where it leaves what the camera can see.
    """
    directions, position = rays(camera, pixels), camera.base_from_camera[:3, 3]
    falling = -directions[:, 2]
    with np.errstate(divide='ignore', invalid='ignore'):
        reach = np.where(falling > 1e-6, position[2] / falling, np.inf)
    near = reach * np.hypot(directions[:, 0], directions[:, 1]) < FAR_M
    points = np.column_stack([directions, np.zeros(len(directions))])
    points[near, :3] = position + directions[near] * reach[near, None]
    points[near, 3] = 1.0
    points[:, :2] = points[:, [0, 1, 3]] @ move.matrix[:2].T
    return project(camera, points) - pixels
