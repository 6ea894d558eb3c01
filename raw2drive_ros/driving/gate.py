"""The safety gate's state machine: pure, without torch, ROS or clocks of its own.

It passes proposals on while they are young, finite and within limits; otherwise it stops the car,
comfortably first, hard when that is not enough, and stays stopped until re-activated.
"""

from __future__ import annotations

import enum
import math
from dataclasses import dataclass, field

from raw2drive_ros.contract import ContractError, Control, Decision


class GateState(enum.Enum):
    """waiting: no proposal yet, brake held. driving: proposals pass. comfortable_stop: silent planner.
    emergency_stop: latched until `activate`."""

    WAITING = 'waiting'
    DRIVING = 'driving'
    COMFORTABLE_STOP = 'comfortable_stop'
    EMERGENCY_STOP = 'emergency_stop'


@dataclass(frozen=True, slots=True)
class GateLimits:
    """Times in seconds; brake is the pedal of each kind of stop. See `params/timing.yaml`."""

    comfortable_after_s: float = 0.3
    emergency_after_s: float = 0.8
    comfortable_brake: float = 0.15
    emergency_brake: float = 0.6
    comfortable_brake_rate_1ps: float = 0.5
    hold_brake: float = 0.3


@dataclass(slots=True)
class Gate:
    """propose() and tick() both return the command to publish now; `now_s` may be any steady clock."""

    limits: GateLimits = field(default_factory=GateLimits)
    state: GateState = GateState.WAITING
    reason: str = 'no proposal yet'
    last_valid_s: float = -math.inf
    last_control: Control = field(default_factory=Control)
    stopped_since_s: float = 0.0
    counts: dict[str, int] = field(default_factory=dict)

    def activate(self) -> None:
        """Leave any stop; the next valid proposal drives."""
        self.state, self.reason = GateState.WAITING, 're-activated'

    def propose(self, decision: Decision, now_s: float) -> Control:
        """Judge a proposal that arrived at `now_s`."""
        if self.state is GateState.EMERGENCY_STOP:
            return self.tick(now_s)
        try:
            control = decision.control.validate()
        except ContractError as error:
            self._stop(GateState.EMERGENCY_STOP, f'invalid proposal: {error}', now_s)
            return self.tick(now_s)
        if self.state is GateState.COMFORTABLE_STOP:
            # Latched as well: a planner that was silent once must be looked at.
            return self.tick(now_s)
        self.state, self.reason = GateState.DRIVING, ''
        self.last_valid_s, self.last_control = now_s, control
        return control

    def tick(self, now_s: float) -> Control:
        """The command at `now_s` without a new proposal."""
        silent_s = now_s - self.last_valid_s
        if self.state is GateState.DRIVING and silent_s > self.limits.comfortable_after_s:
            self._stop(GateState.COMFORTABLE_STOP, f'no valid proposal for {silent_s * 1e3:.0f} ms', now_s)
        if self.state is GateState.COMFORTABLE_STOP and silent_s > self.limits.emergency_after_s:
            self._stop(GateState.EMERGENCY_STOP, f'no valid proposal for {silent_s * 1e3:.0f} ms', now_s)
        if self.state is GateState.DRIVING:
            return self.last_control
        if self.state is GateState.WAITING:
            return Control(0.0, self.limits.hold_brake, 0.0)
        steer = self.last_control.steer
        if self.state is GateState.COMFORTABLE_STOP:
            rising = (now_s - self.stopped_since_s) * self.limits.comfortable_brake_rate_1ps
            return Control(0.0, min(self.limits.comfortable_brake, max(0.0, rising)), steer)
        return Control(0.0, self.limits.emergency_brake, steer)

    def _stop(self, state: GateState, reason: str, now_s: float) -> None:
        self.state, self.reason, self.stopped_since_s = state, reason, now_s
        self.counts[state.value] = self.counts.get(state.value, 0) + 1
