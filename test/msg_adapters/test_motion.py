"""Pedals and steering converted to motion: signs, bounds and symmetry."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from msg_adapters.motion import CarFigures, motion_of, standstill
from raw2drive_ros.contracts.public import Control

CAR = CarFigures(wheelbase_m=2.5, max_steer_rad=0.5, full_throttle_mps2=4.0, full_brake_mps2=8.0)
shares = st.floats(0.0, 1.0)


@pytest.mark.parametrize(
    ('control', 'speed', 'target', 'acceleration'),
    [
        (Control(0.5), 10.0, 11.0, 2.0),
        (Control(0.0, 0.5), 10.0, 8.0, -4.0),
        (Control(0.0, 1.0), 1.0, 0.0, -8.0),  # the target ends at 0, the acceleration does not
        (Control(0.0, 0.6), 0.0, 0.0, -4.8),
        (Control(0.5, reverse=True), 0.0, -1.0, -2.0),
        (Control(0.0, 0.5), -3.0, -1.0, 4.0),  # braking backwards pushes forwards
        (Control(0.0, 0.6, reverse=True), 0.0, 0.0, 4.8),
        (Control(), 7.0, 7.0, 0.0),
    ],
)
def test_pedals(control, speed, target, acceleration) -> None:
    motion = motion_of(control, speed, CAR, 0.5)
    assert motion.speed_mps == pytest.approx(target)
    assert motion.acceleration_mps2 == pytest.approx(acceleration)


def test_left_is_positive_and_yaw_follows_the_speed() -> None:
    motion = motion_of(Control(steer=1.0), 5.0, CAR, 0.5)
    assert motion.wheel_angle_rad == 0.5
    assert motion.yaw_rate_radps == pytest.approx(5.0 * math.tan(0.5) / 2.5)
    assert motion_of(Control(steer=-0.5), 5.0, CAR, 0.5).yaw_rate_radps < 0.0
    assert motion_of(Control(0.0, 1.0, 1.0), 1.0, CAR, 0.5).yaw_rate_radps == 0.0


@given(brake=shares, speed=st.floats(-30.0, 30.0), horizon=st.floats(0.01, 5.0))
def test_the_brake_never_turns_the_car_round(brake, speed, horizon) -> None:
    target = motion_of(Control(0.0, brake), speed, CAR, horizon).speed_mps
    assert abs(target) <= abs(speed)
    assert target * speed >= 0.0


@given(throttle=shares, brake=shares, steer=st.floats(-1.0, 1.0), reverse=st.booleans(), speed=st.floats(-30.0, 30.0))
def test_everything_is_bounded_and_mirrors(throttle, brake, steer, reverse, speed) -> None:
    motion = motion_of(Control(throttle, brake, steer, reverse), speed, CAR, 0.5)
    assert abs(motion.speed_mps) <= abs(speed) + 2.0 + 1e-9
    assert abs(motion.acceleration_mps2) <= 12.0
    assert abs(motion.wheel_angle_rad) <= 0.5
    mirrored = motion_of(Control(throttle, brake, -steer, reverse), speed, CAR, 0.5)
    assert mirrored.yaw_rate_radps == -motion.yaw_rate_radps
    assert mirrored.speed_mps == motion.speed_mps


def test_an_unknown_speed_asks_for_a_standstill() -> None:
    motion = standstill(Control(1.0, steer=0.2), CAR)
    assert (motion.speed_mps, motion.acceleration_mps2, motion.yaw_rate_radps) == (0.0, -8.0, 0.0)
    assert standstill(Control(0.0, 0.5), CAR).acceleration_mps2 == -4.0
    assert standstill(Control(0.0, 0.5), CAR, -2.0).acceleration_mps2 == 4.0, 'its last known speed was backwards'


@pytest.mark.parametrize('speed', [-0.05, -0.001, 0.0, 0.001, 0.05])
def test_noise_of_a_standing_car_does_not_turn_the_brake_round(speed) -> None:
    assert motion_of(Control(0.0, 0.5), speed, CAR, 0.5).acceleration_mps2 == -4.0
    assert motion_of(Control(0.0, 0.5, 0.0, reverse=True), speed, CAR, 0.5).acceleration_mps2 == 4.0
    assert standstill(Control(0.0, 0.5, 0.0, reverse=True), CAR, speed).acceleration_mps2 == 4.0
