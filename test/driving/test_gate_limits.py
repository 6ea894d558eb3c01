"""Limits of the gate one by one: what changes a command and by how much, and what does not."""

import math
from collections import deque

import pytest
from hypothesis import given
from hypothesis import strategies as st

from raw2drive_ros.contracts.public import Control
from raw2drive_ros.driving.gate_limits import MotionLimits, limited
from raw2drive_ros.driving.gate_monitors import Oscillation, Saturation

STILL = Control()
DT_S = 0.1


def one(wanted: Control, before: Control = STILL, speed_mps: float | None = 5.0, **limits: float):
    return limited(wanted, before, speed_mps, DT_S, MotionLimits(**limits))


@pytest.mark.parametrize('speed', [None, 0.0, 5.0, -5.0, 50.0])
@pytest.mark.parametrize('reverse', [False, True])
def test_no_limits_change_nothing(speed, reverse) -> None:
    wanted = Control(1.0, 0.0, -1.0, reverse)
    answer, names = one(wanted, Control(0.0, 1.0, 1.0), speed)
    assert answer is wanted
    assert names == ()


@pytest.mark.parametrize(
    ('wanted', 'limits', 'expected', 'name'),
    [
        (Control(1.0), {'max_acceleration_mps2': 2.0}, Control(0.4), 'acceleration'),
        (Control(0.0, 1.0), {'max_deceleration_mps2': 4.0}, Control(0.0, 0.5), 'acceleration'),
        (Control(1.0), {'max_jerk_mps3': 10.0}, Control(0.2), 'jerk'),
        (Control(0.0, 1.0), {'max_jerk_mps3': 10.0}, Control(0.0, 0.125), 'jerk'),
        (Control(0.0, 0.0, 0.9), {'max_steer': 0.5}, Control(0.0, 0.0, 0.5), 'steer'),
        (Control(0.0, 0.0, -0.9), {'max_steer': 0.5}, Control(0.0, 0.0, -0.5), 'steer'),
        (Control(0.0, 0.0, 0.9), {'max_steer_rate_1ps': 2.0}, Control(0.0, 0.0, 0.2), 'steer_rate'),
        (Control(0.0, 0.0, -0.9), {'max_steer_rate_1ps': 2.0}, Control(0.0, 0.0, -0.2), 'steer_rate'),
        (Control(1.0), {'max_speed_mps': 4.9}, STILL, 'speed'),
        (Control(0.1), {'max_speed_mps': 4.9}, STILL, 'speed'),
        (Control(1.0, 0.0, 0.0, reverse=True), {'max_gear_speed_mps': 1.0}, Control(), 'gear'),
        (Control(0.0, 0.5, 0.0, reverse=True), {'max_gear_speed_mps': 1.0}, Control(0.0, 0.5), 'gear'),
    ],
)
def test_each_limit_cuts_to_its_value(wanted, limits, expected, name) -> None:
    answer, names = one(wanted, **limits)
    assert names == (name,)
    assert answer.reverse == expected.reverse
    for field in ('throttle', 'brake', 'steer'):
        assert getattr(answer, field) == pytest.approx(getattr(expected, field))


def test_lateral_acceleration_is_that_of_the_bicycle() -> None:
    limits = MotionLimits(max_lateral_mps2=3.0)
    for wanted, speed in ((1.0, 10.0), (-1.0, 10.0), (-1.0, -10.0)):
        answer, names = limited(Control(0.3, 0.0, wanted), STILL, speed, DT_S, limits)
        assert names == ('lateral',)
        lateral = speed**2 * math.tan(answer.steer * limits.max_steer_rad) / limits.wheelbase_m
        assert lateral == pytest.approx(math.copysign(3.0, wanted))
        assert answer.throttle == 0.3
    assert limited(Control(steer=1.0), STILL, None, DT_S, limits)[1] == ()
    assert limited(Control(steer=1.0), STILL, 0.0, DT_S, limits)[1] == ()


def test_an_absurd_speed_does_not_raise() -> None:
    answer, names = one(Control(0.0, 0.0, 0.5), speed_mps=1e200, max_lateral_mps2=3.0)
    assert names == ('lateral',)
    assert answer.steer == pytest.approx(0.0, abs=1e-9)


def test_jerk_and_steer_rate_are_relative_to_the_previous_command() -> None:
    before = Control(0.0, 0.5, -0.5)
    answer, names = one(Control(1.0, 0.0, 0.5), before, max_jerk_mps3=20.0, max_steer_rate_1ps=3.0)
    assert names == ('jerk', 'steer_rate')
    assert (answer.throttle, answer.brake, answer.steer) == pytest.approx((0.0, 0.25, -0.2))


def test_no_rate_limit_keeps_the_throttle_open_on_a_car_that_is_too_fast() -> None:
    answer, names = one(Control(0.0, 1.0), Control(1.0), 12.0, max_jerk_mps3=1.0, max_speed_mps=10.0)
    assert names == ('jerk', 'speed')
    assert (answer.throttle, answer.brake) == (0.0, 0.0)
    assert one(Control(0.0, 0.3), STILL, 12.0, max_speed_mps=10.0)[1] == (), 'braking is always allowed'
    assert one(Control(0.5), STILL, -12.0, max_speed_mps=10.0)[1] == ('speed',)
    assert one(Control(0.5), STILL, 10.0, max_speed_mps=10.0)[1] == ()


@pytest.mark.parametrize('engaged', [False, True])
@pytest.mark.parametrize(('speed', 'fast'), [(1.0, False), (1.1, True), (-1.0, False), (-1.1, True)])
def test_the_gear_is_changed_only_when_slow(speed, fast, engaged) -> None:
    before = Control(0.0, 0.3, 0.0, engaged)
    answer, names = one(Control(0.5, 0.1, 0.2, not engaged), before, speed, max_gear_speed_mps=1.0)
    assert names == (('gear',) if fast else ())
    assert answer == (Control(0.0, 0.1, 0.2, engaged) if fast else Control(0.5, 0.1, 0.2, not engaged))
    rolls = Control(0.5, 0.0, 0.0, engaged)
    assert one(rolls, before, speed, max_gear_speed_mps=1.0) == (rolls, ()), 'a car that rolls back on a hill'


def test_the_throttle_comes_down_before_the_gear_changes() -> None:
    wanted, limits = Control(1.0, 0.0, 0.0, reverse=True), {'speed_mps': 0.0, 'max_jerk_mps3': 20.0}
    seen = [Control(1.0)]
    for _ in range(6):
        seen.append(one(wanted, seen[-1], **limits)[0])
    assert [c.reverse for c in seen] == [False, False, False, False, True, True, True]
    assert [c.throttle for c in seen] == pytest.approx([1.0, 0.6, 0.2, 0.0, 0.4, 0.8, 1.0])
    assert not any(c.brake for c in seen)
    assert one(wanted, Control(1.0), **limits)[1] == one(wanted, Control(0.1), **limits)[1] == ('jerk',)
    back = one(Control(0.4, 0.0, -0.3), Control(0.2, 0.0, 0.0, reverse=True), **limits)[0]
    assert (back.steer, back.reverse) == (-0.3, True)
    held = Control(0.0, 0.3, 0.0, reverse=True)
    assert one(held, Control(0.0, 0.3), **limits) == (held, ()), 'a standing car may change it on the brake'


def test_a_car_with_weak_pedals_gets_no_more_than_full_ones() -> None:
    weak = {'full_throttle_mps2': 1.0, 'full_brake_mps2': 1.0}
    answer, _ = one(STILL, Control(1.0), 0.0, max_jerk_mps3=1.0, **weak)
    assert answer.throttle == pytest.approx(0.9)
    answer, _ = one(
        Control(1.0), Control(1.0, 0.0, 1.0), 0.0, max_steer_rate_1ps=1.0, max_acceleration_mps2=0.5, **weak
    )
    assert answer.throttle == pytest.approx(0.5)
    assert answer.steer == pytest.approx(0.9)


PEDAL, STEER = st.floats(0.0, 1.0), st.floats(-1.0, 1.0)
COMMANDS = st.builds(Control, PEDAL, PEDAL, STEER, st.booleans())
LIMIT = st.floats(0.01, 100.0)


@given(
    COMMANDS,
    COMMANDS,
    st.none() | st.floats(-60.0, 60.0),
    st.floats(0.001, 0.3),
    st.builds(
        MotionLimits,
        max_speed_mps=LIMIT,
        max_acceleration_mps2=LIMIT,
        max_deceleration_mps2=LIMIT,
        max_jerk_mps3=LIMIT,
        max_steer=st.floats(0.01, 1.0),
        max_steer_rate_1ps=LIMIT,
        max_lateral_mps2=LIMIT,
        max_gear_speed_mps=LIMIT,
    ),
)
def test_any_command_stays_a_command_and_within_its_rates(wanted, before, speed, dt_s, limits) -> None:
    answer, names = limited(wanted, before, speed, dt_s, limits)
    answer.validate()
    if answer.reverse != wanted.reverse:
        assert answer.reverse == before.reverse
        assert answer.throttle <= before.throttle
        assert 'gear' in names or 'jerk' in names
    if speed is not None and abs(speed) > limits.max_gear_speed_mps:
        assert answer.reverse == before.reverse
    assert answer.throttle == 0.0 or wanted.throttle > 0.0 or 'jerk' in names
    assert abs(answer.steer - before.steer) <= limits.max_steer_rate_1ps * dt_s + 1e-9
    if speed is not None and abs(speed) > limits.max_speed_mps:
        push = answer.throttle * limits.full_throttle_mps2 - answer.brake * limits.full_brake_mps2
        assert push <= 1e-9, names


def test_swings_count_in_both_directions_and_expire() -> None:
    swings = Oscillation(swing=1.0, turns=3, window_s=1.0)
    seen = [swings.see(steer, t) for t, steer in enumerate((0.0, 0.5, -0.5, 0.4, 0.5, -0.5))]
    assert seen == [False] * 6, 'one turn a second is no oscillation'
    swings.reset()
    assert [swings.see(s, 0.1 * i) for i, s in enumerate((0.5, -0.5, 0.5, 0.0, -0.5))] == [False] * 4 + [True]
    assert not swings.see(-0.5, 2.0)
    swings.reset()
    assert not any(swings.see(s, 3.0) for s in (0.0, -0.9, 0.0)), 'a wheel in the middle is no swing'
    assert swings.times == deque()


def test_swings_exactly_as_old_as_the_window_count() -> None:
    swings = Oscillation(swing=1.0, turns=2, window_s=1.0)
    assert [swings.see(s, t) for s, t in ((0.5, 0.0), (-0.5, 1.0), (0.5, 2.0))] == [False, False, True]


def test_steps_the_same_way_are_no_swings() -> None:
    swings = Oscillation(swing=0.5, turns=2, window_s=10.0)
    assert not any(swings.see(s, i) for i, s in enumerate((0.0, 0.5, 1.0, 0.9, 1.0, 0.6)))
    assert swings.see(0.4, 7.0)


def test_full_lock_is_timed_from_its_beginning() -> None:
    lock = Saturation(2.0)
    assert not lock.see(1.0, 0.0)
    assert not lock.see(-1.0, 2.0)
    assert lock.see(1.0, 2.1)
    assert not lock.see(0.99, 2.2)
    assert not lock.see(1.0, 2.3)
    lock.reset()
    assert not lock.see(1.0, 9.0)
    assert lock.see(lock.full, 11.1)
