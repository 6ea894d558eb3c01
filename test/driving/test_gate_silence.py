"""The gate and time: missing, late or out-of-order proposals, clocks that freeze or go back, missing odometry."""

import math

import pytest
from gate_helpers import WANTED, at, drive, driving_gate, proposal

from raw2drive_ros.contracts.public import Control
from raw2drive_ros.driving.gate import Gate
from raw2drive_ros.driving.gate_state import GateLimits, GateState, Moment


@pytest.mark.parametrize('steady', [True, False])
def test_holds_the_last_proposal_only_briefly(steady) -> None:
    gate = driving_gate(steady=steady)
    assert gate.tick(at(0.3)) == WANTED
    assert gate.tick(at(0.31)).throttle == 0.0
    assert gate.state is GateState.COMFORTABLE_STOP
    assert gate.reason == 'no valid proposal for 310 ms'


def test_long_silence_becomes_an_emergency_stop() -> None:
    gate = driving_gate()
    gate.tick(at(0.4))
    assert gate.tick(at(0.8)).brake < gate.limits.emergency_brake
    assert gate.tick(at(0.81)) == Control(0.0, gate.limits.emergency_brake, WANTED.steer)
    assert gate.state is GateState.EMERGENCY_STOP
    assert gate.counts == {'comfortable_stop': 1, 'emergency_stop': 1}
    assert gate.reason == 'no valid proposal for 810 ms'


@pytest.mark.parametrize(('offset', 'name'), [(0.31, 'late'), (-0.31, 'early')])
@pytest.mark.parametrize('steady', [True, False])
def test_proposals_with_stale_or_future_stamps_count_as_silence(offset, name, steady) -> None:
    gate = driving_gate(steady=steady)
    for now_s in (0.1, 0.2, 0.29):
        assert gate.propose(proposal(now_s - offset), at(now_s)) == WANTED
    gate.propose(proposal(0.31 - offset), at(0.31))
    assert gate.state is GateState.COMFORTABLE_STOP
    assert f'{offset:.2f} s old' in gate.reason
    assert gate.counts[name] == 4


def test_a_proposal_exactly_at_the_age_limit_passes() -> None:
    gate = driving_gate()
    other = Control(0.1)
    assert gate.propose(proposal(0.0, other), at(0.3)) == other
    assert gate.propose(proposal(0.7, WANTED), at(0.4)) == WANTED, 'or just as early'


def test_proposals_out_of_order_are_ignored() -> None:
    gate = driving_gate()
    drive(gate, 0.1, 2)
    assert gate.propose(proposal(0.1, Control(1.0)), at(0.25)) == WANTED
    assert gate.counts == {'out_of_order': 1}
    assert gate.propose(proposal(0.2, Control(1.0)), at(0.25)) == Control(1.0), 'the same tick once more is an answer'
    gate.propose(proposal(0.1), at(0.4))
    gate.tick(at(0.56))
    assert gate.reason == 'no valid proposal for 310 ms (the last one is older than the one before)'


def test_in_lock_step_a_proposal_may_overtake_its_clock() -> None:
    gate = driving_gate(steady=False)
    gate.propose(proposal(0.2), at(0.0))
    assert gate.tick(at(0.1)) == WANTED
    assert gate.tick(at(0.5)) == WANTED
    gate.tick(at(0.51))
    assert gate.state is GateState.COMFORTABLE_STOP


def test_a_slow_simulation_is_not_silence() -> None:
    gate = driving_gate(steady=False)
    assert gate.tick(Moment(1010.0, 0.05)) == WANTED
    assert gate.tick(Moment(1060.0, 0.05)) == WANTED


def test_a_paused_simulation_drives_on_afterwards() -> None:
    gate = driving_gate(steady=False)
    gate.observe(3.0, at(0.0))
    assert gate.tick(Moment(2000.0, 0.0)) == WANTED
    gate.observe(3.0, Moment(2000.0, 0.1))
    assert gate.propose(proposal(0.1), Moment(2000.0, 0.1)) == WANTED


def test_a_car_that_moves_on_while_ros_time_stands_is_stopped() -> None:
    gate = driving_gate(steady=False)
    for i in range(20):
        gate.observe(0.0, Moment(1000.0 + 0.05 * i, 0.0), stamp_s=0.05 * i)
    gate.propose(proposal(0.0), Moment(1001.0, 0.0))
    for i in range(20):
        gate.observe(3.0, Moment(1001.0 + 0.05 * i, 0.0), stamp_s=1.0 + 0.05 * i)
    assert gate.tick(Moment(1002.0, 0.0)) == WANTED
    gate.observe(3.0, Moment(1002.0, 0.0), stamp_s=2.0)
    gate.tick(Moment(1002.0, 0.0))
    assert gate.state is GateState.EMERGENCY_STOP
    assert gate.reason == 'no valid proposal while odometry came 21 times and ROS time stood still'
    gate.observe(0.0, Moment(1002.0, 0.0), stamp_s=3.0)
    assert gate.activate(Moment(1002.0, 0.0)) == ''
    gate.propose(proposal(0.0), Moment(1003.0, 0.0))
    gate.tick(Moment(1003.0, 0.0))
    assert gate.state is GateState.DRIVING


def test_on_a_car_a_standing_ros_clock_does_not_hide_silence() -> None:
    gate = driving_gate()
    gate.tick(Moment(1000.31, 0.0))
    assert gate.state is GateState.COMFORTABLE_STOP


@pytest.mark.parametrize(('back_s', 'stops'), [(0.04, False), (0.06, True)])
def test_ros_time_that_goes_back_stops(back_s, stops) -> None:
    gate = driving_gate()
    gate.tick(at(0.1))
    gate.tick(Moment(1000.15, 0.1 - back_s))
    assert (gate.state is GateState.COMFORTABLE_STOP) is stops
    assert gate.reason == ('ROS time went back by 0.06 s' if stops else '')


def test_time_that_went_back_while_waiting_is_forgotten() -> None:
    gate = Gate()
    gate.tick(at(50.0))
    gate.tick(at(1.0))
    gate.observe(0.0, at(1.0))
    gate.propose(proposal(1.0), at(1.0))
    gate.tick(at(1.05))
    assert gate.state is GateState.DRIVING


def test_odometry_once_heard_must_go_on() -> None:
    gate = driving_gate(limits=GateLimits())
    gate.observe(5.0, at(0.0))
    drive(gate, 0.1, 5)
    gate.tick(at(0.5))
    assert gate.state is GateState.DRIVING
    gate.observe(math.nan, at(0.5))
    gate.tick(at(0.51))
    assert gate.state is GateState.COMFORTABLE_STOP
    assert gate.reason == 'no odometry for 510 ms'
