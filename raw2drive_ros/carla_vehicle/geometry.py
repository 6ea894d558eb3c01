"""Conversions between CARLA's coordinate systems and REP-103.

CARLA is left-handed: x forward, y RIGHT, z up, metres and degrees; steering, yaw and the yaw rate are positive to the
right, pitch with the nose up. Ours are right-handed (REP-103): y and yaw to the left, pitch with the nose down.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from raw2drive_ros.contracts.errors import ContractError
from raw2drive_ros.contracts.public import Control, Float64, Image8, ImuSample, OdometrySample

# Reflection of y. A pose in one system is MIRROR @ pose @ MIRROR in the other.
MIRROR = np.diag([1.0, -1.0, 1.0, 1.0])
# Columns: right, down and forward of a camera that looks along x.
_OPTICAL = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])


def pose_from_carla(matrix: Any) -> Float64:
    """(4, 4) pose in REP-103 axes from `carla.Transform.get_matrix()`."""
    return MIRROR @ np.asarray(matrix, np.float64).reshape(4, 4) @ MIRROR


def placement(pose: Float64) -> tuple[tuple[float, float, float], tuple[float, float, float]]:
    """Arguments of `carla.Location` (x, y, z in m) and `carla.Rotation` (pitch, yaw, roll in degrees) for a (4, 4) pose
    in REP-103 axes."""
    x, y, z = pose[:3, 3]
    turn = pose[:3, :3]
    pitch = math.asin(max(-1.0, min(1.0, turn[2, 0])))
    yaw, roll = -math.atan2(turn[1, 0], turn[0, 0]), math.atan2(turn[2, 1], turn[2, 2])
    return (float(x), float(-y), float(z)), (math.degrees(pitch), math.degrees(yaw), math.degrees(roll))


def camera_placement(
    base_from_camera: Float64,
) -> tuple[tuple[float, float, float], tuple[float, float, float]]:
    """`placement` of a camera from the pose of its optical frame: CARLA's cameras look along x."""
    body = base_from_camera.copy()
    body[:3, :3] = body[:3, :3] @ _OPTICAL.T
    return placement(body)


def fov_deg(intrinsics: Float64, width: int, height: int) -> float:
    """Horizontal field of view. Raises ContractError for fx != fy or an off-centre principal point (not in CARLA)."""
    focal = float(intrinsics[0, 0])
    centre = abs(intrinsics[0, 2] - width / 2.0) < 1.0 and abs(intrinsics[1, 2] - height / 2.0) < 1.0
    if abs(intrinsics[1, 1] / focal - 1.0) > 1e-3 or not centre:
        raise ContractError('CARLA has cameras with square pixels and the principal point in the middle only')
    return math.degrees(2.0 * math.atan2(width / 2.0, focal))


def image_from_carla(raw_data: Any, width: int, height: int) -> Image8:
    """(H, W, 3) RGB from the bytes of a `carla.Image` (BGRA). Raises ContractError for another size."""
    pixels = np.frombuffer(raw_data, np.uint8)
    if pixels.size != width * height * 4:
        raise ContractError(f'CARLA image of {pixels.size} bytes is not {width} x {height} BGRA')
    return np.ascontiguousarray(pixels.reshape(height, width, 4)[..., 2::-1])


def imu_from_carla(stamp_ns: int, accelerometer: Any, gyroscope: Any) -> ImuSample:
    """IMU sample from the vectors of a `carla.IMUMeasurement` (m/s2 with gravity, rad/s).

    An angular rate is an axial vector: the reflection of y changes the signs of x and z.
    """
    force = (float(accelerometer.x), float(-accelerometer.y), float(accelerometer.z))
    rate = (float(-gyroscope.x), float(gyroscope.y), float(-gyroscope.z))
    return ImuSample(stamp_ns, force, rate).validate()


def odometry_from_carla(stamp_ns: int, matrix: Any, velocity: Any, angular_velocity: Any) -> OdometrySample:
    """Odometry from an actor's matrix, its velocity (m/s, world) and its angular velocity (deg/s, world)."""
    pose = pose_from_carla(matrix)
    forward = pose[:3, 0]
    speed = forward @ (velocity.x, -velocity.y, velocity.z)
    yaw = math.atan2(pose[1, 0], pose[0, 0])
    rate = -math.radians(angular_velocity.z)
    return OdometrySample(stamp_ns, float(pose[0, 3]), float(pose[1, 3]), yaw, float(speed), rate).validate()


def control_values(control: Control) -> dict[str, float | bool]:
    """Keyword arguments of `carla.VehicleControl`, whose steering is positive to the right."""
    control.validate()
    return {
        'throttle': control.throttle,
        'steer': 0.0 - control.steer,
        'brake': control.brake,
        'reverse': control.reverse,
        'hand_brake': False,
    }
