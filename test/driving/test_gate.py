import math

import pytest

from raw2drive_ros.contract import Control, Decision
from raw2drive_ros.driving.command_policy import CommandPolicy
from raw2drive_ros.driving.gate import Gate, GateState

GO = Decision(0, Control(0.5, 0.0, 0.2))


def driving_gate() -> Gate:
    gate = Gate()
    gate.propose(GO, 0.0)
    return gate


def test_brakes_until_the_first_proposal() -> None:
    gate = Gate()
    assert gate.tick(5.0).brake > 0
    assert gate.state is GateState.WAITING


def test_passes_valid_proposals_unchanged() -> None:
    assert driving_gate().propose(GO, 0.1) == GO.control


def test_holds_the_last_proposal_only_briefly() -> None:
    gate = driving_gate()
    assert gate.tick(0.29) == GO.control
    assert gate.tick(0.31).throttle == 0.0
    assert gate.state is GateState.COMFORTABLE_STOP


def test_comfortable_stop_brakes_gently_and_keeps_the_wheel() -> None:
    gate = driving_gate()
    gate.tick(0.31)
    brakes = [gate.tick(0.31 + 0.05 * i).brake for i in range(9)]
    assert brakes == sorted(brakes)
    assert 0 < brakes[-1] <= gate.limits.comfortable_brake
    assert gate.tick(0.75).steer == GO.control.steer


def test_long_silence_becomes_an_emergency_stop() -> None:
    gate = driving_gate()
    gate.tick(0.4)
    assert gate.tick(0.9).brake == gate.limits.emergency_brake
    assert gate.state is GateState.EMERGENCY_STOP


@pytest.mark.parametrize(
    'control',
    [
        Control(math.nan),
        Control(0.5, math.inf),
        Control(1.2),
        Control(0.5, -0.1),
        Control(0.5, 0.0, -1.01),
    ],
)
def test_an_invalid_proposal_is_an_emergency_and_latched(control) -> None:
    gate = driving_gate()
    answer = gate.propose(Decision(1, control), 0.1)
    assert answer.brake == gate.limits.emergency_brake
    assert math.isfinite(answer.throttle + answer.brake + answer.steer)
    assert gate.propose(GO, 0.2).throttle == 0.0
    assert gate.state is GateState.EMERGENCY_STOP


def test_stops_are_latched_until_re_activation() -> None:
    gate = driving_gate()
    gate.tick(0.4)
    assert gate.propose(GO, 0.45).throttle == 0.0
    gate.activate()
    assert gate.propose(GO, 0.5) == GO.control


def test_missing_commands_are_held_and_then_braked() -> None:
    policy = CommandPolicy(0.3, 0.6)
    assert policy.missing(0).brake == 0.6
    policy.accept(GO.control, 1_000_000_000)
    assert policy.missing(1_200_000_000) == GO.control
    stopping = policy.missing(1_400_000_000)
    assert (stopping.throttle, stopping.brake, stopping.steer) == (0.0, 0.6, 0.2)
    assert policy.missed == 3
