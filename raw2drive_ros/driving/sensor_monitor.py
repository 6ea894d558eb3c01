"""Checks whether the sensor data is fit for driving. Pure: no ROS, no clock of its own, no torch.

nominal: drive. degraded: drive and report it. stop: do not decide; the gate then stops the car and latches the stop.
A lost camera always means stop: driving without one was never validated.
"""

from __future__ import annotations

import enum
import math
from collections import deque
from dataclasses import dataclass, field

import numpy as np

from raw2drive_ros.contracts.public import Image8, ImuSample, SensorFrame
from raw2drive_ros.tables.rates import DECISION_HZ

# Images are subsampled by this factor in both directions: 24 x 40 pixels of 96 x 160.
STRIDE = 4


class Health(enum.IntEnum):
    """Worse is larger."""

    NOMINAL = 0
    DEGRADED = 1
    STOP = 2


@dataclass(frozen=True, slots=True)
class Finding:
    """One problem and its remedy. unheard: no input at all was heard since the start, and this one not before it
    either."""

    health: Health
    cause: str
    remedy: str
    unheard: bool = False

    @property
    def subject(self) -> str:
        """The cause without its figures, which change from check to check."""
        return self.cause.split(':')[0]


@dataclass(frozen=True, slots=True)
class MonitorLimits:
    """See `params/monitor.yaml`; times in seconds of ROS time, which a paused simulation stops too."""

    period_s: float = 1.0 / DECISION_HZ
    age_s: float = 0.3
    degraded_gap_s: float = 0.115
    stop_gap_s: float = 0.15
    gaps: int = 10
    blind_levels: int = 8
    blind_frames: int = 3
    frozen_frames: int = 5
    moving_mps: float = 1.0
    max_force_mps2: float = 60.0
    max_rate_radps: float = 10.0
    absurd_samples: int = 5
    memory_s: float = 1.0


@dataclass(slots=True)
class _CameraState:
    sample: Image8 | None = None
    same: int = 0
    blind: int = 0


@dataclass(slots=True)
class SensorMonitor:
    """Gets everything that arrives from the planner; `findings(now_ns)` lists what is wrong, worst first.

    counts: events by name since the start, for diagnostics.
    """

    cameras: tuple[str, ...]
    limits: MonitorLimits = field(default_factory=MonitorLimits)
    counts: dict[str, int] = field(default_factory=dict)
    _heard_ns: dict[str, int] = field(default_factory=dict)
    _ever: set[str] = field(default_factory=set)
    _ahead_ns: dict[str, int] = field(default_factory=dict)
    _camera_states: dict[str, _CameraState] = field(default_factory=dict)
    _frames_ns: deque[int] = field(default_factory=deque)
    _pictures_ns: dict[str, deque[int]] = field(default_factory=dict)
    _refused: dict[str, tuple[int, str]] = field(default_factory=dict)
    _absurd: str = ''
    _absurd_count: int = 0
    _started_ns: int | None = None

    def reset(self) -> None:
        """Forget all samples, as after a jump of time; counts and the set of inputs ever heard stay."""
        self._heard_ns.clear()
        self._ahead_ns.clear()
        self._camera_states.clear()
        self._frames_ns.clear()
        self._pictures_ns.clear()
        self._refused.clear()
        self._absurd_count = 0
        self._started_ns = None

    @property
    def complete(self) -> bool:
        """Every input has been heard since the start."""
        return self._heard_ns.keys() >= {*self.cameras, 'imu', 'odometry'}

    def start(self, now_ns: int) -> None:
        """Expect inputs from now on; silence is measured from here."""
        self._started_ns = now_ns

    def heard(self, name: str, stamp_ns: int, now_ns: int) -> bool:
        """A message of an input (a camera, `imu`, `odometry`) arrived at `now_ns` of ROS time. False, do not use it:
        its stamp is older than the last one, or so far in the future that all later ones would look old."""
        ahead_ns = stamp_ns - now_ns
        if ahead_ns > round(self.limits.age_s * 1e9):
            self._count(f'{name}_early')
            self._ahead_ns[name] = ahead_ns
            return False
        self._ahead_ns.pop(name, None)
        if stamp_ns < self._heard_ns.get(name, stamp_ns):
            self._count(f'{name}_out_of_order')
            return False
        if name in self.cameras and stamp_ns != self._heard_ns.get(name):
            self._pictures_ns.setdefault(name, deque(maxlen=self.limits.gaps + 1)).append(stamp_ns)
        self._heard_ns[name] = stamp_ns
        self._ever.add(name)
        return True

    def between(self, name: str) -> None:
        """A picture came between two decisions, from a camera that is faster than those. That is no fault."""
        self._count(f'{name}_between')

    def refused(self, name: str, why: str, now_ns: int) -> None:
        """A message of input `name` violates its contract."""
        self._count(f'{name}_refused')
        self._refused[name] = (now_ns, why)

    def imu(self, sample: ImuSample) -> None:
        """Check a reading. The planner uses it all the same: a collision also gives absurd values for a moment."""
        force, rate = math.hypot(*sample.specific_force_mps2), math.hypot(*sample.angular_velocity_radps)
        self._absurd = ''
        if force > self.limits.max_force_mps2:
            self._absurd = f'specific force {force:.0f} m/s2'
        elif rate > self.limits.max_rate_radps:
            self._absurd = f'angular velocity {rate:.0f} rad/s'
        self._absurd_count = self._absurd_count + 1 if self._absurd else 0
        if self._absurd:
            self._count('imu_absurd')

    def frame(self, frame: SensorFrame) -> None:
        """Check a complete frame before the decision on it."""
        self._frames_ns.append(frame.stamp_ns)
        while len(self._frames_ns) > self.limits.gaps + 1:
            self._frames_ns.popleft()
        moving = abs(frame.odometry.speed_mps) > self.limits.moving_mps
        for name, image in frame.images.items():
            state = self._camera_states.setdefault(name, _CameraState())
            sample = image[::STRIDE, ::STRIDE].copy()
            # Only contrast within a row reveals a freeze: a meadow under a plain sky looks the same from everywhere.
            same = moving and state.sample is not None and np.array_equal(sample, state.sample)
            same = same and int(np.ptp(sample, axis=1).max()) >= self.limits.blind_levels
            blind = int(sample.max()) - int(sample.min()) < self.limits.blind_levels
            state.sample = sample
            state.same, state.blind = state.same + 1 if same else 0, state.blind + 1 if blind else 0

    def findings(self, now_ns: int) -> list[Finding]:
        """Everything that is wrong at `now_ns` of ROS time, worst first."""
        found = [*self._silent(now_ns), *self._pictures(), *self._rate(), *self._lately(now_ns)]
        return sorted(found, key=lambda finding: -finding.health)

    def _silent(self, now_ns: int) -> list[Finding]:
        found = []
        allowed_ns = round(self.limits.age_s * 1e9)
        for name in (*self.cameras, 'imu', 'odometry'):
            last_ns = self._heard_ns.get(name, self._started_ns)
            if last_ns is None:
                continue
            silent_ns = now_ns - last_ns
            silent_s = silent_ns * 1e-9
            kind = f'camera {name}' if name in self.cameras else name
            ahead_ns = max(-silent_ns, self._ahead_ns.get(name, 0))
            if ahead_ns > allowed_ns:
                cause = f'{kind}: stamps are {ahead_ns * 1e-9:.2f} s ahead of ROS time'
                found.append(Finding(Health.STOP, cause, 'do both clocks agree, is use_sim_time the same everywhere?'))
            if silent_ns > allowed_ns:
                refused = self._refused.get(name)
                why = f'; refused: {refused[1]}' if refused else ''
                heard = name in self._heard_ns
                age = f'newest is {silent_s:.2f} s old' if heard else f'silent for {silent_s:.2f} s'
                remedy = f'is the driver of {kind} alive, is its clock right?'
                unheard = not (self._heard_ns or self._ahead_ns or why) and name not in self._ever
                found.append(Finding(Health.STOP, f'{kind}: {age}{why}', remedy, unheard))
        return found

    def _pictures(self) -> list[Finding]:
        found = []
        for name, state in self._camera_states.items():
            if state.blind >= self.limits.blind_frames:
                assert state.sample is not None
                shade = 'black' if state.sample.mean() < 128 else 'white'
                cause = f'camera {name}: {shade} for {state.blind} frames'
                found.append(Finding(Health.STOP, cause, 'look at the lens, the exposure and the cable'))
            if state.same >= self.limits.frozen_frames:
                cause = f'camera {name}: the same picture {state.same + 1} times while driving'
                found.append(Finding(Health.STOP, cause, "restart the camera's driver"))
        return found

    def _rate(self) -> list[Finding]:
        if len(self._frames_ns) <= self.limits.gaps:
            return []
        gap_s = (self._frames_ns[-1] - self._frames_ns[0]) * 1e-9 / self.limits.gaps
        wanted_s = self.limits.period_s
        if wanted_s**2 / self.limits.degraded_gap_s <= gap_s <= self.limits.degraded_gap_s:
            return []
        health = Health.STOP if gap_s > self.limits.stop_gap_s else Health.DEGRADED
        cause = f'camera sets: {1.0 / gap_s:.1f} Hz instead of {1.0 / wanted_s:.0f}'
        remedy = 'does every camera carry the same stamps, is the machine overloaded?'
        faster = self._faster_cameras()
        if faster:
            cause += f', pictures come at {", ".join(faster)}'
            remedy = f'set every camera to {1.0 / wanted_s:.0f} Hz or a multiple of it'
        return [Finding(health, cause, remedy)]

    def _faster_cameras(self) -> list[str]:
        """Rates of the cameras that are faster than decisions, but not by a whole factor."""
        rates = []
        for stamps in self._pictures_ns.values():
            if len(stamps) > self.limits.gaps:
                gap_s = (stamps[-1] - stamps[0]) * 1e-9 / self.limits.gaps
                factor = self.limits.period_s / gap_s
                if factor > 1.05 and abs(factor - round(factor)) > 0.05:
                    rates.append(f'{1.0 / gap_s:.1f} Hz')
        return sorted(set(rates))

    def _lately(self, now_ns: int) -> list[Finding]:
        found = []
        for name, (then_ns, why) in self._refused.items():
            if (now_ns - then_ns) * 1e-9 <= self.limits.memory_s:
                found.append(Finding(Health.DEGRADED, f'{name}: refused: {why}', 'the message breaks docs/topics.md'))
        if self._absurd_count:
            health = Health.STOP if self._absurd_count >= self.limits.absurd_samples else Health.DEGRADED
            cause = f'imu: {self._absurd}, {self._absurd_count} times in a row'
            found.append(Finding(health, cause, 'look at units (SI) and mounting of the IMU'))
        return found

    def _count(self, name: str) -> None:
        self.counts[name] = self.counts.get(name, 0) + 1
