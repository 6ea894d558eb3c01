"""The safety gate's motion limits: a pure function from a command to the limited command."""

from __future__ import annotations

import math
from dataclasses import dataclass

from raw2drive_ros.contracts.public import Control


@dataclass(frozen=True, slots=True)
class MotionLimits:
    """The vehicle's parameters first, then the limits; `math.inf` disables a limit.

    full_throttle_mps2, full_brake_mps2: of full pedals on a flat road. max_steer_rad: road wheel angle at steer 1.
    max_steer: fraction of that. max_jerk_mps3 and max_steer_rate_1ps limit the change from one command to the next.
    max_gear_speed_mps: above this speed the gear may not be changed.
    """

    wheelbase_m: float = 2.9
    max_steer_rad: float = 0.6
    full_throttle_mps2: float = 5.0
    full_brake_mps2: float = 8.0
    max_speed_mps: float = math.inf
    max_acceleration_mps2: float = math.inf
    max_deceleration_mps2: float = math.inf
    max_jerk_mps3: float = math.inf
    max_steer: float = 1.0
    max_steer_rate_1ps: float = math.inf
    max_lateral_mps2: float = math.inf
    max_gear_speed_mps: float = math.inf


def limited(
    wanted: Control, before: Control, speed_mps: float | None, dt_s: float, limits: MotionLimits
) -> tuple[Control, tuple[str, ...]]:
    """(limited command, names of the limits that changed it); `wanted` itself if none did.

    before: the previous command, sent `dt_s` ago. speed_mps: signed, None if unknown; limits that need it are then
    skipped.
    """
    wanted, gear_names = _gear(wanted, before, speed_mps, limits)
    push, pedal_names = _pedals(wanted, before, speed_mps, dt_s, limits)
    steer, steer_names = _steer(wanted.steer, before.steer, speed_mps, dt_s, limits)
    names = tuple(dict.fromkeys(gear_names + pedal_names + steer_names))
    if not names:
        return wanted, names
    if not pedal_names:
        return Control(wanted.throttle, wanted.brake, steer, wanted.reverse), names
    throttle, brake = max(push, 0.0) / limits.full_throttle_mps2, max(-push, 0.0) / limits.full_brake_mps2
    return Control(min(throttle, 1.0), min(brake, 1.0), steer, wanted.reverse), names


def _gear(
    wanted: Control, before: Control, speed_mps: float | None, limits: MotionLimits
) -> tuple[Control, tuple[str, ...]]:
    """Keep the gear, without throttle, while the car is too fast to change it and, under a jerk limit, while the
    throttle is still coming down: in the other gear it would accelerate the opposite way."""
    fast = speed_mps is not None and abs(speed_mps) > limits.max_gear_speed_mps
    pressed = _push(before, limits) > 0.0 and limits.max_jerk_mps3 < math.inf
    if wanted.reverse == before.reverse or not (fast or pressed):
        return wanted, ()
    return Control(0.0, wanted.brake, wanted.steer, before.reverse), ('gear' if fast else 'jerk',)


def _push(control: Control, limits: MotionLimits) -> float:
    """Acceleration requested by the pedals (m/s2), positive in the direction of the gear."""
    return control.throttle * limits.full_throttle_mps2 - control.brake * limits.full_brake_mps2


def _pedals(
    wanted: Control, before: Control, speed_mps: float | None, dt_s: float, limits: MotionLimits
) -> tuple[float, tuple[str, ...]]:
    push, names = _push(wanted, limits), []
    bounded = min(max(push, -limits.max_deceleration_mps2), limits.max_acceleration_mps2)
    if bounded != push:
        push = bounded
        names.append('acceleration')
    step = limits.max_jerk_mps3 * dt_s
    old = _push(before, limits)
    if abs(push - old) > step:
        push = old + math.copysign(step, push - old)
        names.append('jerk')
    # Last, because the jerk limit must not keep the throttle open on a car that is too fast.
    if speed_mps is not None and push > 0.0 and abs(speed_mps) > limits.max_speed_mps:
        push = 0.0
        names.append('speed')
    return push, tuple(names)


def _steer(
    wanted: float, before: float, speed_mps: float | None, dt_s: float, limits: MotionLimits
) -> tuple[float, tuple[str, ...]]:
    names = []
    steer = min(max(wanted, -limits.max_steer), limits.max_steer)
    if steer != wanted:
        names.append('steer')
    if speed_mps is not None:
        # Kinematic bicycle: a = v^2 tan(angle) / wheelbase. A product, since a power of an absurd speed raises.
        grip = limits.max_lateral_mps2 * limits.wheelbase_m
        allowed = math.atan2(grip, speed_mps * speed_mps) / limits.max_steer_rad
        if abs(steer) > allowed:
            steer = math.copysign(allowed, steer)
            names.append('lateral')
    step = limits.max_steer_rate_1ps * dt_s
    if abs(steer - before) > step:
        steer = before + math.copysign(step, steer - before)
        names.append('steer_rate')
    return steer, tuple(names)
