"""Verdicts on the trials of `programme`, and on everything that was recorded while the car drove."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np

from raw2drive_ros.conformance.colours import judge_colours
from raw2drive_ros.conformance.delay import judge_delay
from raw2drive_ros.conformance.image_motion import judge_pictures
from raw2drive_ros.conformance.motion import HEADING, TWIST, YAW_RATE, judge_odometry
from raw2drive_ros.conformance.observation import Observation, Trial, Verdict
from raw2drive_ros.conformance.programme import FOREIGN, STANDING_MPS, ends_standing
from raw2drive_ros.conformance.summary import summarised
from raw2drive_ros.contracts import topics
from raw2drive_ros.timing import load_timing

FASTER_MPS = 0.5
# Least deceleration without commands, as a share of that under `BRAKE`: coasting is not braking.
BRAKING_SHARE = 0.4
TURNING_RADPS = 0.02
# Without these to rely on, the car is not moved.
NEEDED = (topics.ODOMETRY, '/control', 'clock')
# A trial that fails proves nothing where the odometry that judges it is wrong itself.
JUDGED_BY = {
    'throttle drives forward': (TWIST, HEADING),
    'steer left': (YAW_RATE, HEADING),
    'steer right': (YAW_RATE, HEADING),
}


def what_forbids_motion(verdicts: list[Verdict]) -> list[str]:
    """The checks whose failure makes it unsafe to move the car."""
    return [v.check for v in verdicts if v.severity == 'error' and v.check.startswith(NEEDED)]


def judge_drive(seen: Observation, listened: list[Verdict]) -> list[Verdict]:
    """All checks of what was recorded, trials included, the causes before their effects.

    listened: the verdicts of `passive.judge`. A car that was not moved, by us or anybody, has most checks skipped.
    """
    odometry = judge_odometry(seen)
    broken = {verdict.check for verdict in odometry if verdict.severity == 'error'}
    trials = list(_without_effects(judge_trials([trial for trial in seen.trials if trial.name]), broken))
    delay = list(judge_delay(seen))
    if HEADING in broken:
        pictures = [Verdict('cameras: motion of the pictures', 'skipped', f'not without {HEADING}', 'mend that first')]
    else:
        pictures = list(judge_pictures(seen, _named(listened, ': calibration')))
    upright = [name for name in seen.calibrations if name not in _named(pictures, ': motion of the picture')]
    return [*odometry, *trials, *delay, *pictures, *judge_colours(seen, upright)]


def conclude(seen: Observation, listened: list[Verdict], given_up: list[Verdict]) -> list[Verdict]:
    """Everything that is said about a vehicle, in the order of cause and effect; one finding for one cause.

    listened: the verdicts of `passive.judge`. given_up: why the programme was not driven, or not to its end; no error
    where a trial has one already.
    """
    drive = judge_drive(seen, listened)
    if any(verdict.severity == 'error' and verdict.check in CHECKS for verdict in drive):
        given_up = [replace(verdict, severity='skipped') for verdict in given_up]
    return summarised([*listened, *drive, *given_up])


def _named(verdicts: list[Verdict], what: str) -> set[str]:
    """The cameras that have an error in the check `camera NAME: what`."""
    wrong = [v.check for v in verdicts if v.severity == 'error' and v.check.endswith(what)]
    return {check.removeprefix('camera ').removesuffix(what) for check in wrong}


def judge_trials(trials: list[Trial]) -> list[Verdict]:
    """A verdict per name of a trial, in their order; of several with one name the first that failed."""
    asked = [deceleration(trial) for trial in trials if trial.name == 'brake stops']
    found: dict[str, Verdict] = {}
    for trial in trials:
        verdict = _judge(trial, asked[0] if asked else 0.0)
        if trial.name not in found or found[trial.name].severity == 'passed':
            found[trial.name] = verdict
    return list(found.values())


def _without_effects(verdicts: list[Verdict], broken: set[str]) -> Iterator[Verdict]:
    """Failed trials become skipped where something else explains the failure."""
    reversed_left = any(v.check == 'steer left' and v.severity == 'error' for v in verdicts)
    for verdict in verdicts:
        causes = [cause for cause in JUDGED_BY.get(verdict.check, ()) if cause in broken]
        if verdict.severity != 'error':
            yield verdict
        elif causes:
            yield replace(verdict, severity='skipped', remedy=f'mend "{causes[0]}" first')
        elif verdict.check == 'steer right' and reversed_left:
            yield replace(verdict, severity='skipped', remedy='see "steer left": one cause')
        else:
            yield verdict


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


def _holds(trial: Trial) -> bool:
    return max(map(abs, trial.speeds_mps)) < STANDING_MPS


BY_ITSELF = ('silence stops', 'NaN is refused', 'absurd values are refused')
CHECKS: dict[str, Callable[[Trial], tuple[bool, str]]] = {
    'brake holds': lambda t: (_holds(t), 'the brake must hold a standing car'),
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
    FOREIGN: lambda t: (
        _holds(t),
        f'obey one publisher of {topics.COMMAND}, the gate: check the signature and sequence of every command',
    ),
}
