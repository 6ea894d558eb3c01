"""Types that are passed between packages, with their shapes, units, frames and `validate()`.

Frames follow REP-103 and REP-105: `map` and `base_link` are right-handed, x forward (or east),
y left, z up; yaw is counter-clockwise positive; units are SI. Cameras use optical frames
(z forward, x right, y down). Nothing here is privileged: see `contracts.privileged`.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from raw2drive_ros.contracts.errors import ContractError

Float64 = NDArray[np.float64]
Image8 = NDArray[np.uint8]
# No sensor of a car measures more, and nothing below loses its meaning, or becomes infinite, as float32: force
# (m/s2), rates (rad/s) and speed (m/s); distances in `map` (m), which may be UTM coordinates.
LARGEST_MOTION = 1e6
LARGEST_DISTANCE_M = 1e8


def _require(message: str, *, holds: bool) -> None:
    if not holds:
        raise ContractError(message)


def _finite(name: str, *values: float) -> None:
    _require(f'{name}: not finite: {values}', holds=bool(np.all(np.isfinite(values))))


def _within(name: str, limit: float, *values: float) -> None:
    _finite(name, *values)
    _require(f'{name}: absurd: {values}', holds=all(abs(value) <= limit for value in values))


@dataclass(frozen=True, slots=True)
class Control:
    """One actuation request.

    throttle, brake: [0, 1]. steer: [-1, 1], positive turns LEFT (REP-103), as a fraction of the
    vehicle's largest steering angle. reverse: throttle drives backwards.
    """

    throttle: float = 0.0
    brake: float = 0.0
    steer: float = 0.0
    reverse: bool = False

    def validate(self) -> Control:
        _finite('Control', self.throttle, self.brake, self.steer)
        _require(f'Control.throttle {self.throttle} outside [0, 1]', holds=0.0 <= self.throttle <= 1.0)
        _require(f'Control.brake {self.brake} outside [0, 1]', holds=0.0 <= self.brake <= 1.0)
        _require(f'Control.steer {self.steer} outside [-1, 1]', holds=-1.0 <= self.steer <= 1.0)
        return self


@dataclass(frozen=True, slots=True)
class ImuSample:
    """One IMU reading (REP-145) in the IMU's frame, whose axes are parallel to `base_link`.

    specific_force_mps2: (3,) accelerometer reading, +9.81 on z at rest. angular_velocity_radps: (3,).
    """

    stamp_ns: int
    specific_force_mps2: tuple[float, float, float]
    angular_velocity_radps: tuple[float, float, float]

    def validate(self) -> ImuSample:
        _within('ImuSample', LARGEST_MOTION, *self.specific_force_mps2, *self.angular_velocity_radps)
        return self


@dataclass(frozen=True, slots=True)
class OdometrySample:
    """Pose of `base_link` in `map` and its twist in `base_link`."""

    stamp_ns: int
    x_m: float
    y_m: float
    yaw_rad: float
    speed_mps: float
    yaw_rate_radps: float

    def validate(self) -> OdometrySample:
        _within('OdometrySample: pose', LARGEST_DISTANCE_M, self.x_m, self.y_m, self.yaw_rad)
        _within('OdometrySample: twist', LARGEST_MOTION, self.speed_mps, self.yaw_rate_radps)
        return self


@dataclass(frozen=True, slots=True)
class Route:
    """Sparse route checkpoints in `map`.

    stamp_ns: time at which the route was issued; a new stamp means a new route.
    checkpoints_m: (N, 2) float64, N >= 2, from the start to the goal, some tens of metres apart.
    """

    stamp_ns: int
    checkpoints_m: Float64

    def validate(self) -> Route:
        points = self.checkpoints_m
        _require(f'Route: shape {points.shape}', holds=points.ndim == 2 and points.shape[1] == 2)
        _require('Route: needs at least two checkpoints', holds=len(points) >= 2)
        _require('Route: not finite', holds=bool(np.isfinite(points).all()))
        _require(f'Route: absurd: {points.min()} to {points.max()} m', holds=np.abs(points).max() <= LARGEST_DISTANCE_M)
        return self


@dataclass(frozen=True, slots=True)
class CameraCalibration:
    """Pinhole calibration of one camera.

    intrinsics: (3, 3) pixels. base_from_camera: (4, 4), pose of the OPTICAL frame in `base_link`.
    """

    name: str
    width: int
    height: int
    intrinsics: Float64
    base_from_camera: Float64

    def validate(self) -> CameraCalibration:
        _require(f'{self.name}: empty image', holds=self.width > 0 and self.height > 0)
        _require(f'{self.name}: intrinsics {self.intrinsics.shape}', holds=self.intrinsics.shape == (3, 3))
        _require(f'{self.name}: extrinsics shape', holds=self.base_from_camera.shape == (4, 4))
        _require(f'{self.name}: intrinsics not finite', holds=bool(np.isfinite(self.intrinsics).all()))
        _require(f'{self.name}: extrinsics not finite', holds=bool(np.isfinite(self.base_from_camera).all()))
        _require(f'{self.name}: focal length', holds=self.intrinsics[0, 0] > 0 and self.intrinsics[1, 1] > 0)
        return self

    def equals(self, other: CameraCalibration) -> bool:
        """Whether both calibrations are bitwise identical."""
        return (
            (self.name, self.width, self.height) == (other.name, other.width, other.height)
            and np.array_equal(self.intrinsics, other.intrinsics)
            and np.array_equal(self.base_from_camera, other.base_from_camera)
        )


def check_image(image: Image8, calibration: CameraCalibration | None = None) -> Image8:
    """The same picture. Raises ContractError unless it is (H, W, 3) uint8, of the calibration's size where that is
    known: with another size its pixels are not where the calibration says."""
    _require(
        f'image: {image.dtype} {image.shape}, not uint8 (H, W, 3)',
        holds=image.dtype == np.uint8 and image.ndim == 3 and image.shape[2] == 3 and image.size > 0,
    )
    if calibration is not None:
        size = calibration.height, calibration.width
        _require(
            f'image: {image.shape[0]}x{image.shape[1]}, and its camera_info says {size[0]}x{size[1]}',
            holds=image.shape[:2] == size,
        )
    return image


@dataclass(frozen=True, slots=True)
class SensorFrame:
    """Everything the raw-sensor driver may see of one decision tick; all stamps equal `stamp_ns`.

    images: camera name -> (H, W, 3) uint8 RGB. imu: newest reading. odometry: newest sample.
    """

    stamp_ns: int
    images: dict[str, Image8]
    imu: ImuSample
    odometry: OdometrySample

    def validate(self) -> SensorFrame:
        _require('SensorFrame: no images', holds=bool(self.images))
        for image in self.images.values():
            check_image(image)
        self.imu.validate()
        self.odometry.validate()
        return self


@dataclass(frozen=True, slots=True)
class Decision:
    """A driver's output for one frame.

    stamp_ns: stamp of that frame. action: index in the action table, or -1 where the driver chose no entry of it.
    sequence: number of the message within the process that sent it, 1, 2, 3 ...; 0: not sent yet, or not numbered.
    info: extras of the driver, such as the action's probability.
    """

    stamp_ns: int
    control: Control
    action: int = -1
    inference_ms: float = 0.0
    sequence: int = 0
    info: dict[str, Any] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class VehicleStatus:
    """What the vehicle's end of `/control/command` reports to the safety gate.

    speed_mps: signed speed along x of `base_link`; None where this end does not measure it. stopped: it brakes by
    itself and obeys no command until one arrives whose `activation` is newer. activation: the newest that it has heard,
    0 before the first. placed: rises whenever a simulation puts the car somewhere else, 0 for a vehicle. ticks:
    decision periods since then. sequence: see `Decision`.
    """

    stamp_ns: int
    speed_mps: float | None
    stopped: bool = False
    activation: int = 0
    placed: int = 0
    ticks: int = 0
    sequence: int = 0

    def validate(self) -> VehicleStatus:
        if self.speed_mps is not None:
            _finite('VehicleStatus.speed_mps', self.speed_mps)
        counts = (self.activation, self.placed, self.ticks, self.sequence)
        _require(f'VehicleStatus: negative count: {counts}', holds=min(counts) >= 0)
        return self
