"""Signatures: whatever is changed, moved to another topic, or signed by somebody else is not authentic."""

import copy

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from msg_adapters.commands import decision_from_message, decision_to_message
from msg_adapters.factory import RosbagsFactory
from msg_adapters.named_values import MAX_VALUES, named_values_from_message
from msg_adapters.signatures import is_authentic, session_of, sign
from msg_adapters.vehicle_status import status_from_message, status_to_message
from raw2drive_ros.contracts import topics
from raw2drive_ros.contracts.errors import ContractError
from raw2drive_ros.contracts.public import Control, Decision, VehicleStatus

FACTORY = RosbagsFactory()
KEY, SESSION = bytes(range(32)), 'ab' * 12


def signed(**values):
    message = decision_to_message(FACTORY, Decision(5, Control(0.5, 0.0, 0.2), 3, 1.5, 7), values)
    return sign(message, topics.COMMAND, KEY, SESSION)


def test_what_was_signed_is_authentic_and_still_reads_the_same() -> None:
    message = signed(activation=2.0)
    assert is_authentic(message, topics.COMMAND, KEY)
    assert session_of(message) == SESSION
    wire = FACTORY.serialize(message, 'sensor_msgs/msg/JointState')
    read = FACTORY.deserialize(wire, 'sensor_msgs/msg/JointState')
    assert is_authentic(read, topics.COMMAND, KEY)
    assert decision_from_message(read) == Decision(5, Control(0.5, 0.0, 0.2), 3, 1.5, 7, {'activation': 2.0})


def test_a_message_without_a_signature_is_not() -> None:
    message = decision_to_message(FACTORY, Decision(5, Control()))
    assert not is_authentic(message, topics.COMMAND, KEY)
    assert session_of(message) == ''
    message.header.frame_id = 'base_link'
    assert not is_authentic(message, topics.COMMAND, KEY)


CHANGES = {
    'another topic': lambda m: topics.PROPOSED,
    'another value': lambda m: m.position.__setitem__(0, 0.51),
    'the sign of a zero': lambda m: m.position.__setitem__(1, -0.0),
    'another stamp': lambda m: setattr(m.header.stamp, 'nanosec', 6),
    'another second': lambda m: setattr(m.header.stamp, 'sec', -1),
    'another name': lambda m: m.name.__setitem__(0, 'brake'),
    'names run together': lambda m: setattr(m, 'name', [m.name[0] + m.name[1], '', *m.name[2:]]),
    'a velocity': lambda m: setattr(m, 'velocity', np.array([1.0])),
    'an effort': lambda m: setattr(m, 'effort', np.array([1.0])),
    'one value moved to the velocities': lambda m: (
        setattr(m, 'velocity', m.position[-1:]),
        setattr(m, 'position', m.position[:-1]),
    ),
    'another session': lambda m: setattr(m.header, 'frame_id', 'cd' + m.header.frame_id[2:]),
    'another tag': lambda m: setattr(m.header, 'frame_id', m.header.frame_id[:-1] + 'g'),
    'a shorter tag': lambda m: setattr(m.header, 'frame_id', m.header.frame_id[:-1]),
}


@pytest.mark.parametrize('change', CHANGES)
def test_whatever_changes_on_the_way_is_noticed(change) -> None:
    message = signed()
    message.position = np.array(message.position)
    topic = CHANGES[change](message)
    assert not is_authentic(message, topic if isinstance(topic, str) else topics.COMMAND, KEY)


def test_another_key_signs_other_tags() -> None:
    assert not is_authentic(signed(), topics.COMMAND, bytes(32))
    assert not is_authentic(sign(signed(), topics.COMMAND, bytes(32), SESSION), topics.COMMAND, KEY)


@settings(deadline=None)
@given(st.integers(0, 6), st.integers(0, 63))
def test_any_flipped_bit_of_a_value_is_noticed(index, bit) -> None:
    message = signed()
    bits = np.array(message.position).view(np.uint64)
    bits[index] ^= np.uint64(1) << np.uint64(bit)
    message.position = bits.view(np.float64)
    assert not is_authentic(message, topics.COMMAND, KEY)


def test_a_status_goes_through_a_message() -> None:
    for speed_mps in (None, -3.5):
        status = VehicleStatus(9, speed_mps, stopped=True, activation=4, placed=2**50, ticks=12, sequence=3)
        message = sign(status_to_message(FACTORY, status), topics.STATUS, KEY, SESSION)
        assert status_from_message(message) == status


def command(**changes):
    message = decision_to_message(FACTORY, Decision(5, Control(0.5, 0.0, 0.2), 3, 1.5, 7))
    values = dict(zip(message.name, message.position, strict=True)) | changes
    message.name, message.position = list(values), np.array(list(values.values()))
    return message


@pytest.mark.parametrize(
    ('changes', 'words'),
    [
        ({'reverse': 0.7}, 'reverse is 0.7, not 0 or 1'),
        ({'reverse': 1e308}, 'reverse is 1e'),
        ({'reverse': float('nan')}, 'not finite: reverse is nan'),
        ({'inference_ms': float('inf')}, 'not finite: inference_ms is inf'),
        ({'anything': float('nan')}, 'not finite: anything is nan'),
        ({'action': 1.5}, 'action is 1.5'),
        ({'sequence': -1.0}, 'sequence is -1'),
        ({'sequence': 1e300}, 'sequence is 1e'),
    ],
)
def test_values_that_are_no_command_are_refused(changes, words) -> None:
    with pytest.raises(ContractError, match=words):
        decision_from_message(command(**changes))


def test_names_are_unique_and_not_too_many() -> None:
    twice = command()
    twice.name = [*twice.name, 'throttle']
    twice.position = np.append(twice.position, 1.0)
    with pytest.raises(ContractError, match='throttle more than once'):
        named_values_from_message(twice)
    many = command(**{f'v{i}': 0.0 for i in range(MAX_VALUES)})
    with pytest.raises(ContractError, match=f'more than {MAX_VALUES}'):
        named_values_from_message(many)
    short = copy.deepcopy(command())
    short.position = short.position[:-1]
    with pytest.raises(ContractError, match='7 names but 6 positions'):
        named_values_from_message(short)
