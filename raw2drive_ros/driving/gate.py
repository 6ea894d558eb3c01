"""The safety gate's state machine: pure, without torch, ROS or clocks of its own.

It passes proposals on while they are recent and valid, cut to the motion limits. Otherwise it stops the car,
comfortably where that is enough and else with the emergency brake, and latches the stop until re-activated.
"""

from __future__ import annotations

import enum
import math
from dataclasses import dataclass, field

from raw2drive_ros.contracts.errors import ContractError
from raw2drive_ros.contracts.public import Control, Decision
from raw2drive_ros.driving.gate_limits import MotionLimits, limited
from raw2drive_ros.driving.gate_monitors import Oscillation, Saturation


class GateState(enum.Enum):
    """waiting: no proposal yet, brake held. driving: proposals pass. comfortable_stop, emergency_stop: latched until
    `activate`."""

    WAITING = 'waiting'
    DRIVING = 'driving'
    COMFORTABLE_STOP = 'comfortable_stop'
    EMERGENCY_STOP = 'emergency_stop'


SHORTEST_S = 0.001
STOPS = (GateState.COMFORTABLE_STOP, GateState.EMERGENCY_STOP)


@dataclass(frozen=True, slots=True)
class Moment:
    """One instant on both clocks, in seconds. ros_s: ROS time (/clock or system time), the clock of message stamps."""

    steady_s: float
    ros_s: float


@dataclass(frozen=True, slots=True)
class GateLimits:
    """Times in seconds, brakes as pedals [0, 1]; `params/timing.yaml` and `params/gate.yaml` say what each is for."""

    comfortable_after_s: float = 0.3
    emergency_after_s: float = 0.8
    frozen_after_s: float = 10.0
    frozen_odometry: int = 20
    proposal_age_s: float = 0.3
    odometry_after_s: float = 0.5
    clock_back_s: float = 0.05
    comfortable_brake: float = 0.15
    comfortable_brake_rate_1ps: float = 0.5
    emergency_brake: float = 0.6
    hold_brake: float = 0.3
    speed_margin_mps: float = 2.0
    standing_mps: float = 0.3
    slowing_after_s: float = 2.0
    slowing_mps: float = 0.5
    swing: float = 1.0
    swings: int = 10
    swing_window_s: float = 2.0
    saturated_after_s: float = 5.0


@dataclass(slots=True)
class Gate:
    """propose(), refuse() and tick() return the command to publish now.

    steady: silence (no valid proposal) is measured on the steady clock, as on a car; otherwise on ROS time, which a
    simulation may pause or slow down. If ROS time is frozen while the car keeps moving, odometry reveals it: more than
    `frozen_odometry` messages since the last proposal count as silence too, as does, without any odometry, more than
    `frozen_after_s` on the steady clock. counts: events by name, for diagnostics.
    """

    limits: GateLimits = field(default_factory=GateLimits)
    motion: MotionLimits = field(default_factory=MotionLimits)
    steady: bool = True
    state: GateState = GateState.WAITING
    reason: str = 'no proposal yet'
    counts: dict[str, int] = field(default_factory=dict)
    speed_mps: float | None = None
    last_control: Control = field(default_factory=Control)
    _last_valid: Moment | None = None
    _last_stamp_s: float = -math.inf
    _last_refused: str = ''
    _last_odometry: Moment | None = None
    _newest_ros_s: float = -math.inf
    _unclocked: int = 0
    _passed: Moment = field(default_factory=lambda: Moment(0.0, 0.0))
    _stopped: Moment = field(default_factory=lambda: Moment(0.0, 0.0))
    _slowed: Moment = field(default_factory=lambda: Moment(0.0, 0.0))
    _slowed_to_mps: float = 0.0
    _crowded: str = ''
    _oscillation: Oscillation = field(init=False)
    _saturation: Saturation = field(init=False)

    def __post_init__(self) -> None:
        limits = self.limits
        self._oscillation = Oscillation(limits.swing, limits.swings, limits.swing_window_s)
        self._saturation = Saturation(limits.saturated_after_s)

    # -- events ---------------------------------------------------------------------------------------

    def propose(self, decision: Decision, now: Moment) -> Control:
        """A proposal arrived now."""
        stamp_s = decision.stamp_ns * 1e-9
        try:
            control = decision.control.validate()
        except ContractError as error:
            return self.refuse(f'invalid proposal: {error}', now)
        age_s = round(now.ros_s - stamp_s, 4)
        if age_s > self.limits.proposal_age_s or age_s < -self.limits.proposal_age_s:
            self._overlook(
                'late' if age_s > 0.0 else 'early',
                f'the last one is {age_s:.2f} s old; do planner and gate have the same clock?',
            )
            return self.tick(now)
        if stamp_s < self._last_stamp_s:
            self._overlook('out_of_order', 'the last one is older than the one before')
            return self.tick(now)
        if not self.steady:
            # In lock-step a proposal may overtake the /clock message of its own tick.
            now = Moment(now.steady_s, max(now.ros_s, stamp_s))
        self._last_stamp_s, self._last_valid, self._last_refused, self._unclocked = stamp_s, now, '', 0
        if self.state is GateState.WAITING and not self._crowded:
            self.state, self.reason = GateState.DRIVING, ''
            self.last_control, self._passed = Control(0.0, self.limits.hold_brake, 0.0), now
        return self._pass(control, now) if self.state is GateState.DRIVING else self.tick(now)

    def refuse(self, reason: str, now: Moment) -> Control:
        """Emergency stop for `reason`, such as a proposal that is not a valid command."""
        self._stop(GateState.EMERGENCY_STOP, reason, now)
        return self.tick(now)

    def observe(self, speed_mps: float, now: Moment) -> None:
        """Measured speed, signed. A value that is not finite counts as missing odometry."""
        if math.isfinite(speed_mps):
            self.speed_mps, self._last_odometry = speed_mps, now
        if self._last_valid is not None and now.ros_s <= self._last_valid.ros_s:
            self._unclocked += 1

    def publisher_counts(self, proposing: int, commanding: int, now: Moment) -> None:
        """Number of publishers of proposals and of commands now, the gate itself among the latter; only one may be."""
        names = [name for name, count in (('proposals', proposing), ('commands', commanding)) if count > 1]
        self._crowded = f'more than one publisher of {" and of ".join(names)}' if names else ''
        if self._crowded and self.state is not GateState.WAITING:
            self._stop(GateState.EMERGENCY_STOP, self._crowded, now)

    def activate(self) -> str:
        """Leave a latched stop, so that the next valid proposal drives; returns the reason of a refusal, or ''."""
        if self._crowded:
            return self._crowded
        if self.state is GateState.DRIVING:
            return 'the car is driving already'
        if self.state in STOPS and self.speed_mps is not None and self.moves:
            return f'the car still drives at {self.speed_mps:.1f} m/s'
        self.state, self.reason = GateState.WAITING, 're-activated'
        self._last_valid = self._last_odometry = self.speed_mps = None
        self._last_stamp_s, self._unclocked = -math.inf, 0
        self._oscillation.reset()
        self._saturation.reset()
        return ''

    def tick(self, now: Moment) -> Control:
        """The command now, without a new proposal."""
        self._watch(now)
        match self.state:
            case GateState.DRIVING:
                return self.last_control
            case GateState.WAITING:
                return Control(0.0, self.limits.hold_brake, 0.0)
            case GateState.COMFORTABLE_STOP:
                rising = max(0.0, self._since(self._stopped, now)) * self.limits.comfortable_brake_rate_1ps
                brake = min(self.limits.comfortable_brake, rising)
            case _:
                brake = self.limits.emergency_brake
        # A stop never brakes less than the last command did, and never changes gear: the car may be moving.
        last = self.last_control
        return Control(0.0, max(brake, last.brake), last.steer, last.reverse)

    # -- checks ---------------------------------------------------------------------------------------

    def _pass(self, wanted: Control, now: Moment) -> Control:
        """A valid proposal while driving: checked for oscillation and saturation, then cut to the limits."""
        if self._oscillation.see(wanted.steer, self._clock(now)):
            self._stop(GateState.COMFORTABLE_STOP, f'steering swings to and fro {self.limits.swings} times', now)
        elif self._saturation.see(wanted.steer if self.moves else 0.0, self._clock(now)):
            self._stop(GateState.COMFORTABLE_STOP, f'full lock for {self.limits.saturated_after_s:.0f} s', now)
        if self.state is not GateState.DRIVING:
            return self.tick(now)
        dt_s = min(max(self._since(self._passed, now), SHORTEST_S), self.limits.comfortable_after_s)
        control, names = limited(wanted, self.last_control, self.speed_mps, dt_s, self.motion)
        for name in names:
            self._count(f'limited_{name}')
        self.last_control, self._passed = control, now
        return control

    @property
    def moves(self) -> bool:
        """Whether the car moves; an unknown speed counts as moving."""
        return self.speed_mps is None or abs(self.speed_mps) > self.limits.standing_mps

    def _watch(self, now: Moment) -> None:
        """The reasons for a stop that depend on time or on measurements, not on a new proposal."""
        limits, back_s = self.limits, self._newest_ros_s - now.ros_s
        self._newest_ros_s = now.ros_s
        if self.state is GateState.DRIVING:
            self._watch_driving(now, back_s)
        if self.state is not GateState.COMFORTABLE_STOP:
            return
        silent = self._silent(now, limits.emergency_after_s)
        if silent:
            self._stop(GateState.EMERGENCY_STOP, silent, now)
        elif self.speed_mps is not None and abs(self.speed_mps) <= self._slowed_to_mps - limits.slowing_mps:
            # Checked throughout the stop: brakes may fade, and a slope may begin.
            self._slowed, self._slowed_to_mps = now, abs(self.speed_mps)
        elif self.speed_mps is not None and self.moves and self._since(self._slowed, now) > limits.slowing_after_s:
            self._stop(GateState.EMERGENCY_STOP, 'the car does not slow down', now)

    def _watch_driving(self, now: Moment, back_s: float) -> None:
        limits, speed = self.limits, abs(self.speed_mps or 0.0)
        silent = self._silent(now, limits.comfortable_after_s)
        blind_s = 0.0 if self._last_odometry is None else self._since(self._last_odometry, now)
        if silent:
            reason = silent
        elif back_s > limits.clock_back_s:
            reason = f'ROS time went back by {back_s:.2f} s'
        elif blind_s > limits.odometry_after_s:
            reason = f'no odometry for {blind_s * 1e3:.0f} ms'
        elif speed > self.motion.max_speed_mps + limits.speed_margin_mps:
            reason = f'{speed:.1f} m/s is too fast'
        else:
            return
        self._stop(GateState.COMFORTABLE_STOP, reason, now)

    def _silent(self, now: Moment, after_s: float) -> str:
        """Why the planner counts as silent, or ''."""
        assert self._last_valid is not None
        silent_s, steady_s = self._since(self._last_valid, now), now.steady_s - self._last_valid.steady_s
        refused = f' ({self._last_refused})' if self._last_refused else ''
        if silent_s > after_s:
            return f'no valid proposal for {silent_s * 1e3:.0f} ms{refused}'
        if self._unclocked > self.limits.frozen_odometry:
            return f'no valid proposal while odometry came {self._unclocked} times and ROS time stood still{refused}'
        if self._last_odometry is None and steady_s > self.limits.frozen_after_s:
            return f'no valid proposal for {steady_s:.1f} s, and ROS time advanced by {silent_s:.2f} s{refused}'
        return ''

    def _overlook(self, name: str, why: str) -> None:
        """Ignore a proposal, so that it counts as silence; `why` is added to the reason of a stop."""
        self._count(name)
        self._last_refused = why

    def _stop(self, state: GateState, reason: str, now: Moment) -> None:
        if self.state is GateState.EMERGENCY_STOP:
            # Keep the first reason: later ones may be consequences of it.
            return
        self.state, self.reason, self._stopped = state, reason, now
        self._slowed, self._slowed_to_mps = now, abs(self.speed_mps or 0.0)
        self._last_valid = self._last_valid or now
        self._count(state.value)

    def _count(self, name: str) -> None:
        self.counts[name] = self.counts.get(name, 0) + 1

    def _clock(self, now: Moment) -> float:
        return now.steady_s if self.steady else now.ros_s

    def _since(self, then: Moment, now: Moment) -> float:
        """Rounded to 0.1 ms, so that no limit is decided by the rounding error of seconds that count from 1970."""
        return round(self._clock(now) - self._clock(then), 4)
