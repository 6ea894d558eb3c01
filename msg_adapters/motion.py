"""Converts pedals and steering into the requested motion, for vehicles that take speeds and angles."""

from __future__ import annotations

import math
from dataclasses import dataclass

from raw2drive_ros.contracts.public import Control

# Below this the car stands, and the sign of its measured speed is noise.
STANDING_MPS = 0.1


@dataclass(frozen=True, slots=True)
class CarFigures:
    """max_steer_rad: road wheel angle at steer 1. full_throttle_mps2, full_brake_mps2: of full pedals, positive."""

    wheelbase_m: float
    max_steer_rad: float
    full_throttle_mps2: float
    full_brake_mps2: float


@dataclass(frozen=True, slots=True)
class Motion:
    """speed_mps: target, negative in reverse. acceleration_mps2: change of that signed speed. Left is positive."""

    speed_mps: float
    acceleration_mps2: float
    wheel_angle_rad: float
    yaw_rate_radps: float


def motion_of(control: Control, speed_mps: float, car: CarFigures, horizon_s: float) -> Motion:
    """Motion of a kinematic bicycle that drives at `speed_mps` (signed) and follows `control` for `horizon_s` seconds.

    Braking never reverses the direction of travel: the target speed stops at 0. The acceleration does not, so that a
    car that follows accelerations brakes as hard as requested; on a standing car it points against the selected gear.
    """
    backwards = _backwards(control, speed_mps)
    push_mps2 = control.throttle * car.full_throttle_mps2 * (-1.0 if control.reverse else 1.0)
    drag_mps2 = control.brake * car.full_brake_mps2
    pushed_mps = speed_mps + push_mps2 * horizon_s
    left_mps = max(0.0, abs(pushed_mps) - drag_mps2 * horizon_s)
    target_mps = math.copysign(left_mps, pushed_mps) if left_mps else 0.0
    wheel_rad = control.steer * car.max_steer_rad
    return Motion(
        target_mps,
        push_mps2 + (drag_mps2 if backwards else -drag_mps2),
        wheel_rad,
        target_mps * math.tan(wheel_rad) / car.wheelbase_m,
    )


def standstill(control: Control, car: CarFigures, last_mps: float = 0.0) -> Motion:
    """Target speed 0 with the brake of `control` (full brake if it has none), for when the car's speed is unknown.

    last_mps: last known speed; it decides the sign of the braking acceleration.
    """
    brake = (control.brake or 1.0) * car.full_brake_mps2
    backwards = _backwards(control, last_mps)
    return Motion(0.0, brake if backwards else -brake, control.steer * car.max_steer_rad, 0.0)


def _backwards(control: Control, speed_mps: float) -> bool:
    return speed_mps < -STANDING_MPS or (speed_mps <= STANDING_MPS and control.reverse)
