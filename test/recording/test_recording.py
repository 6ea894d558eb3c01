"""Recordings that are split, run out of disk or are kept in a ring buffer; when a bag begins and how long it is."""

import pytest
from recording_helpers import messages_of, raw_message

from raw2drive_ros.contracts import topics
from raw2drive_ros.contracts.errors import BagExistsError, DiskFullError
from raw2drive_ros.recording import bag_writer
from raw2drive_ros.recording.bag_info import bag_info
from raw2drive_ros.recording.recorder import Recording, RingBuffer


def test_a_split_recording_is_whole_bags_that_each_begin_with_the_latched_messages(bag, tmp_path) -> None:
    recording = Recording(tmp_path / 'day', {'note': 'x'}, split_s=4.0)
    everything = messages_of(bag)
    for topic, stamp, data in everything:
        recording.write(topic, stamp, data)
    bags = recording.close()
    assert [b.name for b in bags] == [f'day_{number:03d}' for number in range(len(bags))]
    assert len(bags) >= 3
    for part in bags:
        assert sum(t == topics.extrinsics_topic('back') for t, _, _ in messages_of(part)) == 1
    images = [m for b in bags for m in messages_of(b) if m[0] == topics.image_topic('back')]
    assert images == [m for m in everything if m[0] == topics.image_topic('back')]
    assert bag_info(bags[1])['provenance']['part'] == '1'
    assert recording.received[topics.IMU] == sum(m[0] == topics.IMU for m in everything)
    assert recording.largest_gap_ns[topics.IMU] >= 50_000_000
    with pytest.raises(BagExistsError):
        Recording(tmp_path / 'day', {})


def test_a_split_by_size(bag, tmp_path) -> None:
    recording = Recording(tmp_path / 'day', {}, split_bytes=3_000_000)
    for message in messages_of(bag):
        recording.write(*message)
    assert len(recording.close()) > 3


def test_a_full_disk_ends_the_recording_and_keeps_what_was_written(bag, tmp_path, monkeypatch) -> None:
    recording = Recording(tmp_path / 'bag', {})
    everything = messages_of(bag)
    for message in everything[:200]:
        recording.write(*message)
    monkeypatch.setattr(bag_writer, 'CHECK_SPACE_EVERY_BYTES', 0)
    monkeypatch.setattr(bag_writer, 'MIN_FREE_BYTES', 10**18)
    monkeypatch.setattr(bag_writer.require_space, '__defaults__', (10**18,))
    with pytest.raises(DiskFullError, match='MB free'):
        recording.write(*everything[200])
    assert recording.close() == [tmp_path / 'bag']
    assert bag_info(tmp_path / 'bag')['messages'] == 201


def test_a_ring_buffer_keeps_the_last_seconds_and_the_latched_messages(bag, tmp_path) -> None:
    ring = RingBuffer(2.0)
    assert ring.save(tmp_path / 'none', {}) == 0
    everything = messages_of(bag)
    for topic, stamp, data in everything:
        ring.add(topic, stamp, data, stamp)
    ring.save(tmp_path / 'snapshot', {'snapshot': 'test'})
    info = bag_info(tmp_path / 'snapshot')
    assert 1.9 <= info['duration_s'] <= 2.0
    assert topics.extrinsics_topic('front') in {row['topic'] for row in info['topics']}
    assert ring.size == sum(len(held.data) for held in ring.held)
    small = RingBuffer(100.0, limit_bytes=100_000)
    for topic, stamp, data in everything:
        small.add(topic, stamp, data, stamp)
    assert small.size <= 100_000
    assert small.dropped > 0


def test_a_ring_buffer_forgets_by_arrival_whatever_the_stamps_say() -> None:
    ring = RingBuffer(2.0)
    # Before the first /clock, diagnostics have wall-clock stamps: they must neither stay nor drop the others.
    for stamp_s in (1.8e9, 0.0, 1.0, -5.0):
        ring.add(topics.DIAGNOSTICS, round(stamp_s * 1e9), b'wild', 10_000_000_000)
    for tick in range(100):
        ring.add(topics.IMU, tick, b'x' * 100, 10_000_000_000 + tick * 100_000_000)
    assert [held.stamp_ns for held in ring.held] == list(range(79, 100))
    assert ring.size == 2100
    # The simulation starts again: what came before grows old from there on.
    ring.add(topics.IMU, 5, b'y', 5)
    assert [held.stamp_ns for held in ring.held] == [*range(79, 100), 5]
    ring.add(topics.IMU, 6, b'y', 1_500_000_005)
    assert [held.stamp_ns for held in ring.held] == [*range(94, 100), 5, 6]


def test_latched_messages_and_stamps_of_another_clock_do_not_lengthen_a_bag(tmp_path) -> None:
    second = 1_000_000_000
    recording = Recording(tmp_path / 'bag', {}, split_s=60.0)
    recording.write(*raw_message(topics.ROUTE, 1))
    recording.write(*raw_message(topics.DIAGNOSTICS, 7 * second))
    for tick in range(50):
        now_ns = 1_700_000_000 * second + tick * second // 10
        if tick % 10 == 5:
            recording.write(*raw_message(topics.ROUTE, 1))
        recording.write(*raw_message(topics.ODOMETRY, now_ns))
    recording.write(*raw_message(topics.ROUTE, now_ns + second))
    (bag,) = recording.close()
    info = bag_info(bag)
    assert info['duration_s'] == pytest.approx(5.9)
    assert info['messages'] == 58


def test_a_bag_of_latched_messages_alone_is_written_all_the_same(tmp_path) -> None:
    recording = Recording(tmp_path / 'bag', {})
    recording.write(*raw_message(topics.ROUTE, 5))
    (bag,) = recording.close()
    assert bag_info(bag)['messages'] == 1


def test_a_recorder_that_had_heard_nothing_may_be_started_again(tmp_path) -> None:
    for _ in range(2):
        recording = Recording(tmp_path / 'day', {})
        recording.write(*raw_message(topics.DIAGNOSTICS, 1))
        recording.flush()
    recording.write(*raw_message(topics.ODOMETRY, 10))
    assert bag_info(recording.close()[0])['messages'] == 2


def test_hours_without_a_vehicle_keep_the_latched_messages(tmp_path) -> None:
    recording = Recording(tmp_path / 'bag', {})
    recording.write(*raw_message(topics.ROUTE, 1))
    for number in range(1500):
        recording.write(*raw_message(topics.DIAGNOSTICS, 1_700_000_000_000_000_000 + number))
    recording.write(*raw_message(topics.ODOMETRY, 100_000_000_000))
    info = bag_info(recording.close()[0])
    assert info['duration_s'] == 0.0
    assert {row['topic']: row['messages'] for row in info['topics']} == {
        topics.ROUTE: 1,
        topics.DIAGNOSTICS: 999,
        topics.ODOMETRY: 1,
    }


def test_a_latched_message_at_a_split_is_written_once(tmp_path) -> None:
    recording = Recording(tmp_path / 'bag', {}, split_s=1.0)
    recording.write(*raw_message(topics.ODOMETRY, 10_000_000_000))
    recording.write(*raw_message(topics.ROUTE, 11_000_000_000))
    assert [bag_info(bag)['messages'] for bag in recording.close()] == [1, 1]


def test_a_ring_with_only_its_own_diagnostics_saves_no_snapshot(tmp_path) -> None:
    ring = RingBuffer(5.0)
    ring.add(*raw_message(topics.DIAGNOSTICS, 1), 1)
    assert ring.save(tmp_path / 'shot', {}) == 0
    ring.add(*raw_message(topics.ODOMETRY, 2), 2)
    assert ring.save(tmp_path / 'shot', {}) == 2
