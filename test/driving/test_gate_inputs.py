"""What the gate makes of messages: who sent them, what they say, and what a foreign one leads to."""

import pytest
from gate_helpers import WANTED, at

from msg_adapters.commands import decision_to_message
from msg_adapters.factory import RosbagsFactory
from msg_adapters.sensors import odometry_to_message
from msg_adapters.vehicle_status import status_to_message
from raw2drive_ros.contracts import topics
from raw2drive_ros.contracts.public import Control, Decision, OdometrySample, VehicleStatus
from raw2drive_ros.driving.gate import Gate
from raw2drive_ros.driving.gate_inputs import GateInputs
from raw2drive_ros.driving.gate_state import GateState, Moment
from raw2drive_ros.driving.single_writer import Sender

FACTORY, KEY = RosbagsFactory(), bytes(range(32))


class Planner:
    def __init__(self, key: bytes | None = KEY) -> None:
        self.sender = Sender(topics.PROPOSED, key)

    def message(self, seconds: float, control: Control = WANTED):
        decision = Decision(round(seconds * 1e9), control, 3, 7.5, self.sender.next())
        return self.sender.sign(decision_to_message(FACTORY, decision))


class Vehicle:
    def __init__(self, key: bytes | None = KEY) -> None:
        self.sender = Sender(topics.STATUS, key)

    def message(self, seconds: float, speed_mps: float = 0.0, **values):
        status = VehicleStatus(round(seconds * 1e9), speed_mps, sequence=self.sender.next(), **values)
        return self.sender.sign(status_to_message(FACTORY, status))


def odometry(seconds: float, speed_mps: float = 0.0):
    return odometry_to_message(FACTORY, OdometrySample(round(seconds * 1e9), 0.0, 0.0, 0.0, speed_mps, 0.0))


def ready(key: bytes | None = KEY, **options) -> GateInputs:
    inputs = GateInputs(Gate(), key, **options)
    assert inputs.odometry(odometry(0.0), at(0.0)) == ''
    return inputs


def test_a_signed_proposal_is_passed_under_its_stamp() -> None:
    inputs, planner = ready(), Planner()
    answer = inputs.proposal(planner.message(0.0), at(0.02))
    assert answer == Decision(0, WANTED, 3, 7.5)
    assert inputs.gate.state is GateState.DRIVING


@pytest.mark.parametrize('driving', [False, True])
@pytest.mark.parametrize(
    ('made', 'words'),
    [
        (lambda planner: Planner(None).message(0.1), 'not signed'),
        (lambda planner: Planner(bytes(32)).message(0.1), 'its signature does not fit'),
        (lambda planner: planner.message(0.1, Control(float('nan'))), 'named values: not finite'),
        (lambda planner: planner.message(0.1, Control(1.1)), 'Control.throttle'),
    ],
)
def test_what_is_no_proposal_of_the_planner_is_an_emergency_stop(driving, made, words) -> None:
    inputs, planner = ready(), Planner()
    if driving:
        inputs.proposal(planner.message(0.0), at(0.0))
    answer = inputs.proposal(made(planner), at(0.15))
    assert answer.control.throttle == 0.0
    assert answer.control.brake == inputs.gate.limits.emergency_brake
    assert inputs.gate.state is GateState.EMERGENCY_STOP
    assert inputs.gate.reason.startswith(f'invalid proposal: {words}')
    assert answer.stamp_ns == (150_000_000 if words != 'Control.throttle' else 100_000_000)


def test_answers_to_messages_without_a_stamp_of_their_own_have_the_time_of_arrival() -> None:
    # Far from 0, where a wrong factor shows.
    inputs, now = ready(), Moment(9e6, 5e6)
    assert inputs.proposal(Planner(None).message(5e6), now).stamp_ns == 5_000_000 * 10**9
    assert inputs.gate.state is GateState.EMERGENCY_STOP
    assert inputs.proposal(Planner(None).message(5e6), now).stamp_ns == 5_000_000 * 10**9


def test_another_planner_with_the_key_is_foreign_while_driving_and_welcome_after_an_activation() -> None:
    inputs, one, two = ready(), Planner(), Planner()
    inputs.proposal(one.message(0.0), at(0.0))
    inputs.proposal(two.message(0.1), at(0.1))
    assert inputs.gate.reason.startswith('invalid proposal: another sender')
    inputs.odometry(odometry(0.2), at(0.2))
    assert inputs.gate.activate(at(0.2)) == ''
    assert inputs.proposal(two.message(0.2), at(0.2)).control == WANTED
    assert inputs.gate.state is GateState.DRIVING


def test_foreign_proposals_during_a_stop_are_counted_and_its_reason_stays() -> None:
    inputs, planner = ready(), Planner()
    inputs.proposal(planner.message(0.0), at(0.0))
    inputs.gate.refuse('the first reason', at(0.1))
    answer = inputs.proposal(Planner(None).message(0.2), at(0.25))
    assert (answer.stamp_ns, answer.control.throttle) == (250_000_000, 0.0)
    assert inputs.gate.counts['foreign_proposals'] == 1
    assert inputs.gate.reason == 'the first reason'
    assert inputs.proposals.foreign == 1


def test_unsigned_proposals_pass_only_where_that_is_asked_for() -> None:
    inputs, planner = ready(signed_proposals=False), Planner(None)
    assert inputs.proposal(planner.message(0.0), at(0.0)).control == WANTED
    assert inputs.statuses.key == KEY, 'the vehicle still has to sign'
    assert inputs.proposal(Planner(None).message(0.1), at(0.1)).control.throttle == 0.0


def test_odometry_that_is_none_is_refused_and_counts_as_missing() -> None:
    inputs = GateInputs(Gate(), KEY)
    assert 'not finite' in inputs.odometry(odometry(0.0, float('inf')), at(0.0))
    assert inputs.gate.speed_mps is None
    inputs.odometry(odometry(0.1, 0.2), at(0.1))
    assert inputs.gate.speed_mps == 0.2


def test_the_stamps_of_odometry_are_those_of_the_messages() -> None:
    inputs = ready()
    inputs.odometry(odometry(1.0, 20.0), at(0.01))
    assert inputs.gate.reason == 'the car moves, and this gate has not driven it', '20 m/s in a second are possible'
    inputs = ready()
    inputs.odometry(odometry(0.01, 20.0), at(1.0))
    assert inputs.gate.reason == 'odometry contradicts itself: a second publisher?'


def test_a_status_tells_the_speed_and_a_foreign_one_stops_the_car() -> None:
    inputs, vehicle = ready(), Vehicle()
    assert inputs.status(vehicle.message(0.1, 0.1), at(0.1)) == ''
    assert inputs.gate.speed_mps == 0.1
    assert inputs.status(Vehicle(None).message(0.2, 9.0), at(0.2)) == 'not signed'
    assert inputs.gate.speed_mps == 0.1
    assert inputs.gate.state is GateState.EMERGENCY_STOP
    assert inputs.gate.reason == 'invalid vehicle status: not signed'


def test_a_status_that_is_none_stops_the_car() -> None:
    inputs, vehicle = ready(), Vehicle()
    assert 'not finite: speed_mps is nan' in inputs.status(vehicle.message(0.1, float('nan')), at(0.1))
    assert inputs.gate.state is GateState.EMERGENCY_STOP


def test_a_vehicle_that_was_started_again_stops_the_car_once() -> None:
    inputs = ready()
    inputs.status(Vehicle().message(0.1), at(0.1))
    again = Vehicle()
    assert inputs.status(again.message(0.2), at(0.2)).startswith('another sender')
    assert inputs.status(again.message(0.3), at(0.3)) == ''
    assert inputs.gate.state is GateState.EMERGENCY_STOP
    assert inputs.gate.activate(at(0.3)) == ''
