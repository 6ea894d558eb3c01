"""A message gets the same verdict from the planner that drives, from the reader, from the doctor and from training."""

from __future__ import annotations

import pytest
from recording_helpers import FACTORY, messages_of

from raw2drive_ros.contracts import topics
from raw2drive_ros.contracts.errors import BagError
from raw2drive_ros.driving.bundle import load_bundle
from raw2drive_ros.driving.monitor_config import load_monitor_config
from raw2drive_ros.driving.planner_inputs import PlannerInputs
from raw2drive_ros.driving.raw_planner import RawPlanner
from raw2drive_ros.recording.bag_doctor import examine
from raw2drive_ros.recording.bag_reader import open_bag
from raw2drive_ros.recording.bag_writer import BagWriter
from raw2drive_ros.recording.ticks import TickCounts, read_ticks
from raw2drive_ros.settings import default_bundle
from raw2drive_ros.timing import load_timing
from raw2drive_ros.training.config import make_config
from raw2drive_ros.training.dataset import load_bag

NAN = float('nan')


def _position(message, index, value) -> None:
    values = message.position.copy()
    values[index] = value
    message.position = values


# topic -> what is done to one message of it.
DAMAGE = {
    topics.IMU: lambda m: setattr(m.linear_acceleration, 'x', NAN),
    topics.ODOMETRY: lambda m: setattr(m.twist.twist.linear, 'x', float('inf')),
    topics.image_topic('front'): lambda m: setattr(m, 'encoding', 'noise'),
    topics.image_topic('back'): lambda m: setattr(m, 'height', m.height // 2),
    topics.camera_info_topic('back_left'): lambda m: setattr(m, 'k', m.k * NAN),
    topics.EGO: lambda m: _position(m, 0, NAN),
    topics.TRANSITION: lambda m: _position(m, list(m.name).index('reward'), float('inf')),
    topics.BEV: lambda m: setattr(m, 'format', 'png'),
}
PRIVILEGED = (topics.EGO, topics.TRANSITION, topics.BEV)


@pytest.fixture(scope='module')
def damaged(bag, tmp_path_factory):
    """(rows, path) of a bag in which the 12th message of every topic of DAMAGE is damaged."""
    seen: dict[str, int] = {}
    rows = []
    for topic, stamp_ns, data in messages_of(bag):
        seen[topic] = seen.get(topic, 0) + 1
        if topic in DAMAGE and seen[topic] == 12:
            message = FACTORY.deserialize(data, topics.BY_NAME[topic].msgtype)
            DAMAGE[topic](message)
            data = FACTORY.serialize(message, topics.BY_NAME[topic].msgtype)
        rows.append((topic, stamp_ns, data))
    path = tmp_path_factory.mktemp('damaged') / 'bag'
    with BagWriter(path) as writer:
        for topic, stamp_ns, data in rows:
            writer.write_raw(topic, stamp_ns, data)
    return rows, path


def test_planner_reader_doctor_and_training_refuse_the_same_messages(damaged, tmp_path) -> None:
    rows, path = damaged
    limits = load_monitor_config().limits(load_timing())
    inputs = PlannerInputs(RawPlanner(load_bundle(default_bundle()), limits))
    for topic, stamp_ns, data in rows:
        if topic in inputs.handlers:
            inputs.receive(topic, FACTORY.deserialize(data, topics.BY_NAME[topic].msgtype), stamp_ns)
    live = inputs.verdicts
    counts = TickCounts()
    with open_bag(path) as reader:
        ticks = list(read_ticks(reader, path, cameras=True, counts=counts))
    sensors = {topic: 1 for topic in DAMAGE if topic not in PRIVILEGED}
    assert live.refused == sensors
    assert counts.verdicts.refused == sensors | dict.fromkeys(PRIVILEGED, 1)
    assert {topic: live.seen(topic) for topic in sensors} == {topic: counts.verdicts.seen(topic) for topic in sensors}
    said = [each.text for each in examine(path)]
    for topic in DAMAGE:
        assert any(text.startswith(f'{topic}: 1 of ') and ' ns: ' in text for text in said), topic
    found = load_bag(path, tmp_path, make_config('nano').model, cameras=True)
    assert found.losses.refused == counts.verdicts.refused
    assert len(found) == len(ticks) == counts.ticks > 0
    assert found.losses.incomplete == counts.incomplete > 0


def test_a_topic_of_which_too_many_are_refused_makes_the_bag_unusable(bag, tmp_path) -> None:
    path = tmp_path / 'bag'
    with BagWriter(path) as writer:
        for number, (topic, stamp_ns, data) in enumerate(messages_of(bag)):
            if topic == topics.IMU and number % 3 == 0:
                message = FACTORY.deserialize(data, topics.BY_NAME[topic].msgtype)
                DAMAGE[topic](message)
                data = FACTORY.serialize(message, topics.BY_NAME[topic].msgtype)
            writer.write_raw(topic, stamp_ns, data)
    with pytest.raises(BagError, match=r'bag: /sensing/imu: \d+ of \d+ messages refused; the first at \d+ ns: '):
        load_bag(path, tmp_path / 'cache', make_config('nano').model, cameras=False)
