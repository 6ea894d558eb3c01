"""What the gate passes on and what stops the car: valid, invalid and limited proposals, any order of events."""

import math

import pytest
from gate_helpers import WANTED, at, drive, driving_gate, proposal
from hypothesis import given, settings
from hypothesis import strategies as st

from raw2drive_ros.contracts.public import Control, VehicleStatus
from raw2drive_ros.driving.gate import Gate
from raw2drive_ros.driving.gate_limits import MotionLimits
from raw2drive_ros.driving.gate_state import GateLimits, GateState, Moment


def test_brakes_until_the_first_proposal() -> None:
    gate = Gate()
    assert gate.tick(at(5.0)) == Control(0.0, gate.limits.hold_brake, 0.0)
    assert gate.state is GateState.WAITING
    assert gate.reason == 'no odometry yet'
    gate.observe(0.0, at(5.1))
    gate.tick(at(5.1))
    assert gate.reason == 'no proposal yet'


def test_passes_valid_proposals_unchanged() -> None:
    gate = driving_gate()
    assert gate.propose(proposal(0.1), at(0.1)) is not None
    assert gate.tick(at(0.15)) == WANTED
    assert gate.reason == ''
    assert gate.counts == {}


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
def test_an_invalid_proposal_is_a_latched_emergency_stop(control, first) -> None:
    gate = Gate() if first else driving_gate()
    answer = gate.propose(proposal(0.1, control), at(0.1))
    assert answer.brake == gate.limits.emergency_brake
    assert answer.throttle == 0.0
    assert math.isfinite(answer.steer)
    assert gate.propose(proposal(0.2), at(0.2)).throttle == 0.0
    assert gate.state is GateState.EMERGENCY_STOP
    assert gate.reason.startswith('invalid proposal: Control')


def test_a_refused_message_is_an_emergency_stop_and_the_first_reason_stays() -> None:
    gate = driving_gate()
    assert gate.refuse('no field brake', at(0.1)).brake == gate.limits.emergency_brake
    gate.refuse('something else', at(0.2))
    assert gate.reason == 'no field brake'
    assert gate.counts == {'emergency_stop': 1}


@pytest.mark.parametrize(('speed', 'stops'), [(-12.0, False), (12.0, False), (12.1, True), (-12.1, True)])
def test_a_car_that_is_far_too_fast_is_stopped(speed, stops) -> None:
    gate = driving_gate(motion=MotionLimits(max_speed_mps=10.0))
    gate.observe(speed, at(0.1))
    gate.tick(at(0.1))
    assert (gate.state is GateState.COMFORTABLE_STOP) is stops
    assert gate.reason == ('12.1 m/s is too fast' if stops else '')


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
    gate.observe(3.0, at(0.1))
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


def test_limits_are_counted_and_the_limited_command_is_held() -> None:
    gate = driving_gate(motion=MotionLimits(max_acceleration_mps2=2.0))
    answer = gate.propose(proposal(0.1), at(0.1))
    assert answer == Control(0.4, 0.0, 0.2)
    assert gate.tick(at(0.2)) == answer
    assert gate.counts == {'limited_acceleration': 2}


def test_the_first_command_is_rate_limited_from_the_held_brake() -> None:
    gate = Gate(motion=MotionLimits(max_jerk_mps3=10.0, max_steer_rate_1ps=1.0))
    gate.observe(0.0, at(0.0))
    wanted = Control(1.0, 0.0, 1.0)
    # No time has passed since the brake was held.
    assert gate.propose(proposal(0.0, wanted), at(0.0)) == Control(0.0, gate.limits.hold_brake, 0.0)
    answer = gate.propose(proposal(0.1, wanted), at(0.1))
    assert answer.throttle == 0.0
    assert answer.brake == pytest.approx(gate.limits.hold_brake - 1.0 / 8.0)
    assert answer.steer == pytest.approx(0.1)


@pytest.mark.parametrize('rate_hz', [100.0, 10_000.0, 1e6])
def test_frequent_proposals_do_not_exceed_the_limits_of_jerk_and_steering_rate(rate_hz) -> None:
    limits = GateLimits(odometry_after_s=math.inf)
    gate = driving_gate(limits=limits, motion=MotionLimits(max_jerk_mps3=10.0, max_steer_rate_1ps=1.0))
    first = gate.last_control
    for i in range(2001):
        now_s = i / rate_hz
        answer = gate.propose(proposal(now_s, Control(0.0, 1.0, 1.0)), at(now_s))
    passed_s = 2000 / rate_hz
    assert answer.steer <= min(1.0, first.steer + passed_s) + 1e-9
    # Full brakes are 8 m/s2: a jerk of 10 m/s3 raises the pedal by 1.25 per second.
    assert answer.brake <= min(1.0, first.brake + 1.25 * passed_s) + 1e-9


def test_an_absurd_speed_stops_the_car() -> None:
    gate = driving_gate(motion=MotionLimits(max_speed_mps=10.0, max_lateral_mps2=3.0))
    gate.vehicle(VehicleStatus(100_000_000, -1e200), at(0.1))
    gate.propose(proposal(0.1), at(0.1))
    gate.tick(at(0.1))
    assert gate.state is GateState.COMFORTABLE_STOP
    assert gate.reason.endswith('is too fast')


def test_limits_use_the_measured_speed() -> None:
    gate = driving_gate(motion=MotionLimits(max_speed_mps=10.0))
    gate.observe(10.1, at(0.1))
    assert gate.propose(proposal(0.1), at(0.1)) == Control(0.0, 0.0, WANTED.steer)
    assert gate.counts == {'limited_speed': 1}


def test_rates_are_measured_over_the_time_between_commands() -> None:
    gate = driving_gate(motion=MotionLimits(max_steer_rate_1ps=1.0))
    assert gate.propose(proposal(0.1, Control(0.0, 0.0, 1.0)), at(0.1)).steer == pytest.approx(0.1)
    assert gate.propose(proposal(0.3, Control(0.0, 0.0, 1.0)), at(0.3)).steer == pytest.approx(0.3)


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
            gate.observe(steer * 20.0, now, stamp_s=10.0 * now_s)
        elif kind in ('crowd', 'calm'):
            gate.publisher_counts({'proposals': 2 if kind == 'crowd' else 1}, now)
        elif kind == 'activate':
            stopped = stopped and gate.activate(now) != ''
        control = control or gate.tick(now)
        control.validate()
        stopped = stopped or gate.state in (GateState.COMFORTABLE_STOP, GateState.EMERGENCY_STOP)
        clock_s = now_s if steady else ros_s
        if stopped or clock_s - valid_s > limits.comfortable_after_s + 1e-6:
            assert control.throttle == 0.0, (gate.state, gate.reason)
        if gate.state is GateState.EMERGENCY_STOP:
            assert control.brake >= limits.emergency_brake
