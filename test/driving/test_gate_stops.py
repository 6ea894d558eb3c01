"""The gate's stops: how hard they brake, what happens if that is not enough, and when the car may drive again."""

import pytest
from gate_helpers import WANTED, at, driving_gate, proposal

from raw2drive_ros.contracts.public import Control
from raw2drive_ros.driving.gate_state import GateState


def test_comfortable_stop_brakes_gently_and_keeps_the_wheel() -> None:
    gate = driving_gate()
    gate.tick(at(0.31))
    assert gate.tick(at(0.41)).brake == pytest.approx(0.05)
    brakes = [gate.tick(at(0.31 + 0.05 * i)).brake for i in range(9)]
    assert brakes == sorted(brakes)
    assert brakes[-1] == gate.limits.comfortable_brake
    assert gate.tick(at(0.75)).steer == WANTED.steer


@pytest.mark.parametrize(('braked', 'expected'), [(0.1, 0.6), (0.9, 0.9)])
def test_a_stop_never_brakes_less_than_the_planner_did(braked, expected) -> None:
    gate = driving_gate()
    gate.propose(proposal(0.1, Control(0.0, braked, 0.0)), at(0.1))
    assert gate.tick(at(0.45)).brake == braked
    assert gate.tick(at(1.0)).brake == expected


@pytest.mark.parametrize(
    ('speeds', 'state'),
    [((5.0, 4.5), GateState.COMFORTABLE_STOP), ((5.0, 4.6), GateState.EMERGENCY_STOP), ((0.6, 0.3), None)],
)
def test_a_car_that_does_not_slow_down_is_braked_hard(speeds, state) -> None:
    gate = driving_gate()
    gate.observe(speeds[0], at(0.0))
    gate.tick(at(0.31))
    assert gate.state is GateState.COMFORTABLE_STOP
    for i in range(4, 24):
        # Valid proposals come again, which does not end the stop.
        gate.propose(proposal(0.1 * i), at(0.1 * i))
        gate.observe(speeds[1], at(0.1 * i))
    gate.tick(at(2.31))
    assert gate.state is GateState.COMFORTABLE_STOP
    gate.tick(at(2.32))
    assert gate.state is (state or GateState.COMFORTABLE_STOP)
    if state is GateState.EMERGENCY_STOP:
        assert gate.reason == 'the car does not slow down'


@pytest.mark.parametrize(('until', 'state'), [(51, GateState.COMFORTABLE_STOP), (52, GateState.EMERGENCY_STOP)])
def test_brakes_that_fade_after_a_while_are_noticed(until, state) -> None:
    gate = driving_gate()
    gate.observe(5.0, at(0.0))
    gate.tick(at(0.31))
    for i in range(4, until):
        # The speed falls by 0.5 m/s each second until 3 s, and stays constant from then on.
        gate.propose(proposal(0.1 * i), at(0.1 * i))
        gate.observe(5.0 - 0.05 * min(i, 30), at(0.1 * i))
        gate.tick(at(0.1 * i))
    assert gate.state is state


def test_a_stop_without_odometry_depends_on_time_alone() -> None:
    gate = driving_gate()
    gate.tick(at(0.31))
    for i in range(4, 60):
        gate.propose(proposal(0.1 * i), at(0.1 * i))
    assert gate.state is GateState.COMFORTABLE_STOP
    # The first odometry: the speed before the stop is unknown, so the car has to stand by now.
    gate.observe(0.4, at(6.0))
    gate.tick(at(6.0))
    assert gate.reason == 'the car does not slow down'


def test_two_publishers_stop_and_keep_the_gate_from_starting() -> None:
    gate = driving_gate()
    gate.publisher_counts({'proposals': 1, 'commands': 1}, at(0.1))
    assert gate.state is GateState.DRIVING
    gate.publisher_counts({'proposals': 2, 'commands': 1}, at(0.1))
    assert gate.state is GateState.EMERGENCY_STOP
    assert gate.reason == 'more than one publisher of proposals'
    assert gate.activate(at(0.2)) == 'more than one publisher of proposals'
    gate.publisher_counts({'proposals': 1, 'commands': 1}, at(0.2))
    assert gate.activate(at(0.2)) == ''
    gate.publisher_counts({'proposals': 2, 'commands': 3}, at(0.3))
    assert gate.state is GateState.WAITING
    assert gate.propose(proposal(0.3), at(0.3)).throttle == 0.0
    assert gate.activate(at(0.3)) == 'more than one publisher of proposals and of commands'
    assert gate.reason.endswith('one that has died counts until its lease ends (up to 20 s)')


def test_stops_are_latched_until_re_activation() -> None:
    gate = driving_gate()
    gate.tick(at(0.4))
    assert gate.propose(proposal(0.45), at(0.45)).throttle == 0.0
    assert gate.activate(at(0.46)) == ''
    assert gate.reason == 're-activated'
    assert gate.tick(at(0.46)).throttle == 0.0
    assert gate.propose(proposal(0.1), at(0.3)) == WANTED, 'a new start does not look at old stamps'


def test_a_stop_changes_no_gear() -> None:
    gate = driving_gate()
    gate.propose(proposal(0.1, Control(0.2, 0.0, 0.0, reverse=True)), at(0.1))
    assert gate.refuse('x', at(0.2)) == Control(0.0, 0.6, 0.0, reverse=True)


def test_a_moving_car_is_not_re_activated() -> None:
    gate = driving_gate()
    gate.observe(-0.4, at(0.1))
    gate.refuse('x', at(0.2))
    assert gate.activate(at(0.2)) == 'the car still drives at -0.4 m/s'
    gate.observe(0.3, at(0.3))
    assert gate.activate(at(0.3)) == ''
    gate.propose(proposal(0.4), at(0.4))
    gate.observe(3.0, at(0.4))
    assert gate.activate(at(0.4)) == 'the car is driving already'
    assert gate.state is GateState.DRIVING
    assert gate.tick(at(0.5)) == gate.last_control, 'nothing changes for a car that drives'


def test_re_activation_forgets_swings_and_lock() -> None:
    gate = driving_gate()
    gate.observe(0.0, at(0.0))
    for i in range(1, 11):
        gate.propose(proposal(i * 0.1, Control(0.0, 0.0, 1.0 if i % 2 else -1.0)), at(i * 0.1))
        gate.observe(0.0, at(i * 0.1))
    assert gate.activate(at(1.0)) == ''
    lock = Control(0.0, 0.0, -1.0)
    gate.propose(proposal(1.1, lock), at(1.1))
    assert gate.tick(at(1.39)) == lock
    assert gate.state is GateState.DRIVING
