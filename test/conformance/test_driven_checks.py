"""The programme by the vehicle's clock, the delay of actuators, odometry as its own witness, and what ends a drive."""

import math

import numpy as np
import pytest

from raw2drive_ros.conformance.active import judge_drive, what_forbids_motion
from raw2drive_ros.conformance.clock import VehicleClock
from raw2drive_ros.conformance.delay import onset_s
from raw2drive_ros.conformance.motion import judge_odometry
from raw2drive_ros.conformance.observation import Observation, Trial, Verdict
from raw2drive_ros.conformance.programme import BRAKE, FOREIGN, GO, PROGRAMME, Runner, Step, ends_standing, stands
from raw2drive_ros.conformance.summary import summarised
from raw2drive_ros.contracts.errors import UnsafeError
from raw2drive_ros.contracts.public import Control, ImuSample, OdometrySample

PERIOD_NS = 50_000_000


def errors(verdicts: list[Verdict]) -> list[str]:
    return [v.check for v in verdicts if v.severity == 'error']


def circle(speed_mps=2.0, yaw_rate_radps=0.2, start_rad=0.0, seconds=5.0) -> Observation:
    """A car on a circle, with its IMU, that has no fault."""
    seen = Observation(seconds)
    for i in range(round(seconds * 20)):
        yaw = start_rad + yaw_rate_radps * i * 0.05
        reach = speed_mps / yaw_rate_radps
        x, y = reach * (math.sin(yaw) - math.sin(start_rad)), -reach * (math.cos(yaw) - math.cos(start_rad))
        wrapped = math.remainder(yaw, math.tau)
        seen.odometry.append(OdometrySample(i * PERIOD_NS, x, y, wrapped, speed_mps, yaw_rate_radps))
        seen.lateral_mps.append(0.0)
        seen.imu.append(ImuSample(i * PERIOD_NS, (0.0, speed_mps * yaw_rate_radps, 9.81), (0.0, 0.0, yaw_rate_radps)))
    return seen


# -- the vehicle's clock ------------------------------------------------------------------------------


def test_clock_goes_by_stamps_and_stands_when_they_stop() -> None:
    clock = VehicleClock()
    for i in range(41):
        clock.odometry(5_000_000_000 + i * PERIOD_NS, 100.0 + 0.05 * i)
    assert clock.now_ns(102.0) == 7_000_000_000
    assert clock.now_ns(102.03) == pytest.approx(7_030_000_000, abs=1e6)
    assert clock.now_ns(109.0) == pytest.approx(7_100_000_000, abs=1e6)
    assert clock.pace == pytest.approx(1.0)


def test_clock_of_a_slow_simulation_runs_slowly_and_overrides_stamps() -> None:
    clock = VehicleClock()
    clock.odometry(999_000_000_000, 9.9)
    for i in range(41):
        clock.clock(i * PERIOD_NS, 10.0 + 0.1 * i)
        clock.odometry(999_000_000_000 + i, 10.0 + 0.1 * i)
    assert clock.pace == pytest.approx(0.5)
    assert clock.now_ns(14.0) == 2_000_000_000
    assert clock.now_ns(14.1) == pytest.approx(2_050_000_000, abs=1e6)


# -- the programme ------------------------------------------------------------------------------------


def run(steps: tuple[Step, ...], speed_at, *, moving: bool = True) -> tuple[Observation, list[tuple[float, Step]]]:
    """Go through `steps` with a car whose odometry says `speed_at(seconds)`; returns when which step was asked."""
    seen, asked, x = Observation(1.0), [], 0.0
    runner = Runner(seen, steps)
    for i in range(1200):
        x += speed_at(i * 0.05) * 0.05 if moving else 0.0
        seen.odometry.append(OdometrySample(i * PERIOD_NS, x, 0.0, 0.0, speed_at(i * 0.05), 0.0))
        step = runner.order(i * PERIOD_NS)
        if step is None:
            return seen, asked
        asked.append((i * 0.05, step))
    raise AssertionError('the programme did not end')


def test_steps_last_as_long_as_planned_by_the_vehicles_clock() -> None:
    first, second = Step('brake holds', BRAKE, 1.0), Step('throttle drives forward', GO, 2.5)
    seen, asked = run((first, second), lambda t: 0.0)
    assert next(t for t, step in asked if step is second) == pytest.approx(1.0)
    assert asked[-1][0] == pytest.approx(3.45)
    assert [trial.name for trial in seen.trials] == ['brake holds', 'throttle drives forward']
    assert seen.trials[1].started_ns == 1_000_000_000
    assert seen.trials[1].times_s[-1] == pytest.approx(2.5)


def test_the_car_must_stand_after_a_stop_and_a_wrong_twist_does_not_hide_that_it_moves() -> None:
    stop = (Step('brake stops', BRAKE, 4.0, until_standing=True),)
    seen, asked = run(stop, lambda t: 0.0)
    assert asked[-1][0] < 2.1 and ends_standing(seen.trials[0])
    with pytest.raises(UnsafeError, match='does not stand after brake stops'):
        run(stop, lambda t: 3.0)
    still = Trial('', BRAKE, [0.1 * i for i in range(30)], [0.0] * 30, [0.0] * 30)
    assert stands(still) and ends_standing(still)
    still.drift_mps = 3.0
    assert not stands(still) and not ends_standing(still)


def test_a_car_that_obeys_a_stranger_ends_the_step_at_once() -> None:
    step = (Step(FOREIGN, BRAKE, 5.0, foreign=GO),)
    _, asked = run(step, lambda t: t)
    assert asked[-1][0] < 0.6
    _, asked = run(step, lambda t: 0.0)
    assert asked[-1][0] > 4.8


def test_steps_begin_again_or_are_left_out() -> None:
    runner = Runner(Observation(1.0), (Step('a', BRAKE, 1.0), Step('b', GO, 1.0)))
    assert runner.order(0).name == 'a'
    runner.again(900_000_000)
    assert runner.order(1_500_000_000).name == 'a'
    runner.skip(1_500_000_000)
    assert runner.order(1_600_000_000).name == 'b'
    assert runner.seen.trials == []


def test_the_foreign_commands_come_last_and_the_car_is_held_meanwhile() -> None:
    foreign = [i for i, step in enumerate(PROGRAMME) if step.foreign is not None]
    assert all(step.foreign is not None or not step.name for step in PROGRAMME[foreign[0] :])
    assert all(step.control is None or step.control.brake > 0.0 for step in PROGRAMME[foreign[0] :])


@pytest.mark.parametrize('check', ['/vehicle/odometry: rate', '/control/command: subscriber', 'clock: stamps'])
def test_nothing_moves_without_odometry_commands_and_a_clock(check) -> None:
    assert what_forbids_motion([Verdict(check, 'error', 'x'), Verdict('imu: units', 'error', 'y')]) == [check]
    assert what_forbids_motion([Verdict(check, 'passed', 'x')]) == []


# -- the delay ----------------------------------------------------------------------------------------


@pytest.mark.parametrize('delay', [0.0, 0.12, 0.3, 0.55])
@pytest.mark.parametrize('noise', [0.0, 0.01])
def test_the_beginning_of_a_response_is_found_in_speed_and_curvature(delay, noise) -> None:
    rng = np.random.default_rng(3)
    times = np.arange(-0.4, 1.0, 0.05)
    since = np.clip(times - delay, 0.0, None)
    # First order with 0.1 s, as the simulation's pedals and steering.
    lagging = 1.0 - np.exp(-since / 0.1)
    speed = 1.0 - 0.1 * times + 3.0 * (since - 0.1 * lagging) + noise * rng.standard_normal(times.shape)
    curvature = 0.1 * lagging + 0.1 * noise * rng.standard_normal(times.shape)
    assert onset_s(times, speed, 0.3, integrated=True) == pytest.approx(delay, abs=0.06)
    assert onset_s(times, curvature, 0.01, integrated=False) == pytest.approx(delay, abs=0.06)


def test_noise_and_stillness_are_no_response() -> None:
    times = np.arange(-0.4, 1.0, 0.05)
    rng = np.random.default_rng(0)
    assert onset_s(times, np.zeros_like(times), 0.3, integrated=True) is None
    assert onset_s(times, 0.001 * rng.standard_normal(times.shape), 0.01, integrated=False) is None


# -- odometry and IMU ---------------------------------------------------------------------------------


@pytest.mark.parametrize('start_rad', [0.0, 1.5, 3.1, -2.0])
def test_a_car_that_turns_has_no_error_wherever_it_heads(start_rad) -> None:
    for rate in (0.2, -0.2):
        seen = circle(yaw_rate_radps=rate, start_rad=start_rad)
        verdicts = judge_odometry(seen)
        assert errors(verdicts) == []
        passed = {v.check for v in verdicts if v.severity == 'passed'}
        assert passed == {'odometry: twist', 'odometry: yaw rate', 'imu: yaw rate'}


@pytest.mark.parametrize('start_rad', [0.0, 1.5, 3.1, -2.0])
def test_a_twist_in_map_axes_is_told_wherever_the_car_heads(start_rad) -> None:
    seen = circle(start_rad=start_rad)
    turned = [(s.speed_mps * math.cos(s.yaw_rad), s.speed_mps * math.sin(s.yaw_rad)) for s in seen.odometry]
    seen.lateral_mps = [y for _, y in turned]
    seen.odometry = [
        OdometrySample(s.stamp_ns, s.x_m, s.y_m, s.yaw_rad, x, s.yaw_rate_radps)
        for s, (x, _) in zip(seen.odometry, turned, strict=True)
    ]
    verdicts = judge_odometry(seen)
    assert errors(verdicts) == ['odometry: twist']
    assert 'axes of map' in verdicts[0].remedy


def test_sideslip_is_no_error() -> None:
    """The centre of a car that turns moves a little sideways; many vehicles report that, many do not."""
    seen = circle(yaw_rate_radps=0.3)
    slip = 0.1
    for lateral in (0.0, 2.0 * math.sin(slip)):
        samples = [
            OdometrySample(
                s.stamp_ns, s.x_m, s.y_m, math.remainder(s.yaw_rad - slip, math.tau), 2.0 * math.cos(slip), 0.3
            )
            for s in seen.odometry
        ]
        other = Observation(5.0, odometry=samples, lateral_mps=[lateral] * len(samples), imu=seen.imu)
        assert errors(judge_odometry(other)) == []


def test_a_car_that_stands_proves_nothing() -> None:
    seen = Observation(1.0, odometry=[OdometrySample(i * PERIOD_NS, 0.0, 0.0, 0.0, 0.0, 0.0) for i in range(40)])
    verdicts = judge_drive(seen, [])
    assert {v.severity for v in verdicts} == {'skipped'}
    assert judge_drive(Observation(1.0), [])


def test_trials_judged_by_wrong_odometry_are_skipped() -> None:
    seen = circle()
    seen.odometry = [
        OdometrySample(s.stamp_ns, s.x_m, s.y_m, s.yaw_rad, s.speed_mps, -s.yaw_rate_radps) for s in seen.odometry
    ]
    seen.trials = [Trial('steer left', Control(0.3, 0.0, 0.3), [0.1] * 9, [2.0] * 9, [-0.2] * 9)]
    verdicts = judge_drive(seen, [])
    assert errors(verdicts) == ['odometry: yaw rate']
    left = next(v for v in verdicts if v.check == 'steer left')
    assert (left.severity, left.remedy) == ('skipped', 'mend "odometry: yaw rate" first')


def test_what_many_topics_get_wrong_is_said_once() -> None:
    same = [Verdict(f'/t{i}: QoS', 'error', 'best effort', 'reliability RELIABLE') for i in range(4)]
    other = Verdict('imu: units', 'error', 'x', 'y')
    found = summarised([same[0], other, *same[1:], Verdict('/t9: QoS', 'passed', 'matches')])
    assert [v.check for v in found] == ['QoS, 4 times', 'imu: units', '/t9: QoS']
    assert found[0].text == 'best effort (/t0, /t1, /t2, /t3)'
    assert summarised(same[:2]) == same[:2]
