"""Odometry against itself and against the IMU while the car drives: three witnesses of the same motion.

The pose says how the car has moved and turned. Its twist must be that motion in `base_link`, and the gyroscope must
turn as the heading does. Where twist and gyroscope agree against the heading, it is the heading that is wrong.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from raw2drive_ros.conformance.observation import Observation, Verdict
from raw2drive_ros.contracts.public import Float64

TWIST, YAW_RATE, HEADING = 'odometry: twist', 'odometry: yaw rate', 'odometry: heading'
GYRO, FORWARD = 'imu: yaw rate', 'imu: forward acceleration'
NOT_MOVED = 'give --allow-motion, or check while the car drives'
# Samples further apart than this are no step of a motion.
GAP_S = 0.25
LEAST_SAMPLES = 8
MOVES_MPS, TURNS_RADPS = 0.5, 0.03
# Below this heading `map` and `base_link` point the same way, as far as a twist can tell.
TURNED_RAD = 0.05
# A twist may differ from the change of position by this share of the speed.
GOOD_SHARE = 0.15
GOOD_GAIN = (0.75, 1.3)
UNITS = {3.6: 'km/h, not m/s', 2.237: 'miles per hour, not m/s', -1.0: 'with the wrong sign: forward is positive'}
TURNS = {
    -1.0: 'with the wrong sign: to the left is positive',
    180.0 / math.pi: 'in degrees per second, not rad/s',
    -180.0 / math.pi: 'in degrees per second and with the wrong sign',
    0.0: 'not at all: is it the z axis?',
}


@dataclass(frozen=True, slots=True)
class Steps:
    """What lies between neighbouring samples of odometry, all (N,): times_ns (middle), yaw_rad (middle), heading_radps
    and the velocity (N, 2) in `map` from the pose; forward_mps, lateral_mps, yaw_rate_radps from the twist."""

    times_ns: Float64
    yaw_rad: Float64
    heading_radps: Float64
    velocity_mps: Float64
    forward_mps: Float64
    lateral_mps: Float64
    yaw_rate_radps: Float64

    @property
    def speed_mps(self) -> Float64:
        return np.hypot(self.velocity_mps[:, 0], self.velocity_mps[:, 1])

    def at(self, chosen: Float64) -> Steps:
        return Steps(*(getattr(self, name)[chosen] for name in self.__slots__))


def steps_of(seen: Observation) -> Steps:
    """The steps of the whole recording, without gaps and repeated stamps."""
    rows = [
        (s.stamp_ns, s.x_m, s.y_m, s.yaw_rad, s.speed_mps, s.yaw_rate_radps, lateral)
        for s, lateral in zip(seen.odometry, seen.lateral_mps or [0.0] * len(seen.odometry), strict=True)
    ]
    data = np.array(rows, np.float64).reshape(-1, 7)
    data[:, 3] = np.unwrap(data[:, 3])
    if len(data) < 2:
        return Steps(*(np.zeros((0, 2)) if name == 'velocity_mps' else np.zeros(0) for name in Steps.__slots__))
    dt = np.diff(data[:, 0]) * 1e-9
    good = (dt > 1e-4) & (dt < GAP_S)
    before, after, dt = data[:-1][good], data[1:][good], dt[good]
    middle, change = (before + after) / 2.0, (after - before) / dt[:, None]
    return Steps(middle[:, 0], middle[:, 3], change[:, 3], change[:, 1:3], middle[:, 4], middle[:, 6], middle[:, 5])


def judge_odometry(seen: Observation) -> list[Verdict]:
    """Twist, heading, gyroscope and accelerometer against the change of the pose, from the whole recording."""
    steps = steps_of(seen)
    moving = steps.at(steps.speed_mps > MOVES_MPS)
    found = [*_twist(moving), *_turning(seen, steps)]
    if not any(v.severity == 'error' for v in found if v.check == TWIST):
        found += _forward(seen, moving)
    return found


def _twist(moving: Steps) -> Iterator[Verdict]:
    if len(moving.speed_mps) < LEAST_SAMPLES:
        yield Verdict(TWIST, 'skipped', 'the car does not move', NOT_MOVED)
        return
    cos, sin = np.cos(moving.yaw_rad), np.sin(moving.yaw_rad)
    x, y = moving.velocity_mps.T
    forward, left = x * cos + y * sin, y * cos - x * sin
    fast = float(np.median(moving.speed_mps))
    ahead = np.abs(forward) > MOVES_MPS / 2.0
    gain = _gain(moving.forward_mps[ahead], forward[ahead]) if ahead.any() else 0.0
    # Many vehicles leave the lateral part at zero, which says nothing about its axes.
    has_lateral = float(np.abs(moving.lateral_mps).max()) > 0.02
    part = moving.lateral_mps if has_lateral else np.zeros_like(x)

    def miss(along: Float64, across: Float64) -> float:
        aside = part - across if has_lateral else 0.0 * across
        chosen = np.abs(sin) > TURNED_RAD
        chosen = chosen if chosen.sum() >= LEAST_SAMPLES else np.ones_like(chosen)
        return float(np.median(np.hypot(moving.forward_mps - along, aside)[chosen])) / fast

    in_base, in_map = miss(forward, left), miss(x, y)
    text = f'{100 * in_base:.0f} % of the speed away from the change of position in base_link'
    if in_base > 0.03 and in_map < 0.5 * in_base and in_map < GOOD_SHARE:
        text += f', {100 * in_map:.0f} % in map'
        fix = 'the twist is in the axes of map: turn it by minus the heading into base_link (child_frame_id)'
        yield Verdict(TWIST, 'error', text, fix)
    elif abs(gain - 1.0) < GOOD_SHARE and miss(forward, part) < GOOD_SHARE:
        yield Verdict(TWIST, 'passed', text)
    else:
        near = next((what for k, what in UNITS.items() if abs(gain / k - 1.0) < 0.12), '')
        fix = f'the speed is {near}' if near else 'pose and twist must describe one motion, in m, rad and seconds'
        yield Verdict(TWIST, 'error', f'the speed is {gain:.2f} times the change of position', fix)


def _turning(seen: Observation, steps: Steps) -> Iterator[Verdict]:
    turning = steps.at(np.abs(steps.heading_radps) > TURNS_RADPS)
    if len(turning.times_ns) < LEAST_SAMPLES:
        for check in (YAW_RATE, GYRO):
            yield Verdict(check, 'skipped', 'the heading does not change', NOT_MOVED)
        return
    heading = turning.heading_radps
    own = _gain(turning.yaw_rate_radps, heading)
    gyro = _gain(_imu(seen, turning.times_ns, 2), heading) if seen.imu else None
    if gyro is not None and not _good(own) and not _good(gyro) and abs(own / gyro - 1.0) < 0.2 and abs(own) > 0.2:
        text = f'twist and gyroscope both turn {own:.2f} times as fast as the heading'
        fix = 'the heading of the pose is wrong: radians, positive to the left, a unit quaternion about z'
        yield Verdict(HEADING, 'error', text, fix)
        return
    for check, gain in ((YAW_RATE, own), (GYRO, gyro)):
        if gain is None:
            continue
        text = f'{gain:+.2f} times the change of heading'
        if _good(gain):
            yield Verdict(check, 'passed', text)
            continue
        near = [what for k, what in TURNS.items() if abs(gain - k) < max(0.2, 0.2 * abs(k))]
        fix = near[0] if near else 'not as the heading does: rad/s about z (up), positive to the left'
        yield Verdict(check, 'error', text, f'it turns {fix}')


def _forward(seen: Observation, moving: Steps) -> Iterator[Verdict]:
    """The accelerometer's x against the change of speed: which way does the IMU look?"""
    change = np.diff(moving.forward_mps) / np.maximum(np.diff(moving.times_ns) * 1e-9, 1e-3)
    near = np.diff(moving.times_ns) < GAP_S * 1e9
    if len(seen.imu) < LEAST_SAMPLES or near.sum() < 2 * LEAST_SAMPLES or float(np.std(change[near])) < 0.3:
        yield Verdict(FORWARD, 'skipped', 'the speed does not change enough', NOT_MOVED)
        return
    times = ((moving.times_ns[1:] + moving.times_ns[:-1]) / 2.0)[near]
    asked = change[near] - np.mean(change[near])
    gains, fits = [], []
    for axis in (0, 1):
        force = _imu(seen, times, axis, force=True)
        force = force - np.mean(force)
        gains.append(float(force @ asked / (asked @ asked)))
        fits.append(abs(float(force @ asked)) / max(float(np.linalg.norm(force) * np.linalg.norm(asked)), 1e-9))
    text = f'x reads {gains[0]:+.2f}, y {gains[1]:+.2f} times the change of speed'
    if gains[0] > 0.5 and fits[0] > 0.5:
        yield Verdict(FORWARD, 'passed', text)
    elif gains[0] < -0.5 and fits[0] > 0.5:
        yield Verdict(FORWARD, 'error', text, 'the IMU looks backwards: turn its axes, x forward (base_link)')
    elif abs(gains[1]) > 0.5 and fits[1] > 0.5 and abs(gains[0]) < 0.5:
        yield Verdict(FORWARD, 'error', text, 'the IMU looks sideways: turn its axes, x forward (base_link)')
    else:
        yield Verdict(FORWARD, 'skipped', f'cannot tell: {text}', 'compare the accelerometer by hand')


def _imu(seen: Observation, times_ns: Float64, axis: int, *, force: bool = False) -> Float64:
    """An axis of gyroscope or accelerometer at these times."""
    stamps = np.array([sample.stamp_ns for sample in seen.imu], np.float64)
    values = [s.specific_force_mps2 if force else s.angular_velocity_radps for s in seen.imu]
    order = np.argsort(stamps, kind='stable')
    return np.interp(times_ns, stamps[order], np.array(values)[order, axis])


def _gain(found: Float64, true: Float64) -> float:
    """How many times `true` fits into `found`; the median, so that a few bad samples do not count."""
    return float(np.median(found / true))


def _good(gain: float) -> bool:
    return GOOD_GAIN[0] < gain < GOOD_GAIN[1]
