"""Cameras, calibration, IMU, odometry and route: everything that a driver may see."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from msg_adapters.factory import MessageFactory, fill_bytes
from msg_adapters.stamps import set_stamp, stamp_ns
from raw2drive_ros.contracts.errors import ContractError
from raw2drive_ros.contracts.public import CameraCalibration, Float64, Image8, ImuSample, OdometrySample, Route

MAP_FRAME = 'map'
BASE_FRAME = 'base_link'
IMU_FRAME = 'imu_link'
CHANNELS_OF = {'rgb8': 3, 'bgr8': 3, 'rgba8': 4, 'bgra8': 4, 'mono8': 1}


def optical_frame(camera: str) -> str:
    """Frame id of a camera's optical frame (REP-103: z along the viewing direction)."""
    return f'camera_{camera}_optical'


def new_image(factory: MessageFactory, camera: str, height: int, width: int) -> Any:
    """An rgb8 Image with a preallocated buffer, which `fill_image` overwrites for every frame."""
    message = factory.new('sensor_msgs/msg/Image')
    message.header.frame_id = optical_frame(camera)
    message.height, message.width = height, width
    message.encoding, message.is_bigendian, message.step = 'rgb8', 0, width * 3
    message.data = factory.byte_buffer(height * width * 3)
    return message


def fill_image(message: Any, image: Image8, time_ns: int) -> None:
    """Write (H, W, 3) RGB pixels and a stamp into a message of `new_image`, in place. Raises ContractError."""
    if image.shape != (message.height, message.width, 3) or image.dtype != np.uint8:
        raise ContractError(f'fill_image: {image.dtype} {image.shape} into {message.height}x{message.width} rgb8')
    set_stamp(message.header.stamp, time_ns)
    fill_bytes(message.data, image)


def image_from_message(message: Any) -> Image8:
    """(H, W, 3) uint8 RGB; a view of the message's buffer where the encoding is rgb8 without padding.

    Raises ContractError for an unknown encoding or a buffer of the wrong size.
    """
    channels = CHANNELS_OF.get(message.encoding)
    if channels is None:
        raise ContractError(
            f'image encoding {message.encoding!r} is not supported; use one of {", ".join(CHANNELS_OF)}'
        )
    height, width, step = int(message.height), int(message.width), int(message.step)
    pixels = np.frombuffer(message.data, np.uint8)
    if height <= 0 or width <= 0 or step < width * channels or pixels.size != step * height:
        raise ContractError(
            f'image of {height}x{width} {message.encoding}: step {step}, {pixels.size} bytes do not fit'
        )
    image: NDArray[np.uint8] = pixels.reshape(height, step)[:, : width * channels]
    image = image.reshape(height, width, channels)
    if message.encoding in ('bgr8', 'bgra8'):
        return image[..., 2::-1] if channels == 3 else image[..., [2, 1, 0]]
    if channels == 1:
        return np.repeat(image, 3, axis=2)
    return image[..., :3]


def camera_info_to_message(factory: MessageFactory, camera: CameraCalibration, time_ns: int) -> Any:
    """Undistorted pinhole: plumb_bob, D zero, R identity, P = [K | 0]."""
    message = factory.new('sensor_msgs/msg/CameraInfo')
    set_stamp(message.header.stamp, time_ns)
    message.header.frame_id = optical_frame(camera.name)
    message.height, message.width = camera.height, camera.width
    message.distortion_model = 'plumb_bob'
    message.d = np.zeros(5)
    message.k = np.array(camera.intrinsics, np.float64).reshape(9)
    message.r = np.eye(3).reshape(9)
    message.p = np.hstack([camera.intrinsics, np.zeros((3, 1))]).reshape(12)
    return message


def calibration_from_messages(name: str, info: Any, extrinsics: Any) -> CameraCalibration:
    """CameraInfo and the camera's TransformStamped (parent `base_link`). Raises ContractError if unusable."""
    intrinsics = np.asarray(info.k, np.float64).reshape(3, 3)
    if intrinsics[0, 0] == 0.0:
        raise ContractError(f'camera {name} is uncalibrated (K[0] is 0)')
    if np.any(np.asarray(info.d, np.float64) != 0.0):
        raise ContractError(f'camera {name} has lens distortion; rectify its images first')
    return CameraCalibration(
        name, int(info.width), int(info.height), intrinsics, transform_from_message(extrinsics)
    ).validate()


def transform_to_message(factory: MessageFactory, matrix: Float64, parent: str, child: str, time_ns: int) -> Any:
    """(4, 4) pose of `child` in `parent` as TransformStamped."""
    message = factory.new('geometry_msgs/msg/TransformStamped')
    set_stamp(message.header.stamp, time_ns)
    message.header.frame_id, message.child_frame_id = parent, child
    move, turn = message.transform.translation, message.transform.rotation
    move.x, move.y, move.z = (float(v) for v in matrix[:3, 3])
    turn.x, turn.y, turn.z, turn.w = quaternion_from_matrix(matrix[:3, :3])
    return message


def transform_from_message(message: Any) -> Float64:
    """(4, 4) pose of the child frame in the parent frame. Raises ContractError for a bad quaternion."""
    move, turn = message.transform.translation, message.transform.rotation
    matrix = np.eye(4)
    matrix[:3, :3] = matrix_from_quaternion(turn.x, turn.y, turn.z, turn.w)
    matrix[:3, 3] = (move.x, move.y, move.z)
    return matrix


def imu_to_message(factory: MessageFactory, sample: ImuSample) -> Any:
    """Imu without orientation (its covariance[0] is -1: "this quantity is absent")."""
    message = factory.new('sensor_msgs/msg/Imu')
    set_stamp(message.header.stamp, sample.stamp_ns)
    message.header.frame_id = IMU_FRAME
    force, rate = message.linear_acceleration, message.angular_velocity
    force.x, force.y, force.z = (float(v) for v in sample.specific_force_mps2)
    rate.x, rate.y, rate.z = (float(v) for v in sample.angular_velocity_radps)
    message.orientation_covariance = np.array([-1.0] + [0.0] * 8)
    message.linear_acceleration_covariance = np.diag([1e-4] * 3).reshape(9)
    message.angular_velocity_covariance = np.diag([1e-6] * 3).reshape(9)
    return message


def imu_from_message(message: Any) -> ImuSample:
    """Raises ContractError for NaN."""
    force, rate = message.linear_acceleration, message.angular_velocity
    return ImuSample(
        stamp_ns(message.header.stamp),
        (float(force.x), float(force.y), float(force.z)),
        (float(rate.x), float(rate.y), float(rate.z)),
    ).validate()


def odometry_to_message(factory: MessageFactory, sample: OdometrySample) -> Any:
    """Odometry: pose in `map`, twist in `base_link`."""
    message = factory.new('nav_msgs/msg/Odometry')
    set_stamp(message.header.stamp, sample.stamp_ns)
    message.header.frame_id, message.child_frame_id = MAP_FRAME, BASE_FRAME
    pose, twist = message.pose.pose, message.twist.twist
    pose.position.x, pose.position.y = float(sample.x_m), float(sample.y_m)
    pose.orientation.z = math.sin(sample.yaw_rad / 2)
    pose.orientation.w = math.cos(sample.yaw_rad / 2)
    twist.linear.x, twist.angular.z = float(sample.speed_mps), float(sample.yaw_rate_radps)
    message.pose.covariance = np.diag([1e-4] * 6).reshape(36)
    message.twist.covariance = np.diag([1e-4] * 6).reshape(36)
    return message


def odometry_from_message(message: Any) -> OdometrySample:
    """Raises ContractError for NaN or a zero quaternion."""
    pose, twist = message.pose.pose, message.twist.twist
    turn = pose.orientation
    # Products overflow to infinity; powers would raise OverflowError.
    norm = turn.x * turn.x + turn.y * turn.y + turn.z * turn.z + turn.w * turn.w
    if not abs(norm - 1.0) < 1e-2:
        raise ContractError(f'odometry orientation is not a unit quaternion (squared norm {norm})')
    yaw = math.atan2(2.0 * (turn.w * turn.z + turn.x * turn.y), 1.0 - 2.0 * (turn.y * turn.y + turn.z * turn.z))
    return OdometrySample(
        stamp_ns(message.header.stamp),
        float(pose.position.x),
        float(pose.position.y),
        yaw,
        float(twist.linear.x),
        float(twist.angular.z),
    ).validate()


def route_to_message(factory: MessageFactory, route: Route) -> Any:
    """Path of sparse checkpoints in `map`; orientations point along the route."""
    message = factory.new('nav_msgs/msg/Path')
    set_stamp(message.header.stamp, route.stamp_ns)
    message.header.frame_id = MAP_FRAME
    points = route.checkpoints_m
    headings = np.arctan2(*np.gradient(points, axis=0).T[::-1])
    poses = []
    for (x, y), yaw in zip(points, headings, strict=True):
        pose = factory.new('geometry_msgs/msg/PoseStamped')
        set_stamp(pose.header.stamp, route.stamp_ns)
        pose.header.frame_id = MAP_FRAME
        pose.pose.position.x, pose.pose.position.y = float(x), float(y)
        pose.pose.orientation.z, pose.pose.orientation.w = math.sin(yaw / 2), math.cos(yaw / 2)
        poses.append(pose)
    message.poses = poses
    return message


def route_from_message(message: Any) -> Route:
    """Raises ContractError for fewer than two points or NaN."""
    points = np.array([(p.pose.position.x, p.pose.position.y) for p in message.poses], np.float64).reshape(-1, 2)
    return Route(stamp_ns(message.header.stamp), points).validate()


def quaternion_from_matrix(rotation: Float64) -> tuple[float, float, float, float]:
    """(x, y, z, w) with w >= 0, by the largest diagonal term (stable for every rotation)."""
    m = rotation
    squares = np.array(
        [
            1 + m[0, 0] - m[1, 1] - m[2, 2],
            1 - m[0, 0] + m[1, 1] - m[2, 2],
            1 - m[0, 0] - m[1, 1] + m[2, 2],
            1 + m[0, 0] + m[1, 1] + m[2, 2],
        ]
    )
    largest = int(np.argmax(squares))
    scale = math.sqrt(squares[largest]) * 2
    x, y, z = m[2, 1] - m[1, 2], m[0, 2] - m[2, 0], m[1, 0] - m[0, 1]
    xy, xz, yz = m[1, 0] + m[0, 1], m[0, 2] + m[2, 0], m[2, 1] + m[1, 2]
    own = scale / 4
    parts = {
        0: (own, xy / scale, xz / scale, x / scale),
        1: (xy / scale, own, yz / scale, y / scale),
        2: (xz / scale, yz / scale, own, z / scale),
        3: (x / scale, y / scale, z / scale, own),
    }[largest]
    sign = -1.0 if parts[3] < 0 else 1.0
    return (float(sign * parts[0]), float(sign * parts[1]), float(sign * parts[2]), float(sign * parts[3]))


def matrix_from_quaternion(x: float, y: float, z: float, w: float) -> Float64:
    """(3, 3) rotation. Raises ContractError unless the quaternion is of unit length within 1 %."""
    norm = math.sqrt(x * x + y * y + z * z + w * w)
    if not abs(norm - 1.0) < 1e-2:
        raise ContractError(f'quaternion of length {norm}')
    x, y, z, w = x / norm, y / norm, z / norm, w / norm
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )
