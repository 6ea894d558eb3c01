"""`raw2drive bag doctor` on clocks: each of their faults has a line, and a good bag has none."""

from pathlib import Path

import pytest
from recording_helpers import FACTORY, messages_of, restamped

from msg_adapters.named_values import named_values_to_message
from raw2drive_ros.cli.main import main
from raw2drive_ros.contracts import topics
from raw2drive_ros.recording.bag_doctor import examine
from raw2drive_ros.recording.bag_writer import BagWriter
from raw2drive_ros.recording.recorder import Recording

MS, S = 1_000_000, 1_000_000_000
WALL = 1_790_000_000 * S
FRONT = topics.image_topic('front')


def written(path: Path, rows, delay_ns=None) -> Path:
    """delay_ns: row -> how long after its stamp it was received; None: nobody received it."""
    with BagWriter(path) as writer:
        for row in rows:
            writer.write_raw(*row, received_ns=None if delay_ns is None else row[1] + delay_ns(row))
    return path


def lines_of(path: Path) -> list[str]:
    return [f'{c.severity}: {c.text}' for c in examine(path)]


def only(lines: list[str], part: str) -> str:
    found = [line for line in lines if part in line]
    assert len(found) == 1, lines
    return found[0]


@pytest.fixture(scope='module')
def light(bag) -> list:
    """Without most of the cameras."""
    kept = [FRONT, topics.IMU, topics.ODOMETRY, topics.ROUTE, topics.BEV, topics.EGO, topics.TRANSITION]
    return [row for row in messages_of(bag) if row[0] in kept]


def test_a_good_bag_has_no_line_on_clocks(bag) -> None:
    words = ('time goes back', 'go back', 'stamp', 'log_time', 'clocks', 'received', 'lost', 'begins')
    assert [line for line in lines_of(bag) if any(word in line for word in words)] == []


def test_time_that_goes_back_is_named_with_the_number_of_drives(light, tmp_path) -> None:
    half = light[len(light) // 2][1]
    back = [row for row in light if row[1] < half] + [restamped(row, -5 * S) for row in light if row[1] >= half]
    line = only(lines_of(written(tmp_path / 'back', back)), 'time goes back')
    assert line.startswith('warning: time goes back once (first: by 4.9 s)')
    assert '2 drives in one bag' in line


def test_one_sensor_whose_stamps_go_back_is_named_itself(light, tmp_path) -> None:
    half = light[len(light) // 2][1]
    odd = [restamped(row, -3 * S)[2] if row[0] == FRONT and row[1] > half else row[2] for row in light]
    path = written(tmp_path / 'odd', [(topic, stamp, data) for (topic, stamp, _), data in zip(light, odd, strict=True)])
    assert only(lines_of(path), 'while the other topics go on').startswith(f'warning: {FRONT}: ')


def test_stamps_that_tell_no_time_are_named_by_topic(light, tmp_path, capsys) -> None:
    def without_time(row):
        topic, stamp, _ = row
        if topic == topics.IMU:
            return topic, stamp, restamped(row, -stamp - 3 * S)[2]
        return (topic, stamp, restamped(row, -stamp)[2]) if topic == topics.ODOMETRY else row

    path = written(tmp_path / 'untimed', map(without_time, light))
    lines = lines_of(path)
    count = sum(row[0] == topics.IMU for row in light)
    assert only(lines, 'negative') == f'error: {topics.IMU}: {count} of {count} stamps are negative, and make no tick'
    assert only(lines, 'have no stamp (0)').startswith(f'warning: {topics.ODOMETRY}: ')
    assert main(['bag', 'doctor', str(path)]) == 1
    assert 'stamps are negative' in capsys.readouterr().out


def test_two_clocks_in_one_bag_are_named(light, tmp_path) -> None:
    # The IMU counts from its boot, the rest since 1970.
    rows = [(t, WALL + s, d if t == topics.IMU else restamped((t, s, d), WALL)[2]) for t, s, d in light]
    line = only(lines_of(written(tmp_path / 'two', rows)), 'two clocks')
    assert line.startswith(f'error: {topics.IMU}: stamps are 1790000000 s before those of {topics.ODOMETRY}')


def test_the_delay_of_each_topic_is_read_from_both_times(light, tmp_path) -> None:
    late = written(tmp_path / 'late', light, lambda row: 80 * MS if row[0] == FRONT else 5 * MS)
    line = only(lines_of(late), 'received after their stamps by so many ms')
    assert line.startswith('note: ')
    assert f'{FRONT} 80/80' in line and f'{topics.IMU} 5/5' in line
    # Simulated time at the wall's pace: what one topic is later than another can still be read.
    wall = written(tmp_path / 'wall', light, lambda row: WALL + (80 * MS if row[0] == FRONT else 5 * MS))
    lines = lines_of(wall)
    assert only(lines, 'log_time is of another clock').endswith('readers here go by the stamps')
    assert f'{FRONT} 75/75' in only(lines, 'beyond the smallest one')
    # In lock-step it runs at another pace.
    fast = written(tmp_path / 'fast', light, lambda row: WALL - row[1] // 2)
    assert only(lines_of(fast), 'no delay of reception can be read').startswith('note: ')


def test_counters_that_are_missing_are_lost_proposals(light, tmp_path) -> None:
    with BagWriter(tmp_path / 'lost') as writer:
        for row in light:
            writer.write_raw(*row)
        # Another process begins at 1 again.
        for number, counter in enumerate((1, 2, 3, 7, 8, 1, 2, 4)):
            values = {'throttle': 0.0, 'brake': 1.0, 'steer': 0.0, 'reverse': 0.0, 'sequence': float(counter)}
            for topic in (topics.PROPOSED, topics.COMMAND):
                stamp = (2 + number) * S
                if topic == topics.PROPOSED or counter != 7:
                    writer.write(topic, stamp, named_values_to_message(FACTORY, values, stamp))
    lines = lines_of(tmp_path / 'lost')
    assert only(lines, 'proposals').startswith('warning: lost 4 proposals: ')
    assert only(lines, 'commands').startswith('warning: lost 5 commands: ')


def test_a_bag_that_is_a_part_and_one_that_begins_late_say_so(light, tmp_path) -> None:
    half = light[len(light) // 2][1]
    recording = Recording(tmp_path / 'day', {})
    for row in light:
        if row[1] > 2 * S or row[0] == topics.ROUTE:
            recording.write(*(row if row[1] < half else restamped(row, -5 * S)))
    first, second = recording.close()
    lines = lines_of(first)
    assert 'the recording begins in the middle of' in only(lines, 'its first tick is not there')
    assert only(lines, 'other drives are in').endswith('day_001')
    assert 'that began when time went back by 4.9 s' in only(lines_of(second), 'a part of a recording')
