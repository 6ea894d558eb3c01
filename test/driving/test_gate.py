"""The gate's state machine: what drives, what stops, how hard, and what lets it drive again."""

import math

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from raw2drive_ros.contract import Control, Decision
from raw2drive_ros.driving.gate import Gate, GateLimits, GateState, Moment
from raw2drive_ros.driving.gate_limits import MotionLimits

WANTED = Control(0.5, 0.0, 0.2)
PERIOD_S = 0.1


def at(seconds: float) -> Moment:
    """Both clocks run alike; the steady one has its own zero."""
    return Moment(seconds + 1000.0, seconds)


def proposal(seconds: float, control: Control = WANTED) -> Decision:
    return Decision(round(seconds * 1e9), control)


def driving_gate(**options) -> Gate:
    gate = Gate(**options)
    gate.propose(proposal(0.0), at(0.0))
    assert gate.state is GateState.DRIVING
    return gate


def drive(gate: Gate, start_s: float, ticks: int, control: Control = WANTED) -> Control:
    answer = control
    for i in range(ticks):
        now_s = start_s + i * PERIOD_S
        answer = gate.propose(proposal(now_s, control), at(now_s))
    return answer


def test_brakes_until_the_first_proposal() -> None:
    gate = Gate()
    assert gate.tick(at(5.0)) == Control(0.0, gate.limits.hold_brake, 0.0)
    assert gate.state is GateState.WAITING
    assert gate.reason == 'no proposal yet'


def test_passes_valid_proposals_unchanged() -> None:
    gate = driving_gate()
    assert gate.propose(proposal(0.1), at(0.1)) is not None
    assert gate.tick(at(0.15)) == WANTED
    assert gate.reason == ''
    assert gate.counts == {}


@pytest.mark.parametrize('steady', [True, False])
def test_holds_the_last_proposal_only_briefly(steady) -> None:
    gate = driving_gate(steady=steady)
    assert gate.tick(at(0.3)) == WANTED
    assert gate.tick(at(0.31)).throttle == 0.0
    assert gate.state is GateState.COMFORTABLE_STOP
    assert gate.reason == 'no valid proposal for 310 ms'


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


def test_long_silence_becomes_an_emergency_stop() -> None:
    gate = driving_gate()
    gate.tick(at(0.4))
    assert gate.tick(at(0.8)).brake < gate.limits.emergency_brake
    assert gate.tick(at(0.81)) == Control(0.0, gate.limits.emergency_brake, WANTED.steer)
    assert gate.state is GateState.EMERGENCY_STOP
    assert gate.counts == {'comfortable_stop': 1, 'emergency_stop': 1}
    assert gate.reason == 'no valid proposal for 810 ms'


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
@pytest.mark.parametrize('first', [True, False])
def test_an_invalid_proposal_is_an_emergency_and_latched(control, first) -> None:
    gate = Gate() if first else driving_gate()
    answer = gate.propose(proposal(0.1, control), at(0.1))
    assert answer.brake == gate.limits.emergency_brake
    assert answer.throttle == 0.0
    assert math.isfinite(answer.steer)
    assert gate.propose(proposal(0.2), at(0.2)).throttle == 0.0
    assert gate.state is GateState.EMERGENCY_STOP
    assert gate.reason.startswith('invalid proposal: Control')


def test_a_message_that_is_no_command_is_an_emergency_and_its_reason_stays() -> None:
    gate = driving_gate()
    assert gate.refuse('no field brake', at(0.1)).brake == gate.limits.emergency_brake
    gate.refuse('something else', at(0.2))
    assert gate.reason == 'no field brake'
    assert gate.counts == {'emergency_stop': 1}


@pytest.mark.parametrize(('offset', 'name'), [(0.31, 'late'), (-0.31, 'early')])
@pytest.mark.parametrize('steady', [True, False])
def test_proposals_from_another_time_count_as_silence(offset, name, steady) -> None:
    gate = driving_gate(steady=steady)
    for now_s in (0.1, 0.2, 0.29):
        assert gate.propose(proposal(now_s - offset), at(now_s)) == WANTED
    gate.propose(proposal(0.31 - offset), at(0.31))
    assert gate.state is GateState.COMFORTABLE_STOP
    assert f'{offset:.2f} s old' in gate.reason
    assert gate.counts[name] == 4


def test_a_proposal_of_just_that_age_passes() -> None:
    gate = driving_gate()
    other = Control(0.1)
    assert gate.propose(proposal(0.0, other), at(0.3)) == other
    assert gate.propose(proposal(0.7, WANTED), at(0.4)) == WANTED, 'or just as early'


def test_proposals_out_of_order_are_not_driven_by() -> None:
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


def test_a_slow_simulation_is_not_silence_but_a_clock_that_never_starts_is() -> None:
    gate = driving_gate(steady=False)
    assert gate.tick(Moment(1010.0, 0.05)) == WANTED
    gate.tick(Moment(1010.1, 0.05))
    assert gate.state is GateState.EMERGENCY_STOP
    assert gate.reason == 'no valid proposal for 10.1 s, and ROS time advanced by 0.05 s'
    assert gate.counts == {'comfortable_stop': 1, 'emergency_stop': 1}


def test_a_paused_simulation_drives_on_afterwards() -> None:
    gate = driving_gate(steady=False)
    gate.observe(3.0, at(0.0))
    assert gate.tick(Moment(2000.0, 0.0)) == WANTED
    gate.observe(3.0, Moment(2000.0, 0.1))
    assert gate.propose(proposal(0.1), Moment(2000.0, 0.1)) == WANTED


def test_a_car_that_moves_on_while_ros_time_stands_is_stopped() -> None:
    gate = driving_gate(steady=False)
    for i in range(20):
        gate.observe(3.0, Moment(1000.0 + 0.05 * i, 0.0))
    gate.propose(proposal(0.0), Moment(1001.0, 0.0))
    for i in range(20):
        gate.observe(3.0, Moment(1001.0 + 0.05 * i, 0.0))
    assert gate.tick(Moment(1002.0, 0.0)) == WANTED
    gate.observe(3.0, Moment(1002.0, 0.0))
    gate.tick(Moment(1002.0, 0.0))
    assert gate.state is GateState.EMERGENCY_STOP
    assert gate.reason == 'no valid proposal while odometry came 21 times and ROS time stood still'
    gate.observe(0.0, Moment(1002.0, 0.0))
    assert gate.activate() == ''
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
    gate.propose(proposal(1.0), at(1.0))
    gate.tick(at(1.05))
    assert gate.state is GateState.DRIVING


def test_odometry_once_heard_must_go_on() -> None:
    gate = driving_gate()
    gate.observe(5.0, at(0.0))
    drive(gate, 0.1, 5)
    gate.tick(at(0.5))
    assert gate.state is GateState.DRIVING
    gate.observe(math.nan, at(0.5))
    gate.tick(at(0.51))
    assert gate.state is GateState.COMFORTABLE_STOP
    assert gate.reason == 'no odometry for 510 ms'


@pytest.mark.parametrize(('speed', 'stops'), [(-12.0, False), (12.0, False), (12.1, True), (-12.1, True)])
def test_a_car_that_is_far_too_fast_is_stopped(speed, stops) -> None:
    gate = driving_gate(motion=MotionLimits(max_speed_mps=10.0))
    gate.observe(speed, at(0.1))
    gate.tick(at(0.1))
    assert (gate.state is GateState.COMFORTABLE_STOP) is stops
    assert gate.reason == ('12.1 m/s is too fast' if stops else '')


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
        # The planner is back, which does not end the stop.
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
        # Half a metre per second slower by every second until 3 s, and no more from then on.
        gate.propose(proposal(0.1 * i), at(0.1 * i))
        gate.observe(5.0 - 0.05 * min(i, 30), at(0.1 * i))
        gate.tick(at(0.1 * i))
    assert gate.state is state


def test_a_stop_without_odometry_goes_by_time_alone() -> None:
    gate = driving_gate()
    gate.tick(at(0.31))
    for i in range(4, 60):
        gate.propose(proposal(0.1 * i), at(0.1 * i))
    assert gate.state is GateState.COMFORTABLE_STOP
    # Heard for the first time: nobody knows how fast it was, so that it has to stand by now.
    gate.observe(0.4, at(6.0))
    gate.tick(at(6.0))
    assert gate.reason == 'the car does not slow down'


def test_a_wheel_that_swings_to_and_fro_stops() -> None:
    gate = driving_gate()
    for i in range(1, 30):
        if gate.state is not GateState.DRIVING:
            break
        gate.propose(proposal(i * 0.1, Control(0.2, 0.0, 0.5 if i % 2 else -0.5)), at(i * 0.1))
    assert gate.state is GateState.COMFORTABLE_STOP
    assert gate.reason == 'steering swings to and fro 10 times'
    assert i == 12, 'by the eleventh proposal'


def test_a_wheel_held_at_full_lock_stops() -> None:
    gate = driving_gate()
    drive(gate, 1.0 - 0.8, 51, Control(0.2, 0.0, -1.0))
    assert gate.state is GateState.DRIVING
    gate.propose(proposal(5.3, Control(0.2, 0.0, -1.0)), at(5.3))
    assert gate.state is GateState.COMFORTABLE_STOP
    assert gate.reason == 'full lock for 5 s'


def test_a_standing_car_may_hold_full_lock() -> None:
    gate = driving_gate()
    for i in range(80):
        gate.observe(0.3, at(0.1 * i))
        gate.propose(proposal(0.1 * i, Control(0.0, 0.0, 1.0)), at(0.1 * i))
    assert gate.state is GateState.DRIVING


def test_two_publishers_stop_and_keep_the_gate_from_starting() -> None:
    gate = driving_gate()
    gate.publisher_counts(1, 1, at(0.1))
    assert gate.state is GateState.DRIVING
    gate.publisher_counts(2, 1, at(0.1))
    assert gate.state is GateState.EMERGENCY_STOP
    assert gate.reason == 'more than one publisher of proposals'
    assert gate.activate() == 'more than one publisher of proposals'
    gate.publisher_counts(1, 1, at(0.2))
    assert gate.activate() == ''
    gate.publisher_counts(2, 3, at(0.3))
    assert gate.state is GateState.WAITING
    assert gate.propose(proposal(0.3), at(0.3)).throttle == 0.0
    assert gate.activate() == 'more than one publisher of proposals and of commands'


def test_stops_are_latched_until_re_activation() -> None:
    gate = driving_gate()
    gate.tick(at(0.4))
    assert gate.propose(proposal(0.45), at(0.45)).throttle == 0.0
    assert gate.activate() == ''
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
    assert gate.activate() == 'the car still drives at -0.4 m/s'
    gate.observe(0.3, at(0.3))
    assert gate.activate() == ''
    gate.propose(proposal(0.4), at(0.4))
    gate.observe(3.0, at(0.4))
    assert gate.activate() == 'the car is driving already'
    assert gate.state is GateState.DRIVING
    assert gate.tick(at(0.5)) == gate.last_control, 'nothing changes for a car that drives'


def test_re_activation_forgets_swings_lock_and_odometry() -> None:
    gate = driving_gate()
    gate.observe(0.0, at(0.0))
    for i in range(1, 11):
        gate.propose(proposal(i * 0.1, Control(0.0, 0.0, 1.0 if i % 2 else -1.0)), at(i * 0.1))
        gate.observe(0.0, at(i * 0.1))
    assert gate.activate() == ''
    lock = Control(0.0, 0.0, -1.0)
    gate.propose(proposal(1.1, lock), at(1.1))
    assert gate.tick(at(1.39)) == lock
    assert gate.state is GateState.DRIVING


def test_limits_are_counted_and_their_result_is_what_is_held() -> None:
    gate = driving_gate(motion=MotionLimits(max_acceleration_mps2=2.0))
    answer = gate.propose(proposal(0.1), at(0.1))
    assert answer == Control(0.4, 0.0, 0.2)
    assert gate.tick(at(0.2)) == answer
    assert gate.counts == {'limited_acceleration': 2}


def test_the_first_command_counts_from_the_brake_that_was_held() -> None:
    gate = Gate(motion=MotionLimits(max_jerk_mps3=10.0, max_steer_rate_1ps=1.0))
    answer = gate.propose(proposal(0.0, Control(1.0, 0.0, 1.0)), at(0.0))
    assert answer.throttle == 0.0
    # Two pedals' rates and one wheel's for a millisecond.
    assert answer.brake == pytest.approx(gate.limits.hold_brake - 0.01 / 8.0)
    assert answer.steer == pytest.approx(0.001)


def test_an_absurd_speed_stops_the_car() -> None:
    gate = driving_gate(motion=MotionLimits(max_speed_mps=10.0, max_lateral_mps2=3.0))
    gate.observe(-1e200, at(0.1))
    gate.propose(proposal(0.1), at(0.1))
    gate.tick(at(0.1))
    assert gate.state is GateState.COMFORTABLE_STOP
    assert gate.reason.endswith('is too fast')


def test_limits_know_the_speed() -> None:
    gate = driving_gate(motion=MotionLimits(max_speed_mps=10.0))
    gate.observe(10.1, at(0.1))
    assert gate.propose(proposal(0.1), at(0.1)) == Control(0.0, 0.0, WANTED.steer)
    assert gate.counts == {'limited_speed': 1}


def test_rates_are_measured_over_the_time_between_commands() -> None:
    gate = driving_gate(motion=MotionLimits(max_steer_rate_1ps=1.0))
    assert gate.propose(proposal(0.1, Control(0.0, 0.0, 1.0)), at(0.1)).steer == pytest.approx(0.101)
    assert gate.propose(proposal(0.3, Control(0.0, 0.0, 1.0)), at(0.3)).steer == pytest.approx(0.301)


EVENTS = st.lists(
    st.tuples(
        st.sampled_from(['propose', 'late', 'tick', 'nan', 'observe', 'crowd', 'calm', 'activate', 'pause', 'garbage']),
        st.floats(0.0, 1.0),
        st.floats(-1.0, 1.0),
    ),
    max_size=60,
)


@settings(deadline=None, max_examples=300)
@given(EVENTS, st.booleans())
def test_whatever_happens_the_command_is_valid_and_silence_stops_the_car(events, steady) -> None:
    limits = GateLimits()
    motion = MotionLimits(max_speed_mps=10.0, max_jerk_mps3=20.0, max_steer_rate_1ps=2.0, max_lateral_mps2=3.0)
    gate = Gate(limits, motion, steady)
    now_s = ros_s = 0.0
    valid_s = -math.inf
    stopped = False
    for kind, size, steer in events:
        now_s += 0.2 * size
        ros_s += 0.0 if kind == 'pause' else 0.2 * size
        now = Moment(now_s, ros_s)
        control = None
        if kind == 'propose':
            control = gate.propose(proposal(ros_s, Control(size, 0.0, steer)), now)
            valid_s = now_s if steady else ros_s
        elif kind == 'late':
            control = gate.propose(proposal(ros_s - 1.0, Control(1.0)), now)
        elif kind == 'nan':
            control = gate.propose(proposal(ros_s, Control(math.nan)), now)
        elif kind == 'garbage':
            control = gate.refuse('garbage', now)
        elif kind == 'observe':
            gate.observe(steer * 20.0, now)
        elif kind in ('crowd', 'calm'):
            gate.publisher_counts(2 if kind == 'crowd' else 1, 1, now)
        elif kind == 'activate':
            stopped = stopped and gate.activate() != ''
        control = control or gate.tick(now)
        control.validate()
        stopped = stopped or gate.state in (GateState.COMFORTABLE_STOP, GateState.EMERGENCY_STOP)
        clock_s = now_s if steady else ros_s
        if stopped or clock_s - valid_s > limits.comfortable_after_s + 1e-6:
            assert control.throttle == 0.0, (gate.state, gate.reason)
        if gate.state is GateState.EMERGENCY_STOP:
            assert control.brake >= limits.emergency_brake
