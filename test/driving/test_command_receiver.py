"""The vehicle's end: one gate is obeyed; anybody else stops the car, until the gate is activated again."""

import pytest

from msg_adapters.commands import ACTIVATION, decision_to_message
from msg_adapters.factory import RosbagsFactory
from raw2drive_ros.contracts import topics
from raw2drive_ros.contracts.public import Control, Decision, VehicleStatus
from raw2drive_ros.driving.command_policy import CommandPolicy
from raw2drive_ros.driving.command_receiver import CommandReceiver
from raw2drive_ros.driving.single_writer import Sender

FACTORY, KEY = RosbagsFactory(), bytes(range(32))
WANTED = Control(0.5, 0.0, 0.2)


class GateStandIn:
    """Sends what the gate's node sends."""

    def __init__(self, key: bytes | None = KEY) -> None:
        self.sender, self.activation = Sender(topics.COMMAND, key), 0

    def message(self, control: Control = WANTED, **extras: float):
        decision = Decision(5, control, sequence=self.sender.next())
        message = decision_to_message(FACTORY, decision, {ACTIVATION: float(self.activation)} | extras)
        return self.sender.sign(message)


def receiver(key: bytes | None = KEY) -> CommandReceiver:
    return CommandReceiver(CommandPolicy(0.3, 0.6), key)


def test_the_gate_is_obeyed() -> None:
    vehicle, gate = receiver(), GateStandIn()
    decision = vehicle.receive(gate.message())
    assert decision is not None
    assert decision.control == WANTED
    assert (vehicle.stopped, vehicle.refused) == ('', 0)


@pytest.mark.parametrize(
    ('made', 'words'),
    [
        (lambda gate: GateStandIn(None).message(Control(1.0)), 'not signed'),
        (lambda gate: GateStandIn(bytes(32)).message(Control(1.0)), 'its signature does not fit'),
        (lambda gate: GateStandIn().message(Control(1.0)), 'another sender'),
        (lambda gate: gate.message(Control(1.5)), 'Control.throttle 1.5 outside'),
        (lambda gate: gate.message(Control(float('nan'))), 'named values: not finite: throttle is nan'),
        (lambda gate: gate.message(activation=0.5), 'activation is 0.5'),
        (lambda gate: gate.message(activation=-1.0), 'activation is -1'),
    ],
)
def test_what_is_no_command_of_the_gate_stops_the_car_until_the_gate_is_activated(made, words) -> None:
    vehicle, gate = receiver(), GateStandIn()
    vehicle.policy.accept(vehicle.receive(gate.message()).control, 0)
    assert vehicle.receive(made(gate)) is None
    assert vehicle.stopped.startswith(f'a message on {topics.COMMAND} was refused: {words}')
    assert vehicle.brake() == Control(0.0, 0.6, WANTED.steer)
    assert vehicle.refused == 1
    assert vehicle.receive(gate.message()) is None, 'the genuine gate too: the stop is latched'
    assert vehicle.status(9, 3.0, 1).stopped
    gate.activation = 1
    assert vehicle.receive(gate.message()) is not None
    assert vehicle.stopped == ''
    assert vehicle.status(9, 3.0, 2).activation == 1


def test_a_stop_outlives_the_gate() -> None:
    vehicle, gate = receiver(), GateStandIn()
    gate.activation = 4
    vehicle.receive(gate.message())
    other = GateStandIn()
    assert vehicle.receive(other.message()) is None, 'a new gate during a drive is a changed identity'
    assert 'another sender' in vehicle.stopped
    assert vehicle.receive(other.message()) is None
    # The new gate hears the vehicle's status, and its next activation is newer than what the vehicle has heard.
    other.activation = vehicle.status(9, 0.0, 1).activation + 1
    assert vehicle.receive(other.message()) is not None
    assert vehicle.stopped == ''


def test_the_first_reason_of_a_stop_stays() -> None:
    vehicle, gate = receiver(), GateStandIn()
    vehicle.receive(GateStandIn(None).message())
    vehicle.receive(gate.message(Control(2.0)))
    assert vehicle.stopped.endswith('not signed')
    assert vehicle.refused == 2


def test_a_replay_after_an_activation_does_not_move_the_car() -> None:
    vehicle, gate = receiver(), GateStandIn()
    heard = [gate.message(Control(1.0)) for _ in range(3)]
    for message in heard:
        assert vehicle.receive(message) is not None
    assert vehicle.receive(heard[1]) is None
    assert 'sequence number 2 after 3' in vehicle.stopped
    gate.activation = 1
    activated = gate.message()
    assert vehicle.receive(activated) is not None
    assert vehicle.receive(activated) is None
    assert vehicle.stopped


def test_a_new_place_ends_the_stop_and_the_hold() -> None:
    vehicle, gate = receiver(), GateStandIn()
    vehicle.policy.accept(WANTED, 0)
    vehicle.receive(GateStandIn(None).message())
    before = vehicle.placed
    vehicle.ticks = 7
    vehicle.place()
    assert (vehicle.stopped, vehicle.policy.last, vehicle.ticks) == ('', None, 0)
    assert vehicle.placed > before
    assert vehicle.brake() == Control(0.0, 0.6, 0.0)
    assert vehicle.receive(gate.message()) is not None
    first = vehicle.placed
    vehicle.place()
    assert vehicle.placed > first


def test_an_unsigned_gate_is_obeyed_only_where_that_is_asked_for() -> None:
    vehicle, gate = receiver(None), GateStandIn(None)
    assert vehicle.receive(gate.message()) is not None
    assert vehicle.receive(GateStandIn(None).message()) is None
    assert 'sequence number 1 after 1' in vehicle.stopped


def test_a_command_without_an_activation_is_one_of_the_first() -> None:
    vehicle, sender = receiver(), Sender(topics.COMMAND, KEY)
    message = sender.sign(decision_to_message(FACTORY, Decision(5, WANTED, sequence=sender.next())))
    assert vehicle.receive(message) is not None
    assert vehicle.activation == 0


def test_the_status_says_all_that_the_gate_needs() -> None:
    vehicle = receiver()
    vehicle.activation, vehicle.placed, vehicle.ticks = 4, 7, 12
    assert vehicle.status(9, -3.5, 11) == VehicleStatus(9, -3.5, activation=4, placed=7, ticks=12, sequence=11)
    vehicle.stopped = 'x'
    assert vehicle.status(9, None, 12) == VehicleStatus(
        9, None, stopped=True, activation=4, placed=7, ticks=12, sequence=12
    )


def test_places_are_counted_in_milliseconds_and_never_twice(monkeypatch) -> None:
    vehicle, now_ns = receiver(), 1_700_000_000_123_456_789
    monkeypatch.setattr('raw2drive_ros.driving.command_receiver.time.time_ns', lambda: now_ns)
    found = []
    for _ in range(3):
        vehicle.place()
        found.append(vehicle.placed)
    assert found == [1_700_000_000_123, 1_700_000_000_124, 1_700_000_000_125]
    assert all(isinstance(placed, int) for placed in found)


def test_a_stopped_car_keeps_its_gear() -> None:
    vehicle = receiver()
    vehicle.policy.accept(Control(0.5, 0.0, 0.2, reverse=True), 0)
    assert vehicle.brake() == Control(0.0, 0.6, 0.2, reverse=True)
