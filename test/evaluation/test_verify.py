"""Verification by replay of bags that miss something: what was lost is lost, and drives are not mixed."""

from dataclasses import dataclass, field, replace
from pathlib import Path

import pytest

from msg_adapters.commands import decision_to_message
from msg_adapters.factory import RosbagsFactory
from msg_adapters.named_values import named_values_from_message, named_values_to_message
from msg_adapters.stamps import set_stamp
from raw2drive_ros.cli.main import main
from raw2drive_ros.contracts import topics
from raw2drive_ros.contracts.public import SensorFrame
from raw2drive_ros.driving.bundle import load_bundle
from raw2drive_ros.driving.raw_driver import RawDriver
from raw2drive_ros.evaluation.verify import verify_bag
from raw2drive_ros.recording.bag_reader import open_bag
from raw2drive_ros.recording.bag_writer import BagWriter
from raw2drive_ros.recording.ticks import read_ticks
from raw2drive_ros.recording.time_lines import stamp_of
from raw2drive_ros.tables.rates import DECISION_NS

FACTORY = RosbagsFactory()
SENSORS = {*topics.SENSOR_TOPICS}


@dataclass
class Drive:
    """Two episodes with the decisions of a planner that saw all of it. rows: (topic, stamp, CDR bytes). stamps: of its
    ticks; second: number of the first tick of the second episode. proposals: stamp -> named values."""

    rows: list[tuple[str, int, bytes]]
    stamps: list[int]
    second: int
    proposals: dict[int, dict[str, float]] = field(default_factory=dict)

    def write(
        self, path: Path, *, without: tuple[int, ...] = (), counters: bool = True, lose=lambda row: False
    ) -> Path:
        """Each proposal after the rows of its stamp, except those of the ticks `without`. lose: rows to leave out."""
        gone = {self.stamps[number] for number in without}
        with BagWriter(path) as bag:
            for row, following in zip(self.rows, [*self.rows[1:], ('', -1, b'')], strict=True):
                if lose is None or not lose(row):
                    bag.write_raw(*row)
                stamp_ns = row[1]
                if following[1] != stamp_ns and stamp_ns in self.proposals and stamp_ns not in gone:
                    values = {k: v for k, v in self.proposals[stamp_ns].items() if counters or k != 'sequence'}
                    bag.write(topics.PROPOSED, stamp_ns, named_values_to_message(FACTORY, values, stamp_ns))
        return path


@pytest.fixture(scope='module')
def drive(bag, bundle) -> Drive:
    driver = RawDriver(load_bundle(bundle))
    with open_bag(bag) as reader:
        rows = [(c.topic, t, bytes(d)) for c, t, d in reader.messages() if c.topic in SENSORS]
        ticks = list(read_ticks(reader, bag, cameras=True, privileged=False))
    routes = [tick.route.stamp_ns for tick in ticks]
    found = Drive(rows, [tick.stamp_ns for tick in ticks], routes.index(routes[-1]))
    for number, tick in enumerate(ticks, 1):
        decision = driver.drive(SensorFrame(tick.stamp_ns, tick.images, tick.imu, tick.odometry), tick.route)
        values = named_values_from_message(decision_to_message(FACTORY, decision))
        found.proposals[tick.stamp_ns] = values | {'sequence': float(number)}
    return found


def changed(drive: Drive, numbers: range, **values: float) -> Drive:
    """The proposals of these ticks with other values, as if the planner had decided otherwise."""
    stamps = {drive.stamps[number] for number in numbers}
    return replace(drive, proposals={s: v | (values if s in stamps else {}) for s, v in drive.proposals.items()})


def test_a_drive_with_counters_is_equal_and_a_changed_decision_is_found(drive, bundle, tmp_path) -> None:
    found = verify_bag(drive.write(tmp_path / 'whole'), bundle)
    assert (found.equal, found.compared, found.lost, found.left_out, found.not_compared) == (True, 120, 0, 0, 0)
    assert found.text == '120 decisions are equal, bit for bit'
    found = verify_bag(changed(drive, range(70, 71), steer=0.123).write(tmp_path / 'other'), bundle)
    assert (found.equal, found.compared, found.first['stamp_ns']) == (False, 120, drive.stamps[70])


def test_lost_proposals_are_counted_and_the_belief_advances_as_it_did(drive, bundle, tmp_path, capsys) -> None:
    lost = (5, 6, 7, 20, 61)
    path = drive.write(tmp_path / 'lost', without=lost)
    driven, drove = [], RawDriver.drive
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(RawDriver, 'drive', lambda self, f, r: (driven.append(f.stamp_ns), drove(self, f, r))[1])
        found = verify_bag(path, bundle)
    assert driven == drive.stamps, 'a decision that is lost has changed the belief all the same'
    assert (found.equal, found.compared, found.lost, found.left_out) == (True, 115, 5, 0)
    assert main(['replay', str(path), '--verify', '--bundle', str(bundle)]) == 0
    assert 'lost 5 proposals' in capsys.readouterr().out


def test_ticks_without_a_decision_are_not_called_lost(drive, bundle, tmp_path) -> None:
    idle = range(30, 35)
    found = verify_bag(undecided(drive, bundle, idle).write(tmp_path / 'idle'), bundle)
    assert (found.equal, found.compared, found.lost, found.left_out) == (True, 115, 0, 5)


def undecided(drive: Drive, bundle: Path, idle: range) -> Drive:
    """As a planner that was inactive at these ticks has driven."""
    driver, proposals = RawDriver(load_bundle(bundle)), {}
    by_stamp = {stamp: number for number, stamp in enumerate(drive.stamps)}
    ticks = _ticks(drive)
    for tick in ticks:
        if by_stamp[tick.stamp_ns] in idle:
            continue
        decision = driver.drive(SensorFrame(tick.stamp_ns, tick.images, tick.imu, tick.odometry), tick.route)
        values = named_values_from_message(decision_to_message(FACTORY, decision))
        proposals[tick.stamp_ns] = values | {'sequence': len(proposals) + 1.0}
    return replace(drive, proposals=proposals)


def _ticks(drive: Drive) -> list:
    import tempfile

    with tempfile.TemporaryDirectory() as folder:
        path = drive.write(Path(folder) / 'bag')
        with open_bag(path) as reader:
            return list(read_ticks(reader, path, cameras=True, privileged=False))


def test_some_of_the_ticks_in_a_gap_were_decided_so_nothing_is_known_until_the_next_route(
    drive, bundle, tmp_path
) -> None:
    planner = undecided(drive, bundle, range(30, 33))
    # Of ticks 30 to 34, one of the first three was not decided, or one of the last two is lost: who knows?
    found = verify_bag(planner.write(tmp_path / 'both', without=(33, 34)), bundle)
    assert (found.equal, found.lost, found.left_out) == (True, 2, 3)
    assert found.not_compared == drive.second - 35
    assert found.compared == 30 + 120 - drive.second
    assert f'{found.not_compared} decisions not compared' in found.text


def test_a_decision_whose_picture_the_bag_misses_is_followed_by_nothing_that_is_compared_in_that_episode(
    drive, bundle, tmp_path
) -> None:
    def lose(row) -> bool:
        return row[0] == topics.image_topic('back') and row[1] == drive.stamps[10]

    # What the planner made of that picture can be anything: a difference after it says nothing.
    other = changed(drive, range(11, drive.second), steer=0.123)
    found = verify_bag(other.write(tmp_path / 'hole', lose=lose), bundle)
    assert (found.equal, found.compared, found.lost) == (True, 10 + 120 - drive.second, 0)
    assert found.not_compared == drive.second - 11


def test_a_recording_that_begins_in_the_middle_is_compared_from_the_next_episode_on(drive, bundle, tmp_path) -> None:
    begins_ns = drive.stamps[40]

    def lose(row) -> bool:
        return row[1] < begins_ns and not topics.BY_NAME[row[0]].qos.latched

    path = changed(drive, range(40, drive.second), steer=0.123).write(
        tmp_path / 'late', without=tuple(range(40)), lose=lose
    )
    found = verify_bag(path, bundle)
    assert (found.equal, found.lost, found.not_compared) == (True, 0, drive.second - 40)
    assert found.compared == 120 - drive.second
    nothing = changed(drive, range(40, 120), steer=0.123).write(
        tmp_path / 'none',
        without=tuple(range(40)),
        lose=lambda row: lose(row) or row[1] >= drive.stamps[drive.second],
    )
    found = verify_bag(nothing, bundle)
    assert (found.equal, found.compared) == (False, 0)
    assert found.text.startswith('nothing could be compared')


def test_a_planner_that_was_started_again_begins_with_an_empty_belief(drive, bundle, tmp_path) -> None:
    driver, proposals = RawDriver(load_bundle(bundle)), {}
    for number, tick in enumerate(_ticks(drive)):
        if number == 25:
            driver.reset()
        decision = driver.drive(SensorFrame(tick.stamp_ns, tick.images, tick.imu, tick.odometry), tick.route)
        values = named_values_from_message(decision_to_message(FACTORY, decision))
        proposals[tick.stamp_ns] = values | {'sequence': float(number + 1 if number < 25 else number - 24)}
    found = verify_bag(replace(drive, proposals=proposals).write(tmp_path / 'again'), bundle)
    assert (found.equal, found.compared, found.lost) == (True, 120, 0), found.text


def set_back(drive: Drive, first_tick: int, by_ns: int) -> Drive:
    """The time begins again at that tick, as when a simulation is started anew."""
    since_ns = drive.stamps[first_tick] - DECISION_NS
    rows = []
    for topic, stamp_ns, data in drive.rows:
        if stamp_ns <= since_ns or 'extrinsics' in topic:
            rows.append((topic, stamp_ns, data))
            continue
        msgtype = topics.BY_NAME[topic].msgtype
        message = FACTORY.deserialize(data, msgtype)
        own_ns = stamp_of(msgtype, data)
        assert own_ns is not None
        set_stamp(message.header.stamp, own_ns - by_ns)
        rows.append((topic, stamp_ns - by_ns, FACTORY.serialize(message, msgtype)))
    return replace(drive, rows=rows)


def test_drives_whose_time_begins_again_are_verified_one_by_one(drive, bundle, tmp_path) -> None:
    # The second episode has the stamps of the first one.
    by_ns = drive.stamps[drive.second] - drive.stamps[0]
    back = set_back(drive, drive.second, by_ns)
    path = tmp_path / 'back'
    with BagWriter(path) as bag:
        for (topic, stamp_ns, data), old in zip(back.rows, drive.rows, strict=True):
            bag.write_raw(topic, stamp_ns, data)
            if topic == topics.image_topic('back'):
                values = drive.proposals[old[1]]
                bag.write(topics.PROPOSED, stamp_ns, named_values_to_message(FACTORY, values, stamp_ns))
    found = verify_bag(path, bundle)
    assert (found.equal, found.compared, found.drives, found.lost) == (True, 120, 2, 0), found.text
    assert '2 drives, each by itself' in found.text


def test_a_proposal_that_is_none_is_counted_and_the_rest_verified(drive, bundle, tmp_path) -> None:
    found = verify_bag(changed(drive, range(70, 71), steer=float('nan')).write(tmp_path / 'nan'), bundle)
    assert (found.equal, found.compared, found.lost) == (True, 119, 1)
    assert '1 messages on /control/proposed are no proposals' in found.text


def test_older_bags_without_counters_are_verified_as_ever(drive, bundle, tmp_path) -> None:
    found = verify_bag(drive.write(tmp_path / 'whole', counters=False), bundle)
    assert (found.equal, found.compared, found.lost) == (True, 120, 0)
    found = verify_bag(drive.write(tmp_path / 'lost', counters=False, without=(30, 31)), bundle)
    assert (found.compared, found.left_out, found.lost, found.not_compared) == (118, 2, 0, 0)
