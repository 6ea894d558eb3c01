"""What a gate that has just started knows, what ends a stop and what does not, and who may tell it the speed."""

import math

import pytest
from gate_helpers import PERIOD_S, WANTED, at, driving_gate, proposal

from raw2drive_ros.contracts.public import Control, VehicleStatus
from raw2drive_ros.driving.gate import PLACED_TICKS, Gate
from raw2drive_ros.driving.gate_speed import Reading, SpeedSense
from raw2drive_ros.driving.gate_state import GateLimits, GateState, Moment


def status(seconds: float, speed_mps: float | None = 0.0, **values) -> VehicleStatus:
    return VehicleStatus(round(seconds * 1e9), speed_mps, **values)


def test_a_gate_that_starts_beside_a_moving_car_is_latched() -> None:
    gate = Gate()
    gate.observe(0.4, at(0.0))
    assert gate.state is GateState.COMFORTABLE_STOP
    assert gate.reason == 'the car moves, and this gate has not driven it'
    assert gate.propose(proposal(0.1), at(0.1)).throttle == 0.0


def test_a_gate_that_starts_beside_a_moving_car_hears_it_from_the_status_too() -> None:
    gate = Gate()
    gate.vehicle(status(0.0, -0.4), at(0.0))
    assert gate.state is GateState.COMFORTABLE_STOP


def test_a_gate_that_starts_without_odometry_waits_and_is_then_latched() -> None:
    gate = Gate()
    for i in range(6):
        assert gate.propose(proposal(PERIOD_S * i), at(PERIOD_S * i)).throttle == 0.0
        assert gate.state is GateState.WAITING
    assert gate.state is GateState.WAITING
    gate.propose(proposal(0.6), at(0.6))
    assert gate.state is GateState.COMFORTABLE_STOP
    assert gate.reason == 'no odometry since the gate started'


def test_odometry_in_time_lets_it_drive() -> None:
    gate = Gate()
    gate.propose(proposal(0.0), at(0.0))
    gate.observe(0.0, at(0.4))
    assert gate.propose(proposal(0.4), at(0.4)) == WANTED
    assert gate.state is GateState.DRIVING


def test_a_planner_that_came_long_before_the_vehicle_does_not_latch_the_gate() -> None:
    gate = Gate()
    gate.propose(proposal(0.0), at(0.0))
    for seconds in (0.5, 30.0, 60.0):
        gate.tick(at(seconds))
    gate.propose(proposal(60.1), at(60.1))
    assert gate.state is GateState.WAITING


def test_odometry_that_is_too_old_is_no_speed() -> None:
    gate = Gate()
    gate.observe(0.0, at(0.0))
    assert gate.propose(proposal(0.6), at(0.6)).throttle == 0.0
    assert gate.state is GateState.WAITING
    gate.refuse('x', at(0.7))
    assert gate.activate(at(0.7)) == 'the speed is unknown: no odometry'
    gate.observe(0.0, at(0.8))
    assert gate.activate(at(1.3)) == ''


def test_a_stop_that_the_vehicle_reports_latches_a_new_gate() -> None:
    gate = Gate()
    gate.vehicle(status(0.0, stopped=True, activation=3), at(0.0))
    assert gate.state is GateState.EMERGENCY_STOP
    assert gate.reason.startswith('the vehicle has stopped by itself')
    assert gate.activate(at(0.1)) == ''
    assert gate.activation == 4, 'newer than what the vehicle has heard'
    gate.vehicle(status(0.1, stopped=True, activation=3), at(0.1))
    assert gate.state is GateState.WAITING, 'the vehicle has not heard of the activation yet'
    gate.vehicle(status(0.2, activation=4), at(0.2))
    assert gate.propose(proposal(0.2), at(0.2)) == WANTED
    gate.vehicle(status(0.3, stopped=True, activation=4), at(0.3))
    assert gate.state is GateState.EMERGENCY_STOP


def test_an_activation_expires() -> None:
    gate = driving_gate()
    gate.refuse('x', at(0.1))
    assert gate.activate(at(0.2)) == ''
    gate.tick(at(10.2))
    assert gate.state is GateState.WAITING
    assert gate.reason == 'no valid proposal yet'
    gate.tick(at(10.21))
    assert gate.state is GateState.EMERGENCY_STOP
    assert gate.reason == 'activated, but not driving after 10 s (no valid proposal): activate again'
    assert gate.propose(proposal(10.3), at(10.3)).throttle == 0.0


def test_an_activation_expires_on_the_steady_clock_also_in_lock_step() -> None:
    gate = driving_gate(steady=False)
    gate.refuse('x', at(0.1))
    assert gate.activate(at(0.2)) == ''
    gate.tick(Moment(1010.21, 0.2))
    assert gate.state is GateState.EMERGENCY_STOP


def test_an_activation_that_led_to_driving_does_not_expire() -> None:
    gate = driving_gate()
    gate.refuse('x', at(0.1))
    assert gate.activate(at(0.2)) == ''
    for i in range(3, 120):
        gate.propose(proposal(PERIOD_S * i), at(PERIOD_S * i))
    assert gate.state is GateState.DRIVING


def test_a_waiting_gate_says_what_it_waits_for_and_an_expired_activation_too() -> None:
    gate = driving_gate()
    gate.publisher_counts({'proposals': 2}, at(0.1))
    gate.publisher_counts({'proposals': 1}, at(0.2))
    assert gate.activate(at(0.2)) == ''
    gate.publisher_counts({'proposals': 2}, at(0.3))
    gate.tick(at(0.3))
    assert gate.state is GateState.WAITING
    assert gate.reason.startswith('more than one publisher of proposals; one that has died counts until its lease ends')
    gate.tick(at(11.0))
    assert 'more than one publisher of proposals' in gate.reason
    assert gate.state is GateState.EMERGENCY_STOP


def test_start_over_lifts_no_stop_of_a_moving_car() -> None:
    gate = driving_gate()
    gate.observe(8.0, at(0.1))
    gate.refuse('x', at(0.2))
    assert gate.start_over(at(0.3)) == 'the car moves, or its speed is unknown: a stop is not lifted'
    assert gate.state is GateState.EMERGENCY_STOP
    gate.observe(0.2, at(2.0))
    assert gate.start_over(at(2.0)) == ''
    assert gate.state is GateState.WAITING
    blind = Gate()
    blind.refuse('x', at(0.0))
    assert blind.start_over(at(0.1)).startswith('the car moves')


def test_a_simulation_that_puts_the_car_elsewhere_ends_the_stop_even_at_speed() -> None:
    gate = Gate(simulated=True)
    gate.vehicle(status(0.0, 6.0, placed=1), at(0.0))
    gate.observe(6.0, at(0.0))
    assert gate.propose(proposal(0.0), at(0.0)) == WANTED
    gate.refuse('x', at(0.1))
    gate.vehicle(status(0.1, 6.0, placed=1, ticks=1), at(0.1))
    assert gate.state is GateState.EMERGENCY_STOP
    gate.vehicle(status(0.2, 5.0, placed=2), at(0.2))
    assert gate.state is GateState.WAITING
    gate.observe(5.0, at(0.2))
    assert gate.propose(proposal(0.2), at(0.2)) == WANTED


@pytest.mark.parametrize(
    ('simulated', 'ticks', 'latched'), [(True, PLACED_TICKS - 1, False), (True, PLACED_TICKS, True), (False, 0, True)]
)
def test_only_a_simulation_may_and_only_when_it_begins(simulated, ticks, latched) -> None:
    gate = Gate(simulated=simulated)
    gate.vehicle(status(0.0, 6.0, placed=5, ticks=ticks), at(0.0))
    assert (gate.state is GateState.COMFORTABLE_STOP) is latched


def test_a_status_once_heard_must_go_on() -> None:
    gate = driving_gate(limits=GateLimits())
    gate.vehicle(status(0.0), at(0.0))
    for i in range(1, 6):
        gate.observe(0.0, at(PERIOD_S * i))
        gate.propose(proposal(PERIOD_S * i), at(PERIOD_S * i))
    gate.tick(at(0.5))
    assert gate.state is GateState.DRIVING
    gate.tick(at(0.51))
    assert gate.reason == 'no status of the vehicle for 510 ms'


@pytest.mark.parametrize('odometry_first', [True, False])
def test_odometry_that_contradicts_the_status_stops_the_car_and_is_not_believed(odometry_first) -> None:
    gate = driving_gate()
    gate.vehicle(status(0.1, 9.0), at(0.1))
    if odometry_first:
        gate.observe(0.0, at(0.2))
        gate.vehicle(status(0.2, 9.0), at(0.2))
    else:
        gate.vehicle(status(0.2, 9.0), at(0.2))
        gate.observe(0.0, at(0.2))
    assert gate.state is GateState.EMERGENCY_STOP
    assert gate.reason == "odometry contradicts the vehicle's status: a second publisher?"
    assert gate.activate(at(0.3)) == 'the car still drives at 9.0 m/s'


def test_odometry_that_contradicts_itself_stops_the_car_and_the_faster_is_believed() -> None:
    gate = driving_gate()
    gate.observe(9.0, at(0.1))
    gate.observe(0.0, at(0.15))
    assert gate.state is GateState.EMERGENCY_STOP
    assert gate.reason == 'odometry contradicts itself: a second publisher?'
    assert gate.activate(at(0.2)) == 'the car still drives at 9.0 m/s'


@pytest.mark.parametrize(('jump_s', 'stops'), [(0.1, False), (1.0, False), (1.01, True), (-0.05, False), (-0.06, True)])
def test_a_clock_that_jumps_stops_the_car(jump_s, stops) -> None:
    gate = driving_gate()
    gate.clock(5.0, at(0.0))
    gate.clock(5.0 + jump_s, at(0.1))
    assert (gate.state is GateState.EMERGENCY_STOP) is stops
    assert gate.reason == (f'ROS time jumped by {jump_s:.2f} s: a second publisher?' if stops else '')


def test_the_driver_takes_over_and_gives_back() -> None:
    gate = driving_gate()
    gate.override(at(0.1), by_driver=False)
    assert gate.state is GateState.DRIVING
    gate.override(at(0.2), by_driver=True)
    assert gate.state is GateState.HANDED_OVER
    assert gate.reason == 'the driver has taken over'
    answer = gate.propose(proposal(1.0), at(1.0))
    assert (answer.throttle, answer.brake, answer.steer) == (0.0, gate.limits.comfortable_brake, WANTED.steer)
    gate.observe(12.0, at(1.0))
    for i in range(20, 80):
        gate.tick(at(PERIOD_S * i))
    assert gate.state is GateState.HANDED_OVER, 'what the driver does is no fault of the brakes'
    assert gate.activate(at(8.0)) == 'the driver has taken over'
    gate.override(at(8.1), by_driver=False)
    assert gate.state is GateState.HANDED_OVER
    gate.observe(0.0, at(9.0))
    assert gate.activate(at(9.0)) == ''


def test_a_hand_over_does_not_soften_an_emergency_stop_and_foreign_messages_harden_a_hand_over() -> None:
    gate = driving_gate()
    gate.refuse('x', at(0.1))
    gate.override(at(0.2), by_driver=True)
    assert gate.state is GateState.EMERGENCY_STOP
    gate = driving_gate()
    gate.override(at(0.2), by_driver=True)
    assert gate.refuse('x', at(0.3)) == Control(0.0, gate.limits.emergency_brake, WANTED.steer)


@pytest.mark.parametrize(
    ('readings', 'contradicted', 'speed_mps'),
    [
        ([(0.0, 5.0), (0.0, 5.04)], '', 5.04),
        ([(0.0, 5.0), (0.0, 5.06)], 'itself', 5.06),
        ([(0.0, 5.0), (0.1, 0.1)], '', 0.1),
        ([(0.0, 5.0), (0.1, -0.1)], 'itself', 5.0),
        ([(0.1, 5.0), (0.0, 4.0)], '', 5.0),
        ([(0.1, 5.0), (0.0, -1.0)], 'itself', 5.0),
        ([(0.0, -5.0), (0.01, 0.0)], 'itself', -5.0),
    ],
)
def test_odometry_alone(readings, contradicted, speed_mps) -> None:
    sense, found = SpeedSense(), ''
    for stamp_s, speed in readings:
        found = sense.odometry(Reading(stamp_s, speed))
    assert found == contradicted
    assert sense.speed_mps == speed_mps
    assert not sense.signed


@pytest.mark.parametrize(
    ('stamp_s', 'speed_mps', 'denied'),
    [
        (0.2, 6.0, False),
        (0.2, 6.06, True),
        (0.15, 3.1, False),
        (0.15, 2.9, True),
        (0.15, 7.9, False),
        (0.15, 8.1, True),
        (0.05, 40.0, False),
        (0.3, 40.0, False),
    ],
)
def test_odometry_beside_two_statuses(stamp_s, speed_mps, denied) -> None:
    sense = SpeedSense()
    assert sense.status(Reading(0.1, 5.0)) == ''
    assert sense.status(Reading(0.2, 6.0)) == ''
    assert sense.odometry(Reading(stamp_s, speed_mps)) == ("the vehicle's status" if denied else '')
    assert sense.speed_mps == 6.0
    assert sense.signed
    # What came before the status of its moment is compared when that one comes.
    assert sense.status(Reading(0.3, 7.0)) == ("the vehicle's status" if stamp_s == 0.3 else '')
    sense.forget()
    assert (sense.speed_mps, sense.signed) == (None, False)


def test_a_speed_that_is_no_number_is_no_odometry() -> None:
    gate = Gate()
    gate.observe(math.nan, at(0.0))
    assert gate.propose(proposal(0.0), at(0.0)).throttle == 0.0
    assert gate.speed_mps is None


def test_a_car_that_rolls_between_activation_and_drive_is_no_car_of_somebody_else() -> None:
    gate = driving_gate()
    gate.refuse('x', at(0.1))
    assert gate.activate(at(0.2)) == ''
    gate.observe(0.5, at(0.3))
    assert gate.state is GateState.WAITING
    assert gate.propose(proposal(0.3), at(0.3)) == WANTED


def test_started_over_the_speed_is_still_known_and_said_so() -> None:
    gate = driving_gate()
    gate.refuse('x', at(0.1))
    assert gate.start_over(at(0.2)) == ''
    assert gate.reason == 'started over'
    assert gate.propose(proposal(0.2), at(0.2)) == WANTED


def test_started_over_while_the_driver_drives_it_waits_for_the_driver() -> None:
    gate = driving_gate()
    gate.override(at(0.1), by_driver=True)
    assert gate.start_over(at(0.2)) == ''
    assert gate.propose(proposal(0.2), at(0.2)).throttle == 0.0
    assert (gate.state, gate.reason) == (GateState.WAITING, 'the driver has taken over')
    gate.override(at(0.3), by_driver=False)
    assert gate.propose(proposal(0.3), at(0.3)) == WANTED


def test_a_simulation_that_begins_again_with_its_clock_is_compared_with_its_own_status() -> None:
    gate = Gate(simulated=True)
    gate.vehicle(status(100.0, 9.0, placed=1), at(100.0))
    gate.vehicle(status(1.0, 0.0, placed=2), at(1.0))
    assert gate.reason == 'no proposal yet'
    gate.observe(5.0, at(1.0))
    assert gate.reason == "odometry contradicts the vehicle's status: a second publisher?"


def test_a_vehicle_that_tells_its_speed_by_status_alone_is_driven() -> None:
    gate = Gate(GateLimits())
    for i in range(15):
        gate.vehicle(status(PERIOD_S * i), at(PERIOD_S * i))
        gate.propose(proposal(PERIOD_S * i), at(PERIOD_S * i))
        gate.tick(at(PERIOD_S * i))
    assert gate.state is GateState.DRIVING


def test_swings_of_proposals_that_were_not_driven_do_not_count() -> None:
    gate = Gate(GateLimits(odometry_after_s=math.inf))
    gate.observe(0.0, at(0.0))
    gate.publisher_counts({'proposals': 2}, at(0.0))
    for i in range(12):
        gate.propose(proposal(0.1 * i, Control(0.2, 0.0, 0.5 if i % 2 else -0.5)), at(0.1 * i))
    assert gate.state is GateState.WAITING
    gate.publisher_counts({'proposals': 1}, at(1.2))
    gate.propose(proposal(1.2, Control(0.2, 0.0, 0.5)), at(1.2))
    assert gate.state is GateState.DRIVING


def test_the_first_of_two_early_samples_is_enough_to_contradict() -> None:
    sense = SpeedSense()
    sense.status(Reading(0.1, 5.0))
    sense.odometry(Reading(0.15, 20.0))
    sense.odometry(Reading(0.2, 6.0))
    assert sense.status(Reading(0.2, 6.0)) == "the vehicle's status"


def test_a_status_that_is_sent_again_keeps_the_one_before_it() -> None:
    sense = SpeedSense()
    for stamp_s, speed_mps in ((0.1, 5.0), (0.2, 9.0), (0.2, 9.0)):
        sense.status(Reading(stamp_s, speed_mps))
    assert sense.odometry(Reading(0.15, 3.5)) == ''
    assert sense.odometry(Reading(0.15, 20.0)) == "the vehicle's status"
