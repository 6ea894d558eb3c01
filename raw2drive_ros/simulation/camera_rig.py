"""The rig of six cameras: Bench2Drive's mounting poses, in REP-103 axes."""

from __future__ import annotations

import math
from dataclasses import replace

import cv2
import numpy as np

from raw2drive_ros.contracts.public import CameraCalibration, Float64

# name: (x m, y m, z m, yaw deg, horizontal field of view deg) in base_link; y and yaw positive to the left.
MOUNTS = {
    'front': (0.80, 0.0, 1.60, 0.0, 70.0),
    'front_left': (0.27, 0.55, 1.60, 55.0, 70.0),
    'front_right': (0.27, -0.55, 1.60, -55.0, 70.0),
    'back': (-2.0, 0.0, 1.60, 180.0, 110.0),
    'back_left': (-0.32, 0.55, 1.60, 110.0, 70.0),
    'back_right': (-0.32, -0.55, 1.60, -110.0, 70.0),
}
CAMERA_NAMES = tuple(MOUNTS)
SIZES = {'96x160': (96, 160), '224x400': (224, 400), '64x96': (64, 96)}

# Columns: optical x (right), y (down), z (forward) in a body-aligned camera (REP-103 suffix `_optical`).
OPTICAL = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])


def camera_rig(height: int = 96, width: int = 160) -> tuple[CameraCalibration, ...]:
    """Calibrations of the six cameras, in the order of `CAMERA_NAMES`."""
    cameras = []
    for name, (x, y, z, yaw_deg, fov_deg) in MOUNTS.items():
        focal = width / 2.0 / math.tan(math.radians(fov_deg) / 2.0)
        intrinsics = np.array([[focal, 0.0, width / 2.0], [0.0, focal, height / 2.0], [0.0, 0.0, 1.0]])
        base_from_camera = np.eye(4)
        base_from_camera[:3, :3] = yaw_matrix(math.radians(yaw_deg)) @ OPTICAL
        base_from_camera[:3, 3] = (x, y, z)
        cameras.append(CameraCalibration(name, width, height, intrinsics, base_from_camera).validate())
    return tuple(cameras)


def yaw_matrix(yaw_rad: float) -> Float64:
    """(3, 3) rotation about z."""
    cos, sin = math.cos(yaw_rad), math.sin(yaw_rad)
    return np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])


def moved(
    camera: CameraCalibration, turn_rad: tuple[float, float, float], shift_m: tuple[float, float, float]
) -> CameraCalibration:
    """The camera rotated about its own centre by a rotation vector, then shifted; both in the axes of `base_link`."""
    base_from_camera = camera.base_from_camera.copy()
    base_from_camera[:3, :3] = cv2.Rodrigues(np.array(turn_rad))[0] @ base_from_camera[:3, :3]
    base_from_camera[:3, 3] += shift_m
    return replace(camera, base_from_camera=base_from_camera)
