"""From a command to the first response of the car, in the vehicle's time.

A command is a step. What it acts on (acceleration by the pedals, curvature by the steering) is fitted with a value that
is constant, then rises linearly, then is constant again; where the rise begins is the dead time of the actuator. The
time that the rise takes belongs to the car, and is not counted.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import pairwise

import numpy as np

from raw2drive_ros.conformance.observation import Observation, Trial, Verdict
from raw2drive_ros.contracts.errors import ContractError
from raw2drive_ros.contracts.public import Float64
from raw2drive_ros.tables.rates import DECISION_HZ

# Two decisions: later than that the car answers an older question than the world model has learned from, whose car
# answers within one.
BUDGET_S = 2.0 / DECISION_HZ
CHECK = 'actuator delay'
BEFORE_S, AFTER_S = 0.4, 1.0
DELAYS_S = np.arange(-0.15, 0.801, 0.01)
RISES_S = (0.02, 0.1, 0.2, 0.3, 0.5)
LEAST_SAMPLES = 12
# Smaller responses drown in noise; the speed from which on a curvature can be told.
LEAST_MPS2, LEAST_1PM, LEAST_MPS = 0.3, 0.01, 0.5
# Share of the variance that the fit must explain.
EXPLAINED = 0.8


def judge_delay(seen: Observation) -> Iterator[Verdict]:
    """One verdict for pedals and steering; skipped where the car was not driven."""
    pedals: list[float] = []
    steering: list[float] = []
    for before, trial in pairwise(seen.trials):
        if before.control is None or trial.control is None or not (_usable(before) and _usable(trial)):
            continue
        times, speeds, curvatures = _around(seen, trial)
        if len(times) < LEAST_SAMPLES:
            continue
        if before.control.steer != trial.control.steer and trial.control.throttle > 0.0:
            pedal, response, least = False, curvatures, LEAST_1PM
        elif (before.control.throttle, before.control.brake) != (trial.control.throttle, trial.control.brake):
            pedal, response, least = True, speeds, LEAST_MPS2
        else:
            continue
        found = onset_s(times, response, least, integrated=pedal)
        if found is not None:
            (pedals if pedal else steering).append(found)
    delays = {'pedals': pedals, 'steering': steering}
    medians_s = {name: max(0.0, float(np.median(found))) for name, found in delays.items() if found}
    if not medians_s:
        yield Verdict(CHECK, 'skipped', 'no response to measure', 'give --allow-motion')
        return
    text = ', '.join(f'{name} {1e3 * value:.0f} ms (of {len(delays[name])})' for name, value in medians_s.items())
    text = f'from command to response: {text}; allowed: {1e3 * BUDGET_S:.0f} ms'
    late = max(medians_s.values()) > BUDGET_S
    fix = 'shorten the way from command to actuator: no queues, no filters, no slow bus' if late else ''
    yield Verdict(CHECK, 'error' if late else 'passed', text, fix)


def onset_s(times_s: Float64, response: Float64, least: float, *, integrated: bool) -> float | None:
    """When `response` (N,) begins to change, in seconds of `times_s` (N,); None where it does not, or not like that.

    integrated: the response is the integral of what the command acts on, as speed is of acceleration. least: change
    below which there is no answer.
    """
    spread = float(((response - np.mean(response)) ** 2).sum())
    best: tuple[float, float, float] | None = None
    for rise in RISES_S:
        for delay in DELAYS_S:
            since = np.clip(times_s - delay, 0.0, None)
            if integrated:
                ramp = np.where(since < rise, since**2 / (2.0 * rise), since - rise / 2.0)
                basis = np.stack([np.ones_like(times_s), times_s, ramp], axis=1)
            else:
                basis = np.stack([np.ones_like(times_s), np.minimum(since / rise, 1.0)], axis=1)
            weights = np.linalg.lstsq(basis, response, rcond=None)[0]
            left = float(((basis @ weights - response) ** 2).sum())
            if best is None or left < best[0]:
                best = left, float(delay), float(weights[-1])
    if best is None or abs(best[2]) < least or best[0] > (1.0 - EXPLAINED) * spread:
        return None
    return best[1]


def _around(seen: Observation, trial: Trial) -> tuple[Float64, Float64, Float64]:
    """((N,) seconds since the command, (N,) speed, (N,) curvature) until the next step, or until the car stands."""
    end_s = min(AFTER_S, trial.times_s[-1]) if trial.times_s else 0.0
    rows = []
    for sample in seen.odometry:
        time_s = (sample.stamp_ns - trial.started_ns) * 1e-9
        if not -BEFORE_S <= time_s <= end_s:
            continue
        if time_s > 0.0 and trial.control is not None and trial.control.brake and abs(sample.speed_mps) < 0.2:
            break
        curvature = sample.yaw_rate_radps / sample.speed_mps if abs(sample.speed_mps) > LEAST_MPS else 0.0
        rows.append((time_s, sample.speed_mps, curvature))
    data = np.array(rows, np.float64).reshape(-1, 3)
    return data[:, 0], data[:, 1], data[:, 2]


def _usable(trial: Trial) -> bool:
    """Whether a vehicle had to obey the trial's command."""
    try:
        return trial.control is not None and bool(trial.control.validate())
    except ContractError:
        return False
