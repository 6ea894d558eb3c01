"""Checks that move the car: what each trial commands, and how the car must respond."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from raw2drive_ros.conformance.observation import Trial, Verdict
from raw2drive_ros.contracts.public import Control
from raw2drive_ros.timing import load_timing

BRAKE = Control(0.0, 0.6, 0.0)
GO = Control(0.3, 0.0, 0.0)
# A slower car counts as standing.
STANDING_MPS = 0.3
FASTER_MPS = 0.5
# Least deceleration without commands, as a share of that under `BRAKE`: coasting is not braking.
BRAKING_SHARE = 0.4
TURNING_RADPS = 0.02


@dataclass(frozen=True, slots=True)
class Step:
    """Send `control` (None: send nothing) for `seconds`. name: of the trial, empty where the response is not checked.
    until_standing: end when the car has stood for a while, after `LOOK_S` at the earliest."""

    name: str
    control: Control | None
    seconds: float
    until_standing: bool = False


LOOK_S = 2.0
STAND = Step('', BRAKE, 5.0, until_standing=True)
ROLL = Step('', GO, 2.0)
PROGRAMME: tuple[Step, ...] = (
    STAND,
    Step('brake holds', Control(0.0, 0.3, 0.0), 1.0),
    Step('throttle drives forward', GO, 2.5),
    Step('steer left', Control(0.3, 0.0, 0.3), 1.5),
    Step('steer right', Control(0.3, 0.0, -0.3), 1.5),
    Step('brake stops', BRAKE, 4.0, until_standing=True),
    ROLL,
    Step('silence stops', None, 4.0, until_standing=True),
    STAND,
    ROLL,
    Step('NaN is refused', Control(math.nan, math.nan, math.nan), 4.0, until_standing=True),
    STAND,
    ROLL,
    Step('absurd values are refused', Control(9.0, -3.0, 7.0), 4.0, until_standing=True),
    STAND,
)


def stands(trial: Trial) -> bool:
    """Whether the car has stood still for the last half second."""
    recent = [v for t, v in zip(trial.times_s, trial.speeds_mps, strict=True) if t > trial.times_s[-1] - 0.5]
    return len(recent) >= 5 and trial.times_s[-1] >= LOOK_S and max(map(abs, recent)) < STANDING_MPS / 3


def ends_standing(trial: Trial) -> bool:
    """Whether the car stands at the last odometry; without any odometry it does not."""
    return bool(trial.speeds_mps) and abs(trial.speeds_mps[-1]) < STANDING_MPS


def judge_trials(trials: list[Trial]) -> list[Verdict]:
    """A verdict per trial, in their order."""
    asked = [deceleration(trial) for trial in trials if trial.name == 'brake stops']
    return [_judge(trial, asked[0] if asked else 0.0) for trial in trials]


def deceleration(trial: Trial, after_s: float = 0.0) -> float:
    """Mean deceleration from `after_s` until the car stands, m/s2; 0 if it stood already."""
    points = [(t, abs(v)) for t, v in zip(trial.times_s, trial.speeds_mps, strict=True) if t >= after_s]
    if not points or points[0][1] < STANDING_MPS:
        return 0.0
    last = next((point for point in points if point[1] < STANDING_MPS), points[-1])
    lasted_s = last[0] - points[0][0]
    return (points[0][1] - last[1]) / lasted_s if lasted_s > 0.0 else 0.0


def _judge(trial: Trial, asked_mps2: float) -> Verdict:
    if len(trial.speeds_mps) < 3:
        return Verdict(trial.name, 'error', 'no odometry during the trial', 'odometry must go on while driving')
    text = (
        f'speed {trial.speeds_mps[0]:.1f} to {trial.speeds_mps[-1]:.1f} m/s, '
        f'yaw rate {float(np.mean(trial.yaw_rates_radps)):+.2f} rad/s'
    )
    good, remedy = CHECKS[trial.name](trial)
    if good and trial.name in BY_ITSELF:
        # A vehicle may hold the last command for a while, or brake at once.
        found_mps2 = max(deceleration(trial), deceleration(trial, load_timing().command_hold_s))
        text += f', braking at {found_mps2:.1f} m/s2'
        good = found_mps2 >= BRAKING_SHARE * asked_mps2
    return Verdict(trial.name, 'passed' if good else 'error', text, '' if good else remedy)


def _turns(trial: Trial) -> float:
    """Mean yaw rate (rad/s) of the second half, when the wheels have turned."""
    return float(np.mean(trial.yaw_rates_radps[len(trial.yaw_rates_radps) // 2 :]))


BY_ITSELF = ('silence stops', 'NaN is refused', 'absurd values are refused')
CHECKS: dict[str, Callable[[Trial], tuple[bool, str]]] = {
    'brake holds': lambda t: (max(map(abs, t.speeds_mps)) < STANDING_MPS, 'the brake must hold a standing car'),
    'throttle drives forward': lambda t: (
        t.speeds_mps[-1] > t.speeds_mps[0] + FASTER_MPS,
        'positive throttle drives forward, and forward speed is positive (REP-103)',
    ),
    'steer left': lambda t: (_turns(t) > TURNING_RADPS, 'positive steer turns LEFT, positive yaw rate (REP-103)'),
    'steer right': lambda t: (_turns(t) < -TURNING_RADPS, 'negative steer turns right, negative yaw rate (REP-103)'),
    'brake stops': lambda t: (ends_standing(t), 'brake 0.6 must stop the car within 4 s'),
    'silence stops': lambda t: (
        ends_standing(t),
        f'hold a command for {load_timing().command_hold_s} s at most, then brake as for brake 0.6',
    ),
    'NaN is refused': lambda t: (ends_standing(t), 'a command that is not finite is no command: brake as in silence'),
    'absurd values are refused': lambda t: (ends_standing(t), 'a command out of range is none: brake as in silence'),
}
