"""One writer per topic: the first valid sender is kept, and nobody else passes, by number, session or signature."""

import copy
from collections.abc import Iterator

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from msg_adapters.commands import decision_to_message
from msg_adapters.factory import RosbagsFactory
from msg_adapters.named_values import MAX_VALUES
from raw2drive_ros.contracts import topics
from raw2drive_ros.contracts.public import Control, Decision
from raw2drive_ros.driving.single_writer import Sender, SingleWriter, new_session

FACTORY, KEY, OTHER_KEY = RosbagsFactory(), bytes(range(32)), bytes(32)


def messages(sender: Sender, throttle: float = 0.3) -> Iterator:
    while True:
        number = sender.next()
        decision = Decision(number * 100_000_000, Control(throttle), sequence=number)
        yield sender.sign(decision_to_message(FACTORY, decision))


def test_one_sender_passes_for_as_long_as_it_counts() -> None:
    writer, sent = SingleWriter(topics.COMMAND, KEY), messages(Sender(topics.COMMAND, KEY))
    assert not writer.bound
    assert [writer.check(next(sent)) for _ in range(5)] == [''] * 5
    assert writer.bound
    next(sent)
    assert writer.check(next(sent)) == '', 'a lost message is no second writer'
    assert writer.foreign == 0


def test_a_stranger_is_refused_at_the_first_message_and_changes_nothing() -> None:
    writer, sent = SingleWriter(topics.COMMAND, KEY), messages(Sender(topics.COMMAND, KEY))
    unsigned = messages(Sender(topics.COMMAND))
    assert writer.check(next(unsigned)) == 'not signed'
    assert not writer.bound
    assert writer.check(next(sent)) == ''
    assert writer.check(next(unsigned)) == 'not signed'
    assert writer.check(next(messages(Sender(topics.COMMAND, OTHER_KEY)))).startswith('its signature does not fit')
    assert writer.check(next(messages(Sender(topics.PROPOSED, KEY)))).startswith('its signature does not fit')
    assert writer.check(next(sent)) == ''
    assert writer.foreign == 4


def test_a_captured_message_is_refused_also_after_a_release() -> None:
    writer, sent = SingleWriter(topics.COMMAND, KEY), messages(Sender(topics.COMMAND, KEY))
    heard = [next(sent) for _ in range(3)]
    assert [writer.check(message) for message in heard] == [''] * 3
    assert writer.check(heard[2]) == 'sequence number 3 after 3: repeated, or out of order'
    assert writer.check(heard[0]) == 'sequence number 1 after 3: repeated, or out of order'
    writer.release()
    assert writer.check(heard[2]) == 'sequence number 3 after 3: repeated, or out of order'
    assert not writer.bound


def test_a_second_process_with_the_key_is_refused_until_a_release() -> None:
    writer, of_one, of_two = SingleWriter(topics.COMMAND, KEY), new_session(), new_session()
    one, two = (messages(Sender(topics.COMMAND, KEY, session)) for session in (of_one, of_two))
    assert writer.check(next(one)) == ''
    assert (
        writer.check(next(two)) == f'another sender (session {of_two[-8:]}) than the one so far (session {of_one[-8:]})'
    )
    writer.release()
    assert writer.check(next(two)) == ''
    assert writer.check(next(one)).startswith('another sender')


def test_a_signed_message_needs_a_number() -> None:
    sender = Sender(topics.COMMAND, KEY)
    message = sender.sign(decision_to_message(FACTORY, Decision(5, Control())))
    assert SingleWriter(topics.COMMAND, KEY).check(message) == 'it has no sequence number'


def test_without_a_key_numbers_and_contradictions_reveal_a_second_sender() -> None:
    writer = SingleWriter(topics.PROPOSED)
    one, two = messages(Sender(topics.PROPOSED)), messages(Sender(topics.PROPOSED), 0.9)
    assert writer.check(next(one)) == ''
    assert writer.check(next(two)) == 'sequence number 1 after 1: repeated, or out of order'
    signed = next(messages(Sender(topics.PROPOSED, KEY)))
    assert writer.check(signed).startswith('another sender (session ')
    assert writer.check(signed).endswith('than the one so far (unsigned)')
    writer.release()
    assert writer.check(next(messages(Sender(topics.PROPOSED)))) == '', 'a new process begins to count at 1'


def test_without_numbers_one_stamp_has_one_content() -> None:
    writer = SingleWriter(topics.PROPOSED)

    def plain(stamp_ns: int, throttle: float):
        return decision_to_message(FACTORY, Decision(stamp_ns, Control(throttle)))

    assert writer.check(plain(5, 0.3)) == ''
    assert writer.check(plain(5, 0.3)) == '', 'sent again for a tick that was sent again'
    assert writer.check(plain(5, 0.9)) == 'it says something else under the same stamp: a second publisher?'
    assert writer.check(plain(6, 0.9)) == ''


def test_sessions_differ_and_sort_by_their_start() -> None:
    found = [new_session() for _ in range(100)]
    assert len(set(found)) == 100
    assert {len(session) for session in found} == {24}
    assert [session[:16] for session in found] == sorted(session[:16] for session in found)


@settings(deadline=None)
@given(st.lists(st.sampled_from(['gate', 'stranger', 'replay', 'changed', 'other key']), max_size=40))
def test_in_any_order_exactly_the_new_messages_of_the_gate_pass(kinds) -> None:
    writer, gate = SingleWriter(topics.COMMAND, KEY), messages(Sender(topics.COMMAND, KEY))
    stranger = {
        'stranger': messages(Sender(topics.COMMAND), 1.0),
        'other key': messages(Sender(topics.COMMAND, OTHER_KEY), 1.0),
    }
    heard: list = []
    for kind in kinds:
        if kind in stranger:
            assert writer.check(next(stranger[kind]))
        elif kind == 'gate':
            heard.append(next(gate))
            assert writer.check(heard[-1]) == ''
        elif heard:
            message = copy.deepcopy(heard[0])
            if kind == 'changed':
                message.position = np.array(message.position) + 1.0
            assert writer.check(message)


@pytest.mark.parametrize('names', [[], ['sequence'], ['sequence', 'sequence']])
def test_malformed_unsigned_messages_are_left_to_their_reader(names) -> None:
    message = decision_to_message(FACTORY, Decision(5, Control()))
    message.name, message.position = names, np.array([])
    assert SingleWriter(topics.COMMAND).check(message) == ''
    assert SingleWriter(topics.COMMAND, KEY).check(message) == 'not signed'


def test_numbered_messages_may_answer_one_stamp_differently() -> None:
    writer = SingleWriter(topics.PROPOSED)
    for number, throttle in ((1, 0.3), (2, 0.9)):
        assert writer.check(decision_to_message(FACTORY, Decision(5, Control(throttle), sequence=number))) == ''


@pytest.mark.parametrize('number', [float('inf'), float('nan'), 1e300, -(2.0**64)])
def test_numbers_that_are_none_are_left_to_the_reader(number) -> None:
    message = decision_to_message(FACTORY, Decision(5, Control(), sequence=1))
    message.position = np.array([*message.position[:-1], number])
    assert SingleWriter(topics.PROPOSED).check(message) == ''


def test_the_longest_message_that_is_read_is_also_authenticated() -> None:
    sender = Sender(topics.COMMAND, KEY)
    extras = {f'v{i}': 0.0 for i in range(MAX_VALUES - 7)}
    message = decision_to_message(FACTORY, Decision(5, Control(), sequence=sender.next()), extras)
    assert len(message.name) == MAX_VALUES
    assert SingleWriter(topics.COMMAND, KEY).check(sender.sign(message)) == ''
    extras['one more'] = 0.0
    message = decision_to_message(FACTORY, Decision(5, Control(), sequence=sender.next()), extras)
    assert SingleWriter(topics.COMMAND, KEY).check(sender.sign(message)) == 'not signed'


def test_the_session_tells_when_its_process_began(monkeypatch) -> None:
    monkeypatch.setattr('raw2drive_ros.driving.single_writer.time.time_ns', lambda: 1_700_000_000_123_456_789)
    assert int(new_session()[:16], 16) == 1_700_000_000_123_456
