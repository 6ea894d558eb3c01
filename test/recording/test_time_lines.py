"""Time that goes back: how it is told from a sensor's fault, and what recorder, snapshots and readers make of it."""

from pathlib import Path

import numpy as np
import pytest
from mcap.reader import make_reader
from recording_helpers import FACTORY, messages_of, raw_message, restamped
from rosbags.rosbag2 import StoragePlugin, Writer

from raw2drive_ros.contracts import topics
from raw2drive_ros.recording.bag_info import bag_info
from raw2drive_ros.recording.bag_reader import find_bags, open_bag
from raw2drive_ros.recording.bag_writer import BagWriter
from raw2drive_ros.recording.line_reader import lasts_s, time_lines
from raw2drive_ros.recording.recorder import Recording, RingBuffer
from raw2drive_ros.recording.recover import recover
from raw2drive_ros.recording.ticks import read_ticks
from raw2drive_ros.recording.time_lines import TimeLines

MS, S = 1_000_000, 1_000_000_000
WALL = 1_790_000_000 * S
FRONT = topics.image_topic('front')


def stream(*times_s: float, names: tuple[str, ...] = (topics.IMU, topics.ODOMETRY, FRONT)) -> list[tuple[str, int]]:
    return [(name, round(time_s * S)) for time_s in times_s for name in names]


def numbered(messages: list[tuple[str, int]]) -> list[int]:
    """The line of each message, in the order in which they came."""
    lines: TimeLines[int] = TimeLines()
    decided = [found for count, (topic, stamp) in enumerate(messages) for found in lines.feed(topic, stamp, count)]
    decided += lines.finish()
    assert sorted(index for _, index in decided) == list(range(len(messages))), 'nothing is lost, nothing twice'
    assert [line for line, _ in decided] == sorted(line for line, _ in decided)
    return [line for line, _ in sorted(decided, key=lambda found: found[1])]


def ticks_from(begin_s: float, count: int = 20) -> list[float]:
    return [begin_s + 0.1 * number for number in range(count)]


def test_time_that_begins_again_is_another_line_and_what_is_late_stays_with_the_old_one() -> None:
    first, second = stream(*ticks_from(5.0)), stream(*ticks_from(1.0))
    assert numbered(first + second) == [0] * 60 + [1] * 60
    # Pictures of the old time are still on their way when the rest has begun again.
    late = [message for message in first if message[0] == FRONT][-3:]
    early = [message for message in first if message not in late]
    mixed = early + second[:2] + late + second[2:]
    assert numbered(mixed) == [0] * 57 + [1] * 2 + [0] * 3 + [1] * 58


@pytest.mark.parametrize('back_s', [0.7, 3.0, 1e9])
def test_the_tolerance_is_half_a_second(back_s) -> None:
    begin_s = 2e9
    assert max(numbered(stream(*ticks_from(begin_s), *ticks_from(begin_s + 1.9 - back_s)))) == 1
    assert max(numbered(stream(*ticks_from(begin_s), *ticks_from(begin_s + 1.9 - 0.4)))) == 0


def test_one_sensor_whose_stamps_go_back_is_a_stray_and_no_new_drive() -> None:
    lines: TimeLines[int] = TimeLines()
    decided = []
    for count, time_s in enumerate(ticks_from(5.0, 100)):
        for name in (topics.IMU, topics.ODOMETRY, FRONT):
            # The camera's clock is set back for good; the IMU has one wrong stamp.
            shift = 3.0 if (name == FRONT and count >= 50) or (name == topics.IMU and count == 20) else 0.0
            decided += lines.feed(name, round((time_s - shift) * S), count)
    decided += lines.finish()
    assert {line for line, _ in decided} == {0}
    assert len(decided) == 300
    assert lines.strays[topics.IMU] == 1
    assert 1 <= lines.strays[FRONT] <= 10, 'from then on it is measured by itself'


def test_clock_decides_alone() -> None:
    # Every sensor goes back, but the clock goes on: they are at fault.
    names = (topics.CLOCK, topics.IMU, topics.ODOMETRY, FRONT)
    went_on = [(n, s) if n == topics.CLOCK else (n, s - 3 * S) for n, s in stream(*ticks_from(7.0), names=names)]
    assert max(numbered(stream(*ticks_from(5.0), names=names) + went_on)) == 0
    assert max(numbered(stream(*ticks_from(5.0), names=names) + stream(*ticks_from(1.0), names=names))) == 1


def test_two_publishers_of_one_clock_are_no_drives_and_a_wild_stamp_moves_nothing() -> None:
    both = [pair for a, b in zip(ticks_from(5.0), ticks_from(500.0), strict=True) for pair in stream(b, a)]
    assert max(numbered(both)) == 0
    wild = stream(*ticks_from(5.0), 4000.0, *ticks_from(7.0))
    assert numbered(wild) == [0] * len(wild)
    assert numbered(stream(*ticks_from(5.0), *ticks_from(4000.0), *ticks_from(6.0)))[-1] == 1


def test_commands_latched_messages_and_stamps_that_tell_no_time_begin_nothing() -> None:
    names = (topics.IMU, topics.PROPOSED, topics.ROUTE, topics.DIAGNOSTICS)
    messages = stream(*ticks_from(5.0), names=names)
    odd = [(n, s if n == topics.IMU else s - 4 * S) for n, s in stream(*ticks_from(7.0), names=names)]
    untimed = [(topics.IMU, 0), (topics.IMU, -5 * S), (FRONT, -1)] * 5
    assert max(numbered(messages + odd + untimed)) == 0


# -- recording --------------------------------------------------------------------------------------


@pytest.fixture(scope='module')
def two_drives(bag) -> tuple[list[tuple[str, int, bytes]], list[tuple[str, int, bytes]]]:
    """The two episodes of the bag, the second one with the times of the first."""
    rows = messages_of(bag)
    with open_bag(bag) as reader:
        routes = sorted({tick.route.stamp_ns for tick in read_ticks(reader, bag, cameras=False)})
    # The physics steps before its first tick belong to it, too.
    first = [row for row in rows if row[1] <= routes[1] - 100 * MS]
    second = [row for row in rows if row[1] > routes[1] - 100 * MS]
    return first, [restamped(row, routes[0] - routes[1]) for row in second]


def episodes_of(bag: Path) -> list[str]:
    with open_bag(bag) as reader:
        return [tick.episode for tick in read_ticks(reader, bag, cameras=True)]


def test_a_recorder_begins_a_new_bag_when_time_goes_back_and_keeps_what_was_before(bag, two_drives, tmp_path) -> None:
    first, second = two_drives
    recording = Recording(tmp_path / 'day', {'note': 'x'})
    for row in first + second:
        recording.write(*row)
    bags = recording.close()
    assert bags == [tmp_path / 'day', tmp_path / 'day' / 'day_001']
    assert find_bags([tmp_path]) == bags, 'a trainer finds both'
    assert recording.went_back == [recording.notes[0].split(':')[0]] and 'time went back by' in recording.notes[0]
    assert str(bags[1]) in recording.notes[0]
    everything = sorted((topic, data) for part in bags for topic, _, data in messages_of(part))
    written = sorted((topic, data) for topic, _, data in first + second)
    assert [row for row in everything if not topics.BY_NAME[row[0]].qos.latched] == [
        row for row in written if not topics.BY_NAME[row[0]].qos.latched
    ]
    for part in bags:
        assert len(episodes_of(part)) == 60
        assert len(set(episodes_of(part))) == 1, 'no drive is mixed with another'
    provenance = bag_info(bags[1])['provenance']
    assert (provenance['part'], provenance['note']) == ('1', 'x')
    assert provenance['began'].startswith('time went back by')
    assert provenance['begins'] == f'with the first tick of {episodes_of(bags[1])[0]}'
    assert 'part' not in bag_info(bags[0])['provenance']


def test_a_split_recording_goes_on_counting_its_parts(bag, two_drives, tmp_path) -> None:
    first, second = two_drives
    recording = Recording(tmp_path / 'day', {}, split_s=4.0)
    for row in first + second:
        recording.write(*row)
    bags = recording.close()
    assert [b.name for b in bags] == [f'day_{n:03d}' for n in range(4)]
    began = [bag_info(b)['provenance'].get('began', '') for b in bags]
    assert began[0] == '' and began[1] == began[3] == 'split after 4 s'
    assert began[2].startswith('time went back by')
    begins = [bag_info(b)['provenance']['begins'].split(' of ')[0] for b in bags]
    assert begins == ['with the first tick', 'in the middle'] * 2
    assert not [note for note in recording.notes if 'begins in the middle' in note], 'a split is no fault'


@pytest.mark.parametrize('lost', ['transition', 'picture'])
def test_a_recording_that_begins_in_the_middle_of_an_episode_says_so_and_in_the_bag(bag, tmp_path, lost) -> None:
    rows = messages_of(bag)
    begins_ns = next(stamp for topic, stamp, _ in rows if topic == topics.TRANSITION)
    topic = topics.TRANSITION if lost == 'transition' else topics.image_topic('back_left')
    recording = Recording(tmp_path / 'late', {})
    for row in rows:
        if row[:2] != (topic, begins_ns):
            recording.write(*row)
    if lost == 'transition':
        assert len(recording.notes) == 1
    recording.close()
    episode = episodes_of(bag)[0]
    assert recording.notes == [
        f'the recording begins in the middle of {episode}: its first tick is not there as a whole'
    ]
    assert bag_info(tmp_path / 'late')['provenance']['begins'] == f'in the middle of {episode}'


def test_a_snapshot_over_a_restart_holds_each_drive_in_a_bag_of_its_own(bag, two_drives, tmp_path) -> None:
    first, second = two_drives
    ring = RingBuffer(4.0)
    for topic, stamp, data in first + second[: len(second) // 3]:
        ring.add(topic, stamp, data, stamp)
    assert ring.save(tmp_path / 'shot', {'snapshot': 'test'}) > 0
    bags = find_bags([tmp_path])
    assert bags == [tmp_path / 'shot', tmp_path / 'shot' / 'shot_001']
    assert [len(set(episodes_of(b))) for b in bags] == [1, 1]
    lasted = [bag_info(b)['duration_s'] for b in bags]
    assert 3.8 < sum(lasted) < 4.2, 'both together are the last seconds'
    assert min(lasted) > 1.5


def test_negative_stamps_are_recorded_at_the_time_of_their_neighbours(tmp_path) -> None:
    recording = Recording(tmp_path / 'bag', {})
    for tick in range(1, 20):
        recording.write(*raw_message(topics.ODOMETRY, tick * 100 * MS))
        recording.write(topics.IMU, -3 * S, b'\x00\x01\x00\x00' + bytes(400))
        recording.write(topics.IMU, 0, b'\x00\x01\x00\x00' + bytes(400))
    (path,) = recording.close()
    assert recording.untimed == {topics.IMU: 38}
    rows = {row['topic']: row['messages'] for row in bag_info(path)['topics']}
    assert rows == {topics.ODOMETRY: 19, topics.IMU: 38}
    assert bag_info(path)['duration_s'] == pytest.approx(1.8)


# -- both times -------------------------------------------------------------------------------------


def test_log_time_is_the_reception_and_readers_get_the_stamps_in_their_order(bag, tmp_path) -> None:
    rows = messages_of(bag)
    random = np.random.default_rng(3)
    # Received in another order than stamped, and long after.
    order = sorted(range(len(rows)), key=lambda n: rows[n][1] + random.integers(0, 300 * MS))
    with BagWriter(tmp_path / 'both') as writer:
        for count, number in enumerate(order):
            writer.write_raw(*rows[number], received_ns=WALL + count * MS)
            if count % 500 == 0:
                writer.flush()
    again = messages_of(tmp_path / 'both')
    assert sorted(again) == sorted(rows)
    assert [stamp for _, stamp, _ in again] == sorted(stamp for _, stamp, _ in rows)
    with open_bag(tmp_path / 'both') as reader, open_bag(bag) as original:
        assert (reader.start_time, reader.end_time) == (original.start_time, original.end_time)
        low, high = reader.start_time + 2 * S, reader.start_time + 3 * S
        some = [stamp for _, stamp, _ in reader.messages(start=low, stop=high)]
        assert some == sorted(stamp for _, stamp, _ in rows if low <= stamp < high)
        assert [log for _, log, _ in reader.arrivals()] == [WALL + count * MS for count in range(len(rows))]
        one = list(time_lines(reader))
        assert one == [reader]
    file = next((tmp_path / 'both').glob('*.mcap'))
    with file.open('rb') as stream_:
        found = [(m.log_time, m.publish_time) for _, _, m in make_reader(stream_).iter_messages()]
    assert found == [(WALL + count * MS, rows[number][1]) for count, number in enumerate(order)]
    assert _ticks(bag) == _ticks(tmp_path / 'both')


def _ticks(path: Path) -> list[tuple[int, str, bytes]]:
    with open_bag(path) as reader:
        ticks = read_ticks(reader, path, cameras=True)
        return [(tick.stamp_ns, tick.episode, tick.images['front'].tobytes()) for tick in ticks]


def test_a_recorder_that_is_killed_leaves_both_times(tmp_path) -> None:
    recording = Recording(tmp_path / 'bag', {})
    for tick in range(1, 30):
        recording.write(*raw_message(topics.ODOMETRY, tick * 100 * MS), received_ns=WALL + tick * MS)
        if tick == 20:
            recording.flush()
            # Nothing is closed.
            recover(tmp_path / 'bag', tmp_path / 'saved')
    with open_bag(tmp_path / 'saved') as reader:
        assert [stamp for _, stamp, _ in reader.messages()] == [tick * 100 * MS for tick in range(1, 21)]
        assert [log for _, log, _ in reader.arrivals()] == [WALL + tick * MS for tick in range(1, 21)]


# -- readers ----------------------------------------------------------------------------------------


def foreign(rows: list[tuple[str, int, bytes]], path: Path, plugin: StoragePlugin = StoragePlugin.MCAP) -> Path:
    """A bag of another recorder: log time goes on by the wall, 1 ms a message, whatever the stamps say."""
    with Writer(path, version=9, storage_plugin=plugin) as writer:
        connections: dict = {}
        for count, (topic, _, data) in enumerate(rows):
            if topic not in connections:
                msgtype = topics.BY_NAME[topic].msgtype
                connections[topic] = writer.add_connection(topic, msgtype, typestore=FACTORY.typestore)
            writer.write(connections[topic], WALL + count * MS, data)
    return path


@pytest.mark.parametrize('kind', ['older', 'mcap', 'sqlite3'])
def test_readers_take_the_drives_of_a_bag_one_by_one(bag, two_drives, tmp_path, kind) -> None:
    first, second = two_drives
    path = tmp_path / kind
    if kind == 'older':
        # As older versions recorded: log time is the stamp, and the drives lie over one another.
        with BagWriter(path) as writer:
            for row in first + second:
                writer.write_raw(*row)
    else:
        foreign(first + second, path, StoragePlugin[kind.upper()])
    with open_bag(path) as reader:
        lines = time_lines(reader)
        assert len(lines) == 2
        episodes = [[tick.episode for tick in read_ticks(line, path, cameras=True)] for line in lines]
        starts = [line.start_time for line in lines]
        assert lasts_s(lines) == pytest.approx(11.9, abs=0.3)
    assert [len(each) for each in episodes] == [60, 60]
    assert [len(set(each)) for each in episodes] == [1, 1]
    assert episodes[0][0] != episodes[1][0]
    assert max(starts) < 2 * S, 'their times are the stamps'


def test_a_bag_of_one_drive_is_read_as_it_always_was(bag, two_drives, tmp_path) -> None:
    with open_bag(bag) as reader:
        assert time_lines(reader) == [reader]
    first, _ = two_drives
    # Log time of the wall beside simulated stamps: one line, read by the stamps.
    path = foreign(first, tmp_path / 'wall')
    with open_bag(path) as reader:
        (line,) = time_lines(reader)
        assert line is not reader
        times = [(c.topic, t) for c, t, _ in line.messages()]
        assert max(t for _, t in times) == max(stamp for _, stamp, _ in first)
        assert len(times) == line.message_count == len(first)
    # Log time a little after the stamps of the same clock: as the other recorder wrote it.
    near = [(topic, stamp, data) for topic, stamp, data in first if 'extrinsics' not in topic]
    shifted = [restamped(row, WALL) for row in near]
    with Writer(tmp_path / 'near', version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        connections: dict = {}
        for topic, stamp, data in shifted:
            if topic not in connections:
                msgtype = topics.BY_NAME[topic].msgtype
                connections[topic] = writer.add_connection(topic, msgtype, typestore=FACTORY.typestore)
            writer.write(connections[topic], stamp + 20 * MS, data)
    with open_bag(tmp_path / 'near') as reader:
        assert time_lines(reader) == [reader]
