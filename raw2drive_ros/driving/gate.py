"""The safety gate's state machine: pure, without torch, ROS or clocks of its own.

It passes proposals on while they are recent and valid, cut to the motion limits. Otherwise it stops the car,
comfortably where that is enough and else with the emergency brake, and latches the stop until re-activated.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

from raw2drive_ros.contracts.errors import ContractError
from raw2drive_ros.contracts.public import Control, Decision, VehicleStatus
from raw2drive_ros.driving.gate_limits import MotionLimits, limited
from raw2drive_ros.driving.gate_monitors import Oscillation, Saturation
from raw2drive_ros.driving.gate_speed import Reading, SpeedSense
from raw2drive_ros.driving.gate_state import STOPS, GateLimits, GateState, Moment

# A simulation that puts the car somewhere may do so at speed. After so many decision ticks it is just a moving car.
PLACED_TICKS = 10
# Two messages of a simulation's clock are a tick or less apart, in simulated time.
CLOCK_AHEAD_S = 1.0


@dataclass(slots=True)
class Gate:
    """propose(), refuse() and tick() return the command to publish now.

    steady: silence (no valid proposal) is measured on the steady clock, as on a car; otherwise on ROS time, which a
    simulation may pause or slow down. If ROS time is frozen while the car keeps moving, odometry reveals it: more than
    `frozen_odometry` messages since the last proposal count as silence too. simulated: a status that says that the car
    was put somewhere else ends a stop. counts: events by name, for diagnostics. activation: raised by every `activate`;
    commands carry it, and a vehicle that has stopped by itself obeys only a newer one.

    A gate that has just started does not know what the one before it knew: it drives only a car whose speed it knows,
    and is latched from the start where the car moves, or the vehicle reports a stop.
    """

    limits: GateLimits = field(default_factory=GateLimits)
    motion: MotionLimits = field(default_factory=MotionLimits)
    steady: bool = True
    simulated: bool = False
    state: GateState = GateState.WAITING
    reason: str = 'no proposal yet'
    counts: dict[str, int] = field(default_factory=dict)
    activation: int = 0
    last_control: Control = field(default_factory=Control)
    sense: SpeedSense = field(default_factory=SpeedSense)
    _fresh: bool = True
    _placed: int = 0
    _heard_activation: int = 0
    _overridden: bool = False
    _activated: Moment | None = None
    _speedless: Moment | None = None
    _last_valid: Moment | None = None
    _last_stamp_s: float = -math.inf
    _last_refused: str = ''
    _last_odometry: Moment | None = None
    _last_status: Moment | None = None
    _newest_ros_s: float = -math.inf
    _newest_clock_s: float | None = None
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
        if self.state is GateState.WAITING:
            self._watch_waiting(now)
        if self.state is GateState.WAITING and not self._hindrance(now):
            self.state, self.reason, self._activated = GateState.DRIVING, '', None
            self.last_control, self._passed = Control(0.0, self.limits.hold_brake, 0.0), now
        return self._pass(control, now) if self.state is GateState.DRIVING else self.tick(now)

    def refuse(self, reason: str, now: Moment) -> Control:
        """Emergency stop for `reason`, such as a proposal that is not a valid command."""
        self._stop(GateState.EMERGENCY_STOP, reason, now)
        return self.tick(now)

    def observe(self, speed_mps: float, now: Moment, stamp_s: float | None = None) -> None:
        """Speed of an odometry message, signed. A value that is not finite counts as missing odometry.

        stamp_s: of the message; None: now.
        """
        if math.isfinite(speed_mps):
            self._last_odometry = now
            self._believe(self.sense.odometry(Reading(now.ros_s if stamp_s is None else stamp_s, speed_mps)), now)
        if self._last_valid is not None and now.ros_s <= self._last_valid.ros_s:
            self._unclocked += 1

    def vehicle(self, status: VehicleStatus, now: Moment) -> None:
        """An authenticated status of the vehicle's end of `/control/command`."""
        self._heard_activation = max(self._heard_activation, status.activation)
        if self.simulated and status.placed > self._placed and status.ticks < PLACED_TICKS:
            self._forget()
            self._fresh = False
        self._placed = max(self._placed, status.placed)
        if status.speed_mps is not None:
            self._last_status = now
            self._believe(self.sense.status(Reading(status.stamp_ns * 1e-9, status.speed_mps)), now)
        # What it reports may be older than our last activation, which it has then not heard of.
        if status.stopped and status.activation >= self.activation:
            self._stop(GateState.EMERGENCY_STOP, 'the vehicle has stopped by itself; its diagnostics say why', now)

    def _believe(self, contradicted: str, now: Moment) -> None:
        if contradicted:
            self._stop(GateState.EMERGENCY_STOP, f'odometry contradicts {contradicted}: a second publisher?', now)
        elif self._fresh and self.state is GateState.WAITING and self.moves:
            self._stop(GateState.COMFORTABLE_STOP, 'the car moves, and this gate has not driven it', now)

    def clock(self, ros_s: float, now: Moment) -> None:
        """A message of a simulation's clock, whose time two publishers would pull to and fro."""
        jump_s = 0.0 if self._newest_clock_s is None else ros_s - self._newest_clock_s
        self._newest_clock_s = ros_s
        if self.state is GateState.DRIVING and not -self.limits.clock_back_s <= jump_s <= CLOCK_AHEAD_S:
            self._stop(GateState.EMERGENCY_STOP, f'ROS time jumped by {jump_s:.2f} s: a second publisher?', now)

    def override(self, now: Moment, *, by_driver: bool) -> None:
        """The vehicle says whether its driver has taken over."""
        self._overridden = by_driver
        if by_driver and self.state is not GateState.EMERGENCY_STOP:
            self._stop(GateState.HANDED_OVER, 'the driver has taken over', now)

    def publisher_counts(self, counts: Mapping[str, int], now: Moment) -> None:
        """Number of publishers now, by what they publish, in the plural; only one of each may be."""
        names = [name for name, count in counts.items() if count > 1]
        self._crowded = f'more than one publisher of {" and of ".join(names)}' if names else ''
        if self._crowded and self.state is not GateState.WAITING:
            self._stop(GateState.EMERGENCY_STOP, self._crowded, now)

    def activate(self, now: Moment) -> str:
        """Leave a latched stop, so that the next valid proposal drives; returns the reason of a refusal, or ''."""
        if self._crowded:
            return self._crowded
        if self._overridden:
            return 'the driver has taken over'
        if self.state is GateState.DRIVING:
            return 'the car is driving already'
        if not self._knows_speed(now):
            return 'the speed is unknown: no odometry'
        if self.moves:
            return f'the car still drives at {self.speed_mps:.1f} m/s'
        self._forget(keep_speed=True)
        self._fresh, self._activated = False, now
        self.activation = max(self.activation, self._heard_activation) + 1
        self.reason = 're-activated'
        return ''

    def start_over(self, now: Moment) -> str:
        """A simulation begins anew, on a standing car; returns the reason of a refusal, or ''.

        A simulation whose car moves from the start says so in a signed status (`VehicleStatus.placed`).
        """
        if self.state in STOPS and (not self._knows_speed(now) or self.moves):
            return 'the car moves, or its speed is unknown: a stop is not lifted'
        self._forget(keep_speed=True)
        self.reason = 'started over'
        return ''

    def _forget(self, *, keep_speed: bool = False) -> None:
        """Back to waiting, without what the last drive left."""
        self.state, self.reason = GateState.WAITING, 'no proposal yet'
        self._last_valid = self._activated = self._speedless = None
        self._last_stamp_s, self._last_refused, self._unclocked = -math.inf, '', 0
        if not keep_speed:
            self._last_odometry = self._last_status = None
            self.sense.forget()
        self._oscillation.reset()
        self._saturation.reset()

    def tick(self, now: Moment) -> Control:
        """The command now, without a new proposal."""
        self._watch(now)
        match self.state:
            case GateState.DRIVING:
                return self.last_control
            case GateState.WAITING:
                return Control(0.0, self.limits.hold_brake, 0.0)
            case GateState.COMFORTABLE_STOP | GateState.HANDED_OVER:
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
        # Exactly the time that has passed: a floor would let frequent proposals exceed the limits of jerk and steering.
        passed_s = max(0.0, self._clock(now) - self._clock(self._passed))
        dt_s = min(passed_s, self.limits.comfortable_after_s)
        control, names = limited(wanted, self.last_control, self.speed_mps, dt_s, self.motion)
        for name in names:
            self.count(f'limited_{name}')
        self.last_control, self._passed = control, now
        return control

    @property
    def speed_mps(self) -> float | None:
        """The newest speed, signed; None before the first."""
        return self.sense.speed_mps

    @property
    def moves(self) -> bool:
        """Whether the car moves; an unknown speed counts as moving."""
        return self.speed_mps is None or abs(self.speed_mps) > self.limits.standing_mps

    def _knows_speed(self, now: Moment) -> bool:
        """Whether the newest speed is recent enough to rely on."""
        heard = self._last_status if self.sense.signed else self._last_odometry
        return heard is not None and self._since(heard, now) <= self.limits.odometry_after_s

    def _hindrance(self, now: Moment) -> str:
        """What a waiting gate waits for besides a valid proposal, or ''."""
        if self._crowded:
            return f'{self._crowded}; one that has died counts until its lease ends (up to 20 s)'
        if self._overridden:
            return 'the driver has taken over'
        return '' if self._knows_speed(now) else 'no odometry yet'

    def _watch(self, now: Moment) -> None:
        """The reasons for a stop that depend on time or on measurements, not on a new proposal."""
        limits, back_s = self.limits, self._newest_ros_s - now.ros_s
        self._newest_ros_s = now.ros_s
        if self.state is GateState.DRIVING:
            self._watch_driving(now, back_s)
        elif self.state is GateState.WAITING:
            self._watch_waiting(now)
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

    def _watch_waiting(self, now: Moment) -> None:
        hindrance, limits = self._hindrance(now), self.limits
        proposed = self._last_valid is not None and self._since(self._last_valid, now) <= limits.comfortable_after_s
        if self._activated is not None and now.steady_s - self._activated.steady_s > limits.activation_expires_s:
            why = hindrance or 'no valid proposal'
            after = f'activated, but not driving after {limits.activation_expires_s:.0f} s ({why}): activate again'
            self._stop(GateState.EMERGENCY_STOP, after, now)
        elif proposed and not self._knows_speed(now):
            # A moment's silence is how every vehicle starts; a longer one may hide a car that moves.
            self._speedless = self._speedless or now
            if self._since(self._speedless, now) > limits.odometry_after_s:
                self._stop(GateState.COMFORTABLE_STOP, 'no odometry since the gate started', now)
        else:
            self._speedless = None
            self.reason = hindrance or f'no {"valid " if self._activated else ""}proposal yet'

    def _watch_driving(self, now: Moment, back_s: float) -> None:
        limits, speed = self.limits, abs(self.speed_mps or 0.0)
        silent = self._silent(now, limits.comfortable_after_s)
        blind_s = 0.0 if self._last_odometry is None else self._since(self._last_odometry, now)
        unheard_s = 0.0 if self._last_status is None else self._since(self._last_status, now)
        if silent:
            reason = silent
        elif back_s > limits.clock_back_s:
            reason = f'ROS time went back by {back_s:.2f} s'
        elif blind_s > limits.odometry_after_s:
            reason = f'no odometry for {blind_s * 1e3:.0f} ms'
        elif unheard_s > limits.odometry_after_s:
            reason = f'no status of the vehicle for {unheard_s * 1e3:.0f} ms'
        elif speed > self.motion.max_speed_mps + limits.speed_margin_mps:
            reason = f'{speed:.1f} m/s is too fast'
        else:
            return
        self._stop(GateState.COMFORTABLE_STOP, reason, now)

    def _silent(self, now: Moment, after_s: float) -> str:
        """Why the planner counts as silent, or ''."""
        assert self._last_valid is not None
        silent_s = self._since(self._last_valid, now)
        refused = f' ({self._last_refused})' if self._last_refused else ''
        if silent_s > after_s:
            return f'no valid proposal for {silent_s * 1e3:.0f} ms{refused}'
        if self._unclocked > self.limits.frozen_odometry:
            return f'no valid proposal while odometry came {self._unclocked} times and ROS time stood still{refused}'
        return ''

    def _overlook(self, name: str, why: str) -> None:
        """Ignore a proposal, so that it counts as silence; `why` is added to the reason of a stop."""
        self.count(name)
        self._last_refused = why

    def _stop(self, state: GateState, reason: str, now: Moment) -> None:
        if self.state is GateState.EMERGENCY_STOP:
            # Keep the first reason: later ones may be consequences of it.
            return
        self.state, self.reason, self._stopped = state, reason, now
        self._slowed, self._slowed_to_mps = now, abs(self.speed_mps or 0.0)
        self._last_valid = self._last_valid or now
        self.count(state.value)

    def count(self, name: str) -> None:
        """Count an event for the diagnostics."""
        self.counts[name] = self.counts.get(name, 0) + 1

    def _clock(self, now: Moment) -> float:
        return now.steady_s if self.steady else now.ros_s

    def _since(self, then: Moment, now: Moment) -> float:
        """Rounded to 0.1 ms, so that no limit is decided by the rounding error of seconds that count from 1970."""
        return round(self._clock(now) - self._clock(then), 4)
