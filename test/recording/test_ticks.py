"""Ticks out of samples: which are whole, where sequences begin, what is counted, in how much memory."""

import numpy as np
import pytest

from msg_adapters.factory import RosbagsFactory
from msg_adapters.privileged import (
    advice_from_message,
    advice_to_message,
    ego_from_message,
    ego_to_message,
    transition_from_message,
    transition_to_message,
)
from raw2drive_ros.contracts import topics
from raw2drive_ros.contracts.errors import ContractError
from raw2drive_ros.contracts.privileged import BEV_SHAPE, Advice, PrivilegedFrame, Transition
from raw2drive_ros.contracts.public import ImuSample, OdometrySample, Route
from raw2drive_ros.contracts.verdicts import Verdicts
from raw2drive_ros.recording.ticks import MOTION_SAMPLES, PENDING_TICKS, BagTick, TickAssembler, TickCounts
from raw2drive_ros.tables.rates import DECISION_NS

FACTORY = RosbagsFactory()
BEV, EGO = np.zeros(BEV_SHAPE, bool), np.zeros(5, np.float32)
CORNERS = np.array([[0.0, 0.0], [25.0, 0.0]])


class Bag:
    """Feeds an assembler tick by tick. `tick` returns what has become complete."""

    def __init__(self) -> None:
        self.counts = TickCounts()
        self.ticks = TickAssembler((), self.counts, privileged=True)

    def route(self, number: int) -> None:
        self.ticks.add_route(Route(number * DECISION_NS, CORNERS))

    def motion(self, number: int) -> None:
        stamp_ns = number * DECISION_NS
        self.ticks.add_imu(ImuSample(stamp_ns, (0.0, 0.0, 9.8), (0.0, 0.0, 0.0)), stamp_ns)
        self.ticks.add_odometry(OdometrySample(stamp_ns, 0.0, 0.0, 0.0, 0.0, 0.0), stamp_ns)

    def tick(self, number: int, episode: str, *, lost: str = '', **marks: bool) -> list[BagTick]:
        stamp_ns = number * DECISION_NS
        self.motion(number)
        flags = dict.fromkeys(('is_first', 'is_terminal', 'is_last'), False) | marks
        step = Transition(stamp_ns, -1 if flags['is_first'] else 3, 0.5, {}, **flags)
        parts = {topics.BEV: BEV, topics.EGO: EGO, topics.TRANSITION: (step, episode)}
        for topic, value in parts.items():
            if topic != lost:
                self.ticks.add_part(topic, stamp_ns, value)
        return self.ticks.take()


def test_a_crash_whose_tick_is_incomplete_ends_its_episode_all_the_same() -> None:
    """Both episodes have one name and the next tick is none period away: only the transition tells."""
    bag = Bag()
    bag.route(0)
    (first,) = bag.tick(0, 'A/1', is_first=True)
    bag.tick(1, 'A/1')
    assert bag.tick(2, 'A/1', lost=topics.BEV, is_terminal=True, is_last=True) == []
    bag.route(3)
    (begun,) = bag.tick(3, 'A/1', is_first=True)
    assert first.starts_episode and begun.starts_episode and begun.starts_segment
    assert (bag.counts.ends_lost, bag.counts.begins_lost, bag.counts.incomplete, bag.counts.cuts) == (1, 0, 1, 0)


def test_an_episode_whose_first_tick_is_lost_is_an_episode_of_its_own() -> None:
    bag = Bag()
    bag.route(0)
    bag.tick(0, 'A/1', is_first=True)
    (ended,) = bag.tick(1, 'A/1', is_last=True)
    bag.route(2)
    bag.tick(2, 'A/1', lost=topics.EGO, is_first=True)
    (begun,) = bag.tick(3, 'A/1')
    (next_one,) = bag.tick(4, 'A/1')
    assert [ended.starts_segment, begun.starts_segment, next_one.starts_segment] == [False, True, False]
    assert begun.starts_episode
    assert (bag.counts.begins_lost, bag.counts.cuts) == (1, 1)


def test_without_the_first_and_the_last_transition_the_name_tells() -> None:
    bag = Bag()
    bag.route(0)
    bag.tick(0, 'A/1', is_first=True)
    bag.route(1)
    (begun,) = bag.tick(1, 'B/1')
    assert begun.starts_episode and begun.starts_segment


def test_a_tick_waits_for_the_route_of_its_episode_and_takes_no_other() -> None:
    bag = Bag()
    bag.route(0)
    bag.tick(0, 'A/1', is_first=True)
    assert bag.tick(1, 'B/1', is_first=True) == []
    assert bag.tick(2, 'B/1') == []
    bag.route(1)
    late = bag.ticks.take()
    assert [tick.stamp_ns // DECISION_NS for tick in late] == [1, 2]
    assert all(tick.route.stamp_ns == DECISION_NS for tick in late)
    bag.tick(3, 'C/1', is_first=True)
    bag.ticks.finish()
    assert (bag.counts.ticks, bag.counts.without_route, bag.counts.begins_lost) == (3, 1, 1)


def test_a_route_for_the_next_episode_is_not_that_of_the_last_tick() -> None:
    bag = Bag()
    bag.route(0)
    bag.tick(0, 'A/1', is_first=True)
    bag.route(2)
    (ended,) = bag.tick(1, 'A/1', is_last=True)
    (begun,) = bag.tick(2, 'B/1', is_first=True)
    assert (ended.route.stamp_ns, begun.route.stamp_ns) == (0, 2 * DECISION_NS)


def test_whole_ticks_that_are_missing_are_counted_and_cut() -> None:
    bag = Bag()
    bag.route(0)
    bag.tick(0, 'A/1', is_first=True)
    bag.tick(2, 'A/1', lost=topics.TRANSITION)
    (after,) = bag.tick(5, 'A/1')
    assert after.starts_segment and not after.starts_episode
    assert (bag.counts.incomplete, bag.counts.missing, bag.counts.dropped, bag.counts.cuts) == (1, 3, 4, 1)


def test_a_tick_that_is_sent_again_is_there_once_and_time_that_goes_back_begins_anew() -> None:
    bag = Bag()
    bag.route(0)
    bag.tick(20, 'A/1', is_first=True)
    assert bag.tick(20, 'A/1', is_first=True) == []
    (again,) = bag.tick(1, 'A/1')
    (after,) = bag.tick(2, 'A/1')
    assert again.starts_segment and again.starts_episode and not after.starts_segment
    assert bag.counts.back == 1


def test_ticks_that_never_become_complete_take_bounded_memory() -> None:
    bag = Bag()
    bag.route(0)
    for number in range(4 * MOTION_SAMPLES):
        assert bag.tick(number, 'A/1', lost=topics.EGO, is_first=number == 0) == []
        assert len(bag.ticks.pending) <= PENDING_TICKS
    assert len(bag.ticks.imus) == len(bag.ticks.odometries) == MOTION_SAMPLES
    bag.ticks.finish()
    assert (bag.counts.incomplete, bag.counts.begins_lost) == (4 * MOTION_SAMPLES, 1)


@pytest.mark.parametrize(
    ('field', 'value'),
    [
        ('reward', float('nan')),
        ('reward', float('inf')),
        ('reward', 1e30),
        ('reward/speed', -1e30),
        ('action', 77.0),
        ('action', -5.0),
        ('action', 3.7),
        ('action', float('nan')),
        ('is_first', float('nan')),
        ('is_terminal', 0.5),
        ('is_last', 2.0),
    ],
)
def test_a_transition_with_a_value_that_cannot_be_is_refused(field, value) -> None:
    step = Transition(7, 3, 0.5, {'speed': 0.5}, is_first=False, is_terminal=False, is_last=False)
    message = transition_to_message(FACTORY, step, 'A/1')
    assert transition_from_message(message) == (step, 'A/1')
    message.position[message.name.index(field)] = value
    with pytest.raises(ContractError, match=field.removeprefix('reward/')):
        transition_from_message(message)


@pytest.mark.parametrize(('index', 'value'), [(0, 1e6), (1, -1.5), (2, 1.5), (3, -0.5), (4, float('inf'))])
def test_an_ego_vector_out_of_range_is_refused(index, value) -> None:
    message = ego_to_message(FACTORY, PrivilegedFrame(7, BEV, EGO))
    assert np.array_equal(ego_from_message(message), EGO)
    message.position[index] = value
    with pytest.raises(ContractError, match=str(message.name[index])):
        ego_from_message(message)


@pytest.mark.parametrize('action', [2.5, -1.0, 39.0])
def test_advice_that_is_no_action_is_refused(action) -> None:
    message = advice_to_message(FACTORY, Advice(7, 3))
    message.position[0] = action
    with pytest.raises(ContractError, match='action'):
        advice_from_message(message)


def test_one_refused_message_never_makes_a_bag_unusable_and_more_than_a_share_do() -> None:
    verdicts = Verdicts()
    verdicts.refuse('/a', 5, 'odd')
    assert verdicts.unusable() == ''
    assert verdicts.lines() == ['/a: 1 of 1 messages refused; the first at 5 ns: odd']
    verdicts.refuse('/a', 9, 'odder')
    assert verdicts.unusable().startswith('/a: 2 of 2 messages refused; the first at 5 ns: odd; more than 5%')
    for _ in range(38):
        verdicts.accept('/a')
    assert verdicts.unusable() == ''
