"""Bags that are cut and merged."""

from collections import Counter
from pathlib import Path

import pytest
from recording_helpers import messages_of, raw_message

from msg_adapters.commands import decision_to_message
from msg_adapters.factory import RosbagsFactory
from raw2drive_ros.contracts import topics
from raw2drive_ros.contracts.errors import BagError
from raw2drive_ros.contracts.public import Control, Decision
from raw2drive_ros.recording.bag_edit import cut, merge
from raw2drive_ros.recording.bag_info import bag_info
from raw2drive_ros.recording.bag_reader import open_bag
from raw2drive_ros.recording.bag_writer import BagWriter
from raw2drive_ros.recording.recorder import Recording


def test_cut_keeps_latched_messages_and_the_chosen_topics(bag, tmp_path) -> None:
    counts = cut(bag, tmp_path / 'part', 2.0, 3.0)
    assert counts[topics.image_topic('front')] == pytest.approx(10, abs=1)
    assert counts[topics.extrinsics_topic('front')] == 1
    info = bag_info(tmp_path / 'part')
    assert info['duration_s'] <= 1.0
    assert info['provenance']['cut'] == '2 s to 3 s'
    only = cut(bag, tmp_path / 'motion', 0.0, 1e300, patterns=('/vehicle/*', topics.IMU))
    assert set(only) == {topics.ODOMETRY, topics.IMU}
    for start, end in ((500.0, 600.0), (3.0, 2.0), (-3.0, 2.0), (1e300, 2e300)):
        with pytest.raises(BagError, match=r'no message there|nothing lies'):
            cut(bag, tmp_path / 'none', start, end)
    with pytest.raises(BagError, match='no topic matches /vehicle/odometri'):
        cut(bag, tmp_path / 'none', patterns=(topics.IMU, '/vehicle/odometri'))
    assert not list(tmp_path.glob('*none*'))


def test_a_cut_without_limits_loses_nothing_of_a_drive_by_the_wall_clock(tmp_path) -> None:
    # A float64 of nanoseconds since 1970 is off by up to 128.
    first_ns = 1_764_000_000_123_456_701
    with BagWriter(tmp_path / 'old', {}) as writer:
        for number in range(5):
            writer.write_raw(*raw_message(topics.ODOMETRY, first_ns + number * 50_000_000))
    assert cut(tmp_path / 'old', tmp_path / 'new') == {topics.ODOMETRY: 5}


def test_two_cuts_are_merged_to_the_original(bag, tmp_path) -> None:
    cut(bag, tmp_path / 'a', 0.0, 3.0, (topics.IMU, topics.ODOMETRY))
    cut(bag, tmp_path / 'b', 3.0, patterns=(topics.IMU, topics.ODOMETRY))
    merge([tmp_path / 'b', tmp_path / 'a'], tmp_path / 'whole')
    with open_bag(bag) as one, open_bag(tmp_path / 'whole') as other:
        wanted = [c for c in one.connections if c.topic in (topics.IMU, topics.ODOMETRY)]
        assert {(t, bytes(d)) for _, t, d in one.messages(wanted)} == {(t, bytes(d)) for _, t, d in other.messages()}
        stamps = [stamp for _, stamp, _ in other.messages()]
    assert stamps == sorted(stamps)


def test_merging_keeps_one_copy_of_duplicates_and_refuses_two_drives(bag, tmp_path) -> None:
    cut(bag, tmp_path / 'imu', patterns=(topics.IMU,))
    both = merge([bag, tmp_path / 'imu'], tmp_path / 'both')
    assert both.counts == bag_counts(bag)
    assert both.doubled == both.counts[topics.IMU]
    for name, stamp_ns, x_m in (('a', 10**9, 1.0), ('b', 10**9, 2.0), ('wall', 1_764_000_000 * 10**9, 1.0)):
        with BagWriter(tmp_path / name, {}) as writer:
            writer.write_raw(*raw_message(topics.ODOMETRY, stamp_ns, x_m))
    with pytest.raises(BagError, match='different drives'):
        merge([tmp_path / 'a', tmp_path / 'b'], tmp_path / 'none')
    with pytest.raises(BagError, match='simulated time'):
        merge([tmp_path / 'a', tmp_path / 'wall'], tmp_path / 'none')
    assert not list(tmp_path.glob('*none*'))


def test_the_parts_of_a_split_drive_are_merged_though_the_gate_repeats_itself(tmp_path) -> None:
    # A gate on a car answers a proposal, and then repeats the command under the same stamp.
    factory = RosbagsFactory()
    recording = Recording(tmp_path / 'day', {}, split_s=1.05)
    for tick in range(30):
        now_ns = 10**9 + tick * 10**8
        recording.write(*raw_message(topics.ODOMETRY, now_ns))
        for inference_ms in (4.0, 0.0):
            decision = Decision(now_ns, Control(0.5), action=3 if inference_ms else -1, inference_ms=inference_ms)
            data = factory.serialize(decision_to_message(factory, decision), topics.BY_NAME[topics.COMMAND].msgtype)
            recording.write(topics.COMMAND, now_ns, data)
    bags = recording.close()
    assert len(bags) == 3
    merged = merge(bags, tmp_path / 'whole')
    assert merged.counts == {topics.ODOMETRY: 30, topics.COMMAND: 60}
    assert merged.doubled == 0


def test_a_bag_without_messages_is_a_clear_error(bag, tmp_path) -> None:
    BagWriter(tmp_path / 'empty', {}).close()
    for attempt in (
        lambda: cut(tmp_path / 'empty', tmp_path / 'new'),
        lambda: merge([bag, tmp_path / 'empty'], tmp_path / 'new'),
    ):
        with pytest.raises(BagError, match='empty: holds no messages'):
            attempt()


def bag_counts(bag: Path) -> dict[str, int]:
    return dict(Counter(topic for topic, _, _ in messages_of(bag)))


def test_cut_times_count_from_the_first_message_that_is_not_latched(tmp_path) -> None:
    with BagWriter(tmp_path / 'old') as bag:
        bag.write_raw(*raw_message(topics.ROUTE, 1))
        for tick in range(20):
            bag.write_raw(*raw_message(topics.ODOMETRY, 1_700_000_000_000_000_000 + tick * 100_000_000))
    assert cut(tmp_path / 'old', tmp_path / 'new', 0.5, 1.0) == {topics.ROUTE: 1, topics.ODOMETRY: 5}
    assert bag_info(tmp_path / 'new')['duration_s'] == pytest.approx(0.4)


def test_latched_messages_alone_can_be_cut_out(tmp_path) -> None:
    with BagWriter(tmp_path / 'old') as bag:
        bag.write_raw(*raw_message(topics.ROUTE, 1))
        bag.write_raw(*raw_message(topics.ODOMETRY, 5_000_000_000))
    assert cut(tmp_path / 'old', tmp_path / 'new', patterns=(topics.ROUTE,)) == {topics.ROUTE: 1}
