"""Shared by the tests of the gate: both clocks, proposals, a gate that drives."""

import math

from raw2drive_ros.contracts.public import Control, Decision
from raw2drive_ros.driving.gate import Gate
from raw2drive_ros.driving.gate_state import GateLimits, GateState, Moment

WANTED = Control(0.5, 0.0, 0.2)

PERIOD_S = 0.1


def at(seconds: float) -> Moment:
    """Both clocks advance together; the steady one has another origin."""
    return Moment(seconds + 1000.0, seconds)


def proposal(seconds: float, control: Control = WANTED) -> Decision:
    return Decision(round(seconds * 1e9), control)


def driving_gate(**options) -> Gate:
    """A gate that drives a car which stood a second ago; silent odometry stops it only where `limits` say so."""
    gate = Gate(**{'limits': GateLimits(odometry_after_s=math.inf)} | options)
    gate.observe(0.0, at(0.0), stamp_s=-1.0)
    gate.propose(proposal(0.0), at(0.0))
    assert gate.state is GateState.DRIVING
    return gate


def drive(gate: Gate, start_s: float, ticks: int, control: Control = WANTED) -> Control:
    answer = control
    for i in range(ticks):
        now_s = start_s + i * PERIOD_S
        answer = gate.propose(proposal(now_s, control), at(now_s))
    return answer
