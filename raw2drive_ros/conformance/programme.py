"""What a probe commands, step by step, when it may move the car; time is the vehicle's, and nothing here is a node."""

from __future__ import annotations

import math
from dataclasses import dataclass

from raw2drive_ros.conformance.observation import Observation, Trial
from raw2drive_ros.contracts.errors import UnsafeError
from raw2drive_ros.contracts.public import Control, OdometrySample

BRAKE = Control(0.0, 0.6, 0.0)
GO = Control(0.3, 0.0, 0.0)
# A slower car counts as standing.
STANDING_MPS = 0.3
# A car that is held and yet faster than this obeys somebody else: the step ends at once.
OBEYS_MPS = 0.5
# Speed, and the position for itself, are looked at over so much time. A position drifts more than a speed.
RECENT_S, DRIFT_S = 0.5, 0.25
DRIFTS_MPS = 0.5
LOOK_S = 2.0


@dataclass(frozen=True, slots=True)
class Step:
    """Send `control` (None: send nothing) for `seconds`. name: of the trial, empty where the response is not checked.
    until_standing: end when the car has stood for a while, after `LOOK_S` at the earliest. foreign: what a second
    publisher sends meanwhile."""

    name: str
    control: Control | None
    seconds: float
    until_standing: bool = False
    foreign: Control | None = None


STAND = Step('', BRAKE, 5.0, until_standing=True)
ROLL = Step('', GO, 2.0)
FOREIGN = 'a foreign command is refused'
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
    # Last: what a vehicle does after a foreign command is its own affair, as long as it stands.
    Step(FOREIGN, Control(0.0, 0.3, 0.0), 1.5, foreign=GO),
    STAND,
    Step(FOREIGN, None, 1.5, foreign=GO),
    STAND,
)


class Runner:
    """Goes through `steps` while the odometry of `seen` grows, and leaves a Trial in `seen.trials` for each."""

    def __init__(self, seen: Observation, steps: tuple[Step, ...] = PROGRAMME) -> None:
        self.seen, self.steps = seen, steps
        self.index, self.first, self.started_ns = -1, 0, 0

    def order(self, now_ns: int) -> Step | None:
        """What to do at the vehicle's time `now_ns`; None when the programme is over. Raises UnsafeError when the car
        does not stand where it must."""
        if self.index < 0:
            self._begin(now_ns)
        elif self._over(now_ns):
            step, trial = self.steps[self.index], self.close()
            if step.until_standing and not ends_standing(trial):
                raise UnsafeError(f'the car does not stand after {step.name or "the brake"}')
            self._begin(now_ns)
        return self.steps[self.index] if self.index < len(self.steps) else None

    def again(self, now_ns: int) -> None:
        """Begin the step that is under way once more: what came before was preparation."""
        self.index -= 1
        self._begin(now_ns)

    def skip(self, now_ns: int) -> None:
        """Go on to the next step; no trial is kept of this one."""
        self._begin(now_ns)

    def close(self) -> Trial:
        """End the step that is under way, and keep its trial."""
        trial = self._trial()
        self.seen.trials.append(trial)
        return trial

    def _begin(self, now_ns: int) -> None:
        self.index += 1
        self.first, self.started_ns = len(self.seen.odometry), now_ns

    def _over(self, now_ns: int) -> bool:
        step = self.steps[self.index]
        lasted_s = (now_ns - self.started_ns) * 1e-9
        if lasted_s >= step.seconds:
            return True
        if step.foreign is not None:
            return self._obeys()
        return step.until_standing and lasted_s >= LOOK_S and stands(self._trial())

    def _obeys(self) -> bool:
        samples = self.seen.odometry[self.first :]
        return bool(samples) and abs(samples[-1].speed_mps) > OBEYS_MPS

    def _trial(self) -> Trial:
        step, samples = self.steps[self.index], self.seen.odometry[self.first :]
        return Trial(
            step.name,
            step.control,
            [(sample.stamp_ns - self.started_ns) * 1e-9 for sample in samples],
            [sample.speed_mps for sample in samples],
            [sample.yaw_rate_radps for sample in samples],
            self.started_ns,
            drift_mps(samples),
        )


def drift_mps(samples: list[OdometrySample]) -> float:
    """How far the position has moved over the last `DRIFT_S`, per second."""
    recent = [s for s in samples if s.stamp_ns > samples[-1].stamp_ns - DRIFT_S * 1e9] if samples else []
    if len(recent) < 2:
        return 0.0
    lasted_s = max((recent[-1].stamp_ns - recent[0].stamp_ns) * 1e-9, 1e-9)
    return math.hypot(recent[-1].x_m - recent[0].x_m, recent[-1].y_m - recent[0].y_m) / lasted_s


def stands(trial: Trial) -> bool:
    """Whether the car has stood still for the last half second."""
    recent = [v for t, v in zip(trial.times_s, trial.speeds_mps, strict=True) if t > trial.times_s[-1] - RECENT_S]
    return len(recent) >= 5 and max(map(abs, recent)) < STANDING_MPS / 3 and trial.drift_mps < DRIFTS_MPS


def ends_standing(trial: Trial) -> bool:
    """Whether the car stands at the last odometry; without any odometry it does not."""
    return bool(trial.speeds_mps) and abs(trial.speeds_mps[-1]) < STANDING_MPS and trial.drift_mps < DRIFTS_MPS
