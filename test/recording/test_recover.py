"""Recordings that were killed or damaged: what is recovered, and that nothing is overwritten."""

import os
import random
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from mcap.reader import make_reader
from recording_helpers import raw_message

from raw2drive_ros.cli.main import main
from raw2drive_ros.contracts import topics
from raw2drive_ros.contracts.errors import BagError, BagExistsError
from raw2drive_ros.recording.bag_edit import cut
from raw2drive_ros.recording.bag_info import bag_info
from raw2drive_ros.recording.bag_reader import open_bag
from raw2drive_ros.recording.bag_writer import BagWriter
from raw2drive_ros.recording.recorder import Recording
from raw2drive_ros.recording.recover import recover

ROOT = Path(__file__).resolve().parents[2]

# Writes numbered odometry without end, prints each number once it is written, and flushes ten times a second.
WRITER = """
import sys, time
from pathlib import Path
from msg_adapters.factory import RosbagsFactory
from msg_adapters.sensors import odometry_to_message
from raw2drive_ros.contracts import topics
from raw2drive_ros.contracts.public import OdometrySample
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


def test_nothing_to_recover_is_an_error_and_leaves_nothing(tmp_path) -> None:
    (tmp_path / 'noise.mcap').write_bytes(bytes(range(256)) * 10)
    with pytest.raises(BagError, match='not a single message'):
        recover(tmp_path / 'noise.mcap', tmp_path / 'saved')
    with pytest.raises(BagError, match='no MCAP file'):
        recover(tmp_path / 'nowhere', tmp_path / 'saved')
    assert [p.name for p in tmp_path.iterdir()] == ['noise.mcap']


def test_several_bags_are_not_recovered_as_one(bag, tmp_path) -> None:
    for name in ('one', 'two'):
        cut(bag, tmp_path / 'day' / name, patterns=(topics.IMU,))
    with pytest.raises(BagError, match='one, two'):
        recover(tmp_path / 'day', tmp_path / 'saved')


def test_what_a_killed_recorder_left_is_never_overwritten(tmp_path) -> None:
    recording = Recording(tmp_path / 'day', {})
    recording.write(*raw_message(topics.ODOMETRY, 10))
    recording.flush()
    for again in (lambda: Recording(tmp_path / 'day', {}), lambda: recover(tmp_path / 'day', tmp_path / 'day')):
        with pytest.raises(BagExistsError, match='raw2drive bag recover'):
            again()
    assert main(['record', '--out', str(tmp_path / 'day')]) == 1
    assert recover(tmp_path / 'day', tmp_path / 'saved').counts == {topics.ODOMETRY: 1}
