"""Recordings that are killed, split, cut, merged, damaged or only remembered."""

import json
import os
import random
import signal
import subprocess
import sys
import time
from collections import Counter
from pathlib import Path

import numpy as np
import pytest
from mcap.reader import make_reader

from msg_adapters.commands import decision_to_message
from msg_adapters.diagnostics import diagnostics_to_message
from msg_adapters.factory import RosbagsFactory
from msg_adapters.sensors import odometry_to_message, route_to_message
from raw2drive_ros import topics
from raw2drive_ros.cli.main import main
from raw2drive_ros.contract import Control, Decision, OdometrySample, Route
from raw2drive_ros.errors import BagError, BagExistsError, DiskFullError
from raw2drive_ros.recording import bag_writer
from raw2drive_ros.recording.bag_doctor import examine
from raw2drive_ros.recording.bag_edit import cut, merge
from raw2drive_ros.recording.bag_info import bag_info
from raw2drive_ros.recording.bag_reader import open_bag
from raw2drive_ros.recording.bag_writer import BagWriter
from raw2drive_ros.recording.recorder import Recording, RingBuffer
from raw2drive_ros.recording.recover import recover

ROOT = Path(__file__).resolve().parents[2]
# Writes numbered odometry for ever, tells each number once it is written, and flushes ten times a second.
WRITER = """
import sys, time
from pathlib import Path
from msg_adapters.factory import RosbagsFactory
from msg_adapters.sensors import odometry_to_message
from raw2drive_ros import topics
from raw2drive_ros.contract import OdometrySample
from raw2drive_ros.recording.recorder import Recording
factory = RosbagsFactory()
recording = Recording(Path(sys.argv[1]), {'note': 'killed'}, split_s=float(sys.argv[2]))
flushed = time.monotonic()
for number in range(1, 1_000_000):
    stamp = number * 1_000_000
    message = odometry_to_message(factory, OdometrySample(stamp, float(number), 0.0, 0.0, 0.0, 0.0))
    recording.write(topics.ODOMETRY, stamp, factory.serialize(message, 'nav_msgs/msg/Odometry'))
    print(number, time.monotonic(), flush=True)
    if time.monotonic() - flushed > 0.1:
        flushed = time.monotonic()
        recording.flush()
    time.sleep(0.0005)
"""


def kill_a_recording(folder: Path, after_s: float, split_s: float = 0.0) -> tuple[int, int]:
    """(messages written more than a fifth of a second before the kill, messages recovered)."""
    command = [sys.executable, '-c', WRITER, str(folder / 'bag'), str(split_s)]
    writer = subprocess.Popen(command, cwd=ROOT, stdout=subprocess.PIPE, text=True)
    assert writer.stdout is not None
    lines = [writer.stdout.readline()]
    deadline = time.monotonic() + after_s
    while time.monotonic() < deadline:
        lines.append(writer.stdout.readline())
    os.kill(writer.pid, signal.SIGKILL)
    killed = time.monotonic()
    lines += writer.stdout.read().splitlines()
    writer.wait()
    times = [float(line.split()[1]) for line in lines if len(line.split()) == 2]
    saved = 0
    whole = [p.parent for p in (folder / 'bag').rglob('metadata.yaml')] if (folder / 'bag').is_dir() else []
    for bag in whole:
        saved += bag_info(bag)['messages']
    left = [p.parent for p in folder.rglob('*.mcap') if any(q.endswith('.partial') for q in p.parts)]
    for number, part in enumerate(left):
        try:
            saved += sum(recover(part, folder / f'saved_{number}').counts.values())
        except BagError as error:
            assert 'not a single message' in str(error)
    return sum(t < killed - 0.2 for t in times), saved


@pytest.mark.parametrize('split_s', [0.0, 0.1])
def test_a_killed_recording_loses_less_than_a_fifth_of_a_second(tmp_path, split_s) -> None:
    rng = random.Random(1)
    for attempt in range(4):
        folder = tmp_path / str(attempt)
        folder.mkdir()
        old, saved = kill_a_recording(folder, rng.uniform(0.0, 0.6), split_s)
        assert saved >= old


@pytest.mark.long
def test_a_hundred_kills_lose_less_than_a_second_and_the_mcap_library_reads_what_is_saved(tmp_path) -> None:
    rng = random.Random(2)
    for attempt in range(100):
        folder = tmp_path / str(attempt)
        folder.mkdir()
        old, saved = kill_a_recording(folder, rng.uniform(0.0, 2.0), rng.choice([0.0, 0.0, 0.3]))
        assert saved >= old, attempt
        for file in folder.glob('saved_*/*.mcap'):
            with file.open('rb') as stream:
                assert sum(1 for _ in make_reader(stream).iter_messages()) > 0


def test_recovered_provenance_and_content_are_those_of_the_recording(bag, tmp_path) -> None:
    rewritten = BagWriter(tmp_path / 'new', {'driver': 'somebody'})
    with open_bag(bag) as reader:
        for connection, stamp, data in reader.messages():
            rewritten.write_raw(connection.topic, stamp, bytes(data))
    rewritten.flush()
    found = recover(tmp_path / 'new', tmp_path / 'saved')
    assert found.counts == {row['topic']: row['messages'] for row in bag_info(bag)['topics']}
    assert (found.truncated, found.damaged, found.skipped) == (True, 0, {})
    metadata = bag_info(tmp_path / 'saved')['provenance']
    assert metadata['driver'] == 'somebody'
    assert metadata['recovered_from'] == 'new'
    with open_bag(bag) as a, open_bag(tmp_path / 'saved') as b:
        assert {(c.topic, t, bytes(d)) for c, t, d in a.messages()} == {
            (c.topic, t, bytes(d)) for c, t, d in b.messages()
        }


def test_a_damaged_chunk_is_left_out_and_the_rest_saved(bag, tmp_path) -> None:
    file = next(bag.glob('*.mcap'))
    data = bytearray(file.read_bytes())
    with file.open('rb') as stream:
        chunk = make_reader(stream).get_summary().chunk_indexes[1]
    middle = chunk.chunk_start_offset + chunk.chunk_length // 2
    data[middle : middle + 64] = bytes(64)
    (tmp_path / 'hurt.mcap').write_bytes(data)
    found = recover(tmp_path / 'hurt.mcap', tmp_path / 'saved')
    assert found.damaged == 1
    assert not found.truncated
    assert 0 < sum(found.counts.values()) < bag_info(bag)['messages']


def test_nothing_to_recover_is_said_and_leaves_nothing(tmp_path) -> None:
    (tmp_path / 'noise.mcap').write_bytes(bytes(range(256)) * 10)
    with pytest.raises(BagError, match='not a single message'):
        recover(tmp_path / 'noise.mcap', tmp_path / 'saved')
    with pytest.raises(BagError, match='no MCAP file'):
        recover(tmp_path / 'nowhere', tmp_path / 'saved')
    assert [p.name for p in tmp_path.iterdir()] == ['noise.mcap']


def test_cut_keeps_what_is_said_once_and_the_chosen_topics(bag, tmp_path) -> None:
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
    # Far from zero a float of nanoseconds is off by hundreds of them.
    first_ns = 1_764_000_000_123_456_701
    with BagWriter(tmp_path / 'old', {}) as writer:
        for number in range(5):
            writer.write_raw(*said(topics.ODOMETRY, first_ns + number * 50_000_000))
    assert cut(tmp_path / 'old', tmp_path / 'new') == {topics.ODOMETRY: 5}


def test_what_was_cut_apart_is_merged_again(bag, tmp_path) -> None:
    cut(bag, tmp_path / 'a', 0.0, 3.0, (topics.IMU, topics.ODOMETRY))
    cut(bag, tmp_path / 'b', 3.0, patterns=(topics.IMU, topics.ODOMETRY))
    merge([tmp_path / 'b', tmp_path / 'a'], tmp_path / 'whole')
    with open_bag(bag) as one, open_bag(tmp_path / 'whole') as other:
        wanted = [c for c in one.connections if c.topic in (topics.IMU, topics.ODOMETRY)]
        assert {(t, bytes(d)) for _, t, d in one.messages(wanted)} == {(t, bytes(d)) for _, t, d in other.messages()}
        stamps = [stamp for _, stamp, _ in other.messages()]
    assert stamps == sorted(stamps)


def test_merging_keeps_what_both_have_once_and_refuses_two_drives(bag, tmp_path) -> None:
    cut(bag, tmp_path / 'imu', patterns=(topics.IMU,))
    both = merge([bag, tmp_path / 'imu'], tmp_path / 'both')
    assert both.counts == bag_counts(bag)
    assert both.doubled == both.counts[topics.IMU]
    for name, stamp_ns, x_m in (('a', 10**9, 1.0), ('b', 10**9, 2.0), ('wall', 1_764_000_000 * 10**9, 1.0)):
        with BagWriter(tmp_path / name, {}) as writer:
            writer.write_raw(*said(topics.ODOMETRY, stamp_ns, x_m))
    with pytest.raises(BagError, match='different drives'):
        merge([tmp_path / 'a', tmp_path / 'b'], tmp_path / 'none')
    with pytest.raises(BagError, match='simulated time'):
        merge([tmp_path / 'a', tmp_path / 'wall'], tmp_path / 'none')
    assert not list(tmp_path.glob('*none*'))


def test_the_parts_of_a_split_drive_are_merged_though_the_gate_repeats_itself(tmp_path) -> None:
    # A gate on a car answers a proposal, and then says the same again under the same stamp.
    factory = RosbagsFactory()
    recording = Recording(tmp_path / 'day', {}, split_s=1.05)
    for tick in range(30):
        now_ns = 10**9 + tick * 10**8
        recording.write(*said(topics.ODOMETRY, now_ns))
        for inference_ms in (4.0, 0.0):
            decision = Decision(now_ns, Control(0.5), action=3 if inference_ms else -1, inference_ms=inference_ms)
            data = factory.serialize(decision_to_message(factory, decision), topics.BY_NAME[topics.COMMAND].msgtype)
            recording.write(topics.COMMAND, now_ns, data)
    bags = recording.close()
    assert len(bags) == 3
    merged = merge(bags, tmp_path / 'whole')
    assert merged.counts == {topics.ODOMETRY: 30, topics.COMMAND: 60}
    assert merged.doubled == 0


def test_a_bag_without_messages_is_called_that(bag, tmp_path) -> None:
    BagWriter(tmp_path / 'empty', {}).close()
    for attempt in (
        lambda: cut(tmp_path / 'empty', tmp_path / 'new'),
        lambda: merge([bag, tmp_path / 'empty'], tmp_path / 'new'),
    ):
        with pytest.raises(BagError, match='empty: holds no messages'):
            attempt()


def test_several_bags_are_not_recovered_as_one(bag, tmp_path) -> None:
    for name in ('one', 'two'):
        cut(bag, tmp_path / 'day' / name, patterns=(topics.IMU,))
    with pytest.raises(BagError, match='one, two'):
        recover(tmp_path / 'day', tmp_path / 'saved')


def bag_counts(bag: Path) -> dict[str, int]:
    return dict(Counter(topic for topic, _, _ in messages_of(bag)))


def messages_of(bag: Path) -> list[tuple[str, int, bytes]]:
    with open_bag(bag) as reader:
        return [(c.topic, stamp, bytes(data)) for c, stamp, data in reader.messages()]


def test_a_split_recording_is_whole_bags_that_each_begin_with_what_is_said_once(bag, tmp_path) -> None:
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


def test_a_ring_buffer_keeps_the_last_seconds_and_what_is_said_once(bag, tmp_path) -> None:
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
    # Before the first /clock, diagnostics carry the wall's time: they must not stay, and must not drop the others.
    for stamp_s in (1.8e9, 0.0, 1.0, -5.0):
        ring.add(topics.DIAGNOSTICS, round(stamp_s * 1e9), b'wild', 10_000_000_000)
    for tick in range(100):
        ring.add(topics.IMU, tick, b'x' * 100, 10_000_000_000 + tick * 100_000_000)
    assert [held.stamp_ns for held in ring.held] == list(range(79, 100))
    assert ring.size == 2100
    # A simulation that starts over.
    ring.add(topics.IMU, 5, b'y', 5)
    assert [held.stamp_ns for held in ring.held] == [5]


def test_the_doctor_finds_nothing_wrong_with_a_good_bag(bag, capsys) -> None:
    assert [c for c in examine(bag) if c.severity != 'note'] == []
    assert main(['bag', 'doctor', str(bag)]) == 0
    assert 'fit for use' in capsys.readouterr().out


def test_the_doctor_names_gaps_missing_topics_and_incomplete_ticks(bag, tmp_path, capsys) -> None:
    with BagWriter(tmp_path / 'holes') as writer:
        for count, (topic, stamp, data) in enumerate(messages_of(bag)):
            lost = topic == topics.IMU or (topic == topics.image_topic('back') and 600 < count < 900)
            if not lost:
                writer.write_raw(topic, stamp, data)
    texts = [f'{c.severity}: {c.text}' for c in examine(tmp_path / 'holes')]
    assert f'warning: {topics.IMU} is missing' in texts
    assert any(t.startswith(f'warning: {topics.image_topic("back")}: a gap of') for t in texts)
    assert any('ticks are incomplete' in t for t in texts)
    (tmp_path / 'holes' / 'metadata.yaml').unlink()
    assert main(['bag', 'doctor', str(tmp_path / 'holes'), '--json']) == 1
    assert json.loads(capsys.readouterr().out)[0]['severity'] == 'error'


def test_bag_verbs_on_the_command_line(bag, tmp_path, capsys) -> None:
    out = tmp_path / 'x'
    assert main(['bag', 'cut', str(bag), '--start', '1', '--end', '2', '--out', str(out), '--json']) == 0
    assert json.loads(capsys.readouterr().out)['messages'][topics.IMU] == pytest.approx(20, abs=1)
    assert main(['bag', 'merge', str(out), str(out), '--out', str(tmp_path / 'y')]) == 0
    assert main(['bag', 'recover', str(out), '--out', str(tmp_path / 'z')]) == 0
    capsys.readouterr()
    assert main(['bag', 'cut', str(bag), '--start', '1']) == 2
    assert 'needs --out' in capsys.readouterr().err
    assert main(['bag', 'recover', str(out), '--out', str(tmp_path / 'z')]) == 1
    assert 'exists already' in capsys.readouterr().err


def test_events_are_changes_of_what_nodes_say_of_themselves(tmp_path, capsys) -> None:
    factory = RosbagsFactory()
    with BagWriter(tmp_path / 'bag', {}) as writer:
        for tick, (node, level, text) in enumerate(
            [
                ('planner', 0, 'driving'),
                ('safety_gate', 0, 'driving'),
                ('planner', 2, 'stop: camera front: newest is 0.31 s old'),
                ('planner', 2, 'stop: camera front: newest is 1.31 s old'),
                ('safety_gate', 2, '[bold]no valid proposal[/bold]'),
                ('planner', 0, 'driving'),
            ]
        ):
            message = diagnostics_to_message(factory, node, level, text, {}, 0)
            data = factory.serialize(message, 'diagnostic_msgs/msg/DiagnosticArray')
            writer.write_raw(topics.DIAGNOSTICS, (tick + 1) * 10**9, data)
    assert main(['bag', 'events', str(tmp_path / 'bag'), '--json']) == 0
    events = json.loads(capsys.readouterr().out)
    assert [(e['time_s'], e['node'], e['level']) for e in events] == [
        (0.0, 'planner', 'ok'),
        (1.0, 'safety_gate', 'ok'),
        (2.0, 'planner', 'error'),
        (4.0, 'safety_gate', 'error'),
        (5.0, 'planner', 'ok'),
    ]
    assert main(['bag', 'events', str(tmp_path / 'bag')]) == 0
    assert '[bold]no valid' in capsys.readouterr().out


def said(topic: str, stamp_ns: int, x_m: float = 0.0) -> tuple[str, int, bytes]:
    factory = RosbagsFactory()
    if topic == topics.ROUTE:
        message = route_to_message(factory, Route(stamp_ns, np.array([[0.0, 0.0], [30.0, 0.0]])))
    elif topic == topics.DIAGNOSTICS:
        message = diagnostics_to_message(factory, 'x', 0, 'fine', {}, stamp_ns)
    else:
        message = odometry_to_message(factory, OdometrySample(stamp_ns, x_m, 0.0, 0.0, 0.0, 0.0))
    return topic, stamp_ns, factory.serialize(message, topics.BY_NAME[topic].msgtype)


def test_what_is_said_once_or_by_another_clock_does_not_stretch_a_bag(tmp_path) -> None:
    second = 1_000_000_000
    recording = Recording(tmp_path / 'bag', {}, split_s=60.0)
    recording.write(*said(topics.ROUTE, 1))
    recording.write(*said(topics.DIAGNOSTICS, 7 * second))
    for tick in range(50):
        now_ns = 1_700_000_000 * second + tick * second // 10
        if tick % 10 == 5:
            recording.write(*said(topics.ROUTE, 1))
        recording.write(*said(topics.ODOMETRY, now_ns))
    recording.write(*said(topics.ROUTE, now_ns + second))
    (bag,) = recording.close()
    info = bag_info(bag)
    assert info['duration_s'] == pytest.approx(5.9)
    assert info['messages'] == 58


def test_a_bag_of_what_is_said_once_only_is_written_all_the_same(tmp_path) -> None:
    recording = Recording(tmp_path / 'bag', {})
    recording.write(*said(topics.ROUTE, 5))
    (bag,) = recording.close()
    assert bag_info(bag)['messages'] == 1


def test_an_old_bag_is_cut_from_where_it_flows(tmp_path) -> None:
    with BagWriter(tmp_path / 'old') as bag:
        bag.write_raw(*said(topics.ROUTE, 1))
        for tick in range(20):
            bag.write_raw(*said(topics.ODOMETRY, 1_700_000_000_000_000_000 + tick * 100_000_000))
    assert cut(tmp_path / 'old', tmp_path / 'new', 0.5, 1.0) == {topics.ROUTE: 1, topics.ODOMETRY: 5}
    assert bag_info(tmp_path / 'new')['duration_s'] == pytest.approx(0.4)


def test_what_a_killed_recorder_left_is_never_overwritten(tmp_path) -> None:
    recording = Recording(tmp_path / 'day', {})
    recording.write(*said(topics.ODOMETRY, 10))
    recording.flush()
    for again in (lambda: Recording(tmp_path / 'day', {}), lambda: recover(tmp_path / 'day', tmp_path / 'day')):
        with pytest.raises(BagExistsError, match='raw2drive bag recover'):
            again()
    assert main(['record', '--out', str(tmp_path / 'day')]) == 1
    assert recover(tmp_path / 'day', tmp_path / 'saved').counts == {topics.ODOMETRY: 1}


def test_a_recorder_that_had_heard_nothing_may_be_started_again(tmp_path) -> None:
    for _ in range(2):
        recording = Recording(tmp_path / 'day', {})
        recording.write(*said(topics.DIAGNOSTICS, 1))
        recording.flush()
    recording.write(*said(topics.ODOMETRY, 10))
    assert bag_info(recording.close()[0])['messages'] == 2


def test_hours_without_a_vehicle_keep_what_is_said_once(tmp_path) -> None:
    recording = Recording(tmp_path / 'bag', {})
    recording.write(*said(topics.ROUTE, 1))
    for number in range(1500):
        recording.write(*said(topics.DIAGNOSTICS, 1_700_000_000_000_000_000 + number))
    recording.write(*said(topics.ODOMETRY, 100_000_000_000))
    info = bag_info(recording.close()[0])
    assert info['duration_s'] == 0.0
    assert {row['topic']: row['messages'] for row in info['topics']} == {
        topics.ROUTE: 1,
        topics.DIAGNOSTICS: 999,
        topics.ODOMETRY: 1,
    }


def test_a_split_says_what_is_said_once_just_once(tmp_path) -> None:
    recording = Recording(tmp_path / 'bag', {}, split_s=1.0)
    recording.write(*said(topics.ODOMETRY, 10_000_000_000))
    recording.write(*said(topics.ROUTE, 11_000_000_000))
    assert [bag_info(bag)['messages'] for bag in recording.close()] == [1, 1]


def test_only_what_is_said_once_can_be_cut_out(tmp_path) -> None:
    with BagWriter(tmp_path / 'old') as bag:
        bag.write_raw(*said(topics.ROUTE, 1))
        bag.write_raw(*said(topics.ODOMETRY, 5_000_000_000))
    assert cut(tmp_path / 'old', tmp_path / 'new', patterns=(topics.ROUTE,)) == {topics.ROUTE: 1}


def test_a_ring_of_its_own_diagnostics_holds_nothing_worth_a_snapshot(tmp_path) -> None:
    ring = RingBuffer(5.0)
    ring.add(*said(topics.DIAGNOSTICS, 1), 1)
    assert ring.save(tmp_path / 'shot', {}) == 0
    ring.add(*said(topics.ODOMETRY, 2), 2)
    assert ring.save(tmp_path / 'shot', {}) == 2
