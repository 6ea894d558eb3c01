"""Comfort of a drive: the share of segments of 20 samples (2 s at 10 Hz) that keep six limits, which are Bench2Drive's.

Bench2Drive's tool has mistakes that lower every score, which `bench2drive_compat=True` reproduces: derivatives with a
step of 0.1 s on 20 Hz data, whose segments last 1 s, the smoothed yaw rate in place of the yaw acceleration, and yaw
rates in deg/s compared with limits in rad/s.
"""

from __future__ import annotations

import math
from functools import cache

import numpy as np

from raw2drive_ros.contracts.public import Float64
from raw2drive_ros.tables.rates import DECISION_HZ, SUBSTEPS

SEGMENT = 20
WINDOW, ORDER = 7, 2
STEP_S = 1.0 / DECISION_HZ
LONGITUDINAL_MPS2 = (-4.05, 2.40)
LATERAL_MPS2 = 4.89
JERK_MPS3 = 8.37
LONGITUDINAL_JERK_MPS3 = 4.13
YAW_ACCELERATION_RADPS2 = 1.93
YAW_RATE_RADPS = 0.95


@cache
def savitzky_golay(derivative: int) -> Float64:
    """(SEGMENT, SEGMENT) matrix that smooths a segment, or differentiates it once per sample: at each sample, a
    parabola fitted to the 7 samples around it (to the first or last 7 at the ends)."""
    matrix = np.zeros((SEGMENT, SEGMENT))
    for i in range(SEGMENT):
        first = min(max(i - WINDOW // 2, 0), SEGMENT - WINDOW)
        offsets = np.arange(first, first + WINDOW) - i
        fit = np.linalg.pinv(np.vander(offsets.astype(float), ORDER + 1, increasing=True))
        matrix[i, first : first + WINDOW] = fit[derivative] * math.factorial(derivative)
    return matrix


def comfort_percent(motion: Float64, *, bench2drive_compat: bool = False) -> float | None:
    """Percent of whole segments inside all limits; None (undefined) for drives shorter than one.

    motion: (N, 3) longitudinal and lateral acceleration (m/s2, in the vehicle's axes) and yaw rate (rad/s) at 20 Hz,
    of which the means over each decision step are judged.
    """
    if not bench2drive_compat:
        steps = len(motion) // SUBSTEPS
        motion = np.asarray(motion[: steps * SUBSTEPS]).reshape(steps, SUBSTEPS, 3).mean(axis=1)
    count = len(motion) // SEGMENT
    if count == 0:
        return None
    segments = np.asarray(motion[: count * SEGMENT]).reshape(count, SEGMENT, 3).transpose(2, 0, 1)
    smooth, slope = savitzky_golay(0).T, savitzky_golay(1).T / STEP_S
    longitudinal, lateral = segments[0] @ smooth, segments[1] @ smooth
    rate = np.degrees(segments[2]) if bench2drive_compat else segments[2]
    yaw_rate = rate @ smooth
    yaw_acceleration = yaw_rate if bench2drive_compat else rate @ slope
    jerk = np.hypot(segments[0], segments[1]) @ slope
    inside = (
        (longitudinal > LONGITUDINAL_MPS2[0]).all(1)
        & (longitudinal < LONGITUDINAL_MPS2[1]).all(1)
        & (np.abs(lateral) < LATERAL_MPS2).all(1)
        & (np.abs(jerk) < JERK_MPS3).all(1)
        & (np.abs(segments[0] @ slope) < LONGITUDINAL_JERK_MPS3).all(1)
        & (np.abs(yaw_acceleration) < YAW_ACCELERATION_RADPS2).all(1)
        & (np.abs(yaw_rate) < YAW_RATE_RADPS).all(1)
    )
    return 100.0 * float(inside.mean())
