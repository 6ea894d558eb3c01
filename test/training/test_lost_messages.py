"""Whatever a bag has lost, training takes no two drives for one, nor a gap for a step, and counts what is missing."""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from msg_adapters.factory import RosbagsFactory
from msg_adapters.privileged import transition_from_message, transition_to_message
from raw2drive_ros.contracts import topics
from raw2drive_ros.contracts.privileged import Transition
from raw2drive_ros.evaluation.collect import CollectConfig, collect
from raw2drive_ros.evaluation.world_drivers import rule_driver
from raw2drive_ros.recording.bag_reader import find_bags, open_bag
from raw2drive_ros.recording.bag_writer import BagWriter
from raw2drive_ros.recording.ticks import TickCounts, read_ticks
from raw2drive_ros.tables.rates import DECISION_NS
from raw2drive_ros.training.config import make_config
from raw2drive_ros.training.dataset import CUT, FIRST, TERMINAL, BagArrays, load_bag

FACTORY = RosbagsFactory()
EPISODE_TICKS, EPISODES = 8, 3
PARTS = (topics.BEV, topics.EGO, topics.TRANSITION, topics.IMU, topics.ODOMETRY)
CONFIG = make_config('nano').model


@dataclass(frozen=True)
class Drive:
    """A bag as rows (topic, stamp, CDR bytes). ticks: (stamp, episode, is terminal), in order; a tick's reward is its
    number / 100, which tells it apart in the arrays."""

    rows: list[tuple[str, int, bytes]]
    ticks: list[tuple[int, str, bool]]


@pytest.fixture(scope='module')
def drive(tmp_path_factory) -> Drive:
    folder = tmp_path_factory.mktemp('drive') / 'bags'
    config = CollectConfig(('LaneFollowing',), EPISODE_TICKS * EPISODES, cameras=False, episode_ticks=EPISODE_TICKS)
    for _ in collect(folder, config, rule_driver(0.1), {'driver': 'rule'}):
        pass
    (bag,) = find_bags([folder])
    with open_bag(bag) as reader:
        found = [(c.topic, stamp, bytes(data)) for c, stamp, data in reader.messages()]
    steps = [
        transition_from_message(FACTORY.deserialize(data, 'sensor_msgs/msg/JointState'))
        for topic, _, data in found
        if topic == topics.TRANSITION
    ]
    ticks = []
    for number, (step, episode) in enumerate(steps):
        ends = number + 1 == len(steps) or steps[number + 1][0].is_first
        # The first episode is cut by the collector, the others end in a crash.
        ticks.append((step.stamp_ns, episode, ends and episode != steps[0][1]))
        changed = Transition(step.stamp_ns, step.action, number / 100, {}, step.is_first, ticks[-1][2], ticks[-1][2])
        steps[number] = changed, episode
    said = {step.stamp_ns: transition_to_message(FACTORY, step, episode) for step, episode in steps}
    rows = [
        (topic, at, FACTORY.serialize(said[at], 'sensor_msgs/msg/JointState') if topic == topics.TRANSITION else data)
        for topic, at, data in found
    ]
    assert len({episode for _, episode, _ in ticks}) == EPISODES
    assert sum(terminal for _, _, terminal in ticks) >= 2
    return Drive(rows, ticks)


def arrays(rows: list[tuple[str, int, bytes]], folder: Path) -> BagArrays:
    with BagWriter(folder / 'bag', {'driver': 'rule'}, compress=False) as writer:
        for topic, stamp_ns, data in rows:
            writer.write_raw(topic, stamp_ns, data)
    return load_bag(folder / 'bag', folder / 'cache', CONFIG, cameras=False)


def numbers(found: BagArrays) -> list[int]:
    """Which ticks of the drive the arrays hold."""
    return [round(float(reward) * 100) for reward in found.reward]


def check(drive: Drive, found: BagArrays) -> None:
    """The rules that no loss of messages may break."""
    held = numbers(found)
    assert held == sorted(set(held))
    firsts = (found.flags & FIRST) > 0
    assert firsts[0]
    for (before, after), first in zip(itertools.pairwise(held), firsts[1:], strict=True):
        same_episode = drive.ticks[before][1] == drive.ticks[after][1]
        next_tick = drive.ticks[after][0] - drive.ticks[before][0] == DECISION_NS
        if not (same_episode and next_tick and after == before + 1):
            assert first, f'tick {after} follows {before} as one step'
    # A cut step teaches neither an action nor that the episode ended.
    cuts = (found.flags & CUT) > 0
    assert (found.action[cuts] == -1).all()
    for number, (_, episode, terminal) in enumerate(drive.ticks):
        if not terminal:
            continue
        if number in held:
            assert found.flags[held.index(number)] & TERMINAL
        else:
            # The crash is gone: what is left of the episode has to end in the arrays, and be counted.
            later = [i for i, n in enumerate(held) if n > number]
            assert not later or firsts[later[0]]
            assert not any(drive.ticks[n][1] == episode and n > number for n in held)
    lost = len(drive.ticks) - len(held)
    told = found.losses.incomplete + found.losses.missing
    assert told <= lost
    if lost:
        inside = held and [n for n in range(held[0], held[-1]) if n not in held and _inside(drive, held, n)]
        assert told >= len(inside or [])


def _inside(drive: Drive, held: list[int], number: int) -> bool:
    """Whether ticks of the same episode before and after the lost one are there, so that its absence shows."""
    episode = drive.ticks[number][1]
    same = [n for n in held if drive.ticks[n][1] == episode]
    return bool(same) and min(same) < number < max(same)


def test_the_whole_bag_holds_every_tick(drive, tmp_path) -> None:
    found = arrays(drive.rows, tmp_path)
    assert numbers(found) == list(range(len(drive.ticks)))
    assert found.losses.incomplete == found.losses.missing == found.losses.cuts == 0
    check(drive, found)


@pytest.mark.parametrize('topic', PARTS)
@pytest.mark.parametrize('which', ['the first tick', 'a crash', 'the tick after a crash', 'one in the middle'])
def test_one_lost_message(drive, tmp_path, topic, which) -> None:
    crash = next(i for i, tick in enumerate(drive.ticks) if tick[2])
    number = {'the first tick': 0, 'a crash': crash, 'the tick after a crash': crash + 1, 'one in the middle': 4}[which]
    stamp_ns = drive.ticks[number][0]
    rows = [row for row in drive.rows if row[:2] != (topic, stamp_ns)]
    assert len(rows) == len(drive.rows) - 1
    found = arrays(rows, tmp_path)
    assert number not in numbers(found)
    assert found.losses.incomplete + found.losses.missing == 1
    check(drive, found)


@settings(deadline=None, max_examples=80, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.data())
def test_any_run_of_lost_messages(drive, tmp_path_factory, data) -> None:
    first = data.draw(st.integers(0, len(drive.rows) - 1), label='from row')
    count = data.draw(st.integers(1, 60), label='messages')
    only = data.draw(st.sampled_from([None, *PARTS, topics.ROUTE]), label='topic')
    run = range(first, first + count)
    rows = [row for i, row in enumerate(drive.rows) if i not in run or (only is not None and row[0] != only)]
    present = {row[0] for row in rows}
    if not {*PARTS, topics.ROUTE} <= present:
        return
    check(drive, arrays(rows, tmp_path_factory.mktemp('lost')))


@settings(deadline=None, max_examples=40, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.sets(st.integers(0, 400), min_size=1, max_size=12))
def test_any_set_of_lost_messages(drive, tmp_path_factory, lost) -> None:
    rows = [row for i, row in enumerate(drive.rows) if i not in lost or row[0] == topics.ROUTE]
    check(drive, arrays(rows, tmp_path_factory.mktemp('lost')))


def test_reader_and_training_count_the_same(drive, tmp_path) -> None:
    rows = [row for i, row in enumerate(drive.rows) if i % 17 != 5 or row[0] == topics.ROUTE]
    found = arrays(rows, tmp_path)
    counts = TickCounts()
    with open_bag(tmp_path / 'bag') as reader:
        read = [tick.stamp_ns for tick in read_ticks(reader, tmp_path, cameras=False, counts=counts)]
    assert len(read) == len(found) == counts.ticks
    assert (counts.incomplete, counts.missing) == (found.losses.incomplete, found.losses.missing)
    assert counts.dropped > 0
    assert np.isfinite(found.reward).all()
