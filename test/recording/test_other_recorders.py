"""Bags of other recorders: each command gives the right data or one line, and nobody publishes foreign bytes.

Whatever raises another error than BagError here would be a traceback of the command.
"""

from collections import Counter

import numpy as np
import pytest
from other_recorders import Recorder, changed, record, recorders, rows_of
from recording_helpers import messages_of

from raw2drive_ros.cli.main import main
from raw2drive_ros.contracts import topics
from raw2drive_ros.contracts.errors import BagError
from raw2drive_ros.evaluation.verify import recorded_proposals
from raw2drive_ros.recording.bag_doctor import examine
from raw2drive_ros.recording.bag_info import bag_info
from raw2drive_ros.recording.bag_reader import messages_in, open_bag, read_ticks
from raw2drive_ros.recording.recover import recover
from raw2drive_ros.training.config import make_config
from raw2drive_ros.training.dataset import load_bag

UNTIL_NS = 1_250_000_000
MODEL = make_config('nano').model


@pytest.fixture(scope='module')
def rows(bag):
    return rows_of(bag, UNTIL_NS)


@pytest.fixture(scope='module')
def expected(rows, tmp_path_factory):
    """What the same drive looks like when this project has recorded it."""
    folder = tmp_path_factory.mktemp('ours')
    path = record(rows, folder / 'bag', Recorder('mcap', 'chunk_zstd'))
    with open_bag(path) as reader:
        ticks = list(read_ticks(reader, path, cameras=True))
    return ticks, load_bag(path, folder / 'cache', MODEL, cameras=False)


def made(rows, folder, recorder):
    """The bag, and its messages as (topic, time, bytes)."""
    written = changed(rows, recorder)
    return record(written, folder / 'bag', recorder), Counter((t, ns, data) for t, _, ns, data in written)


def refusal(recorder: Recorder) -> str:
    """What every reader has to say of the bag as a whole, or ''."""
    if recorder.metadata == 'absent':
        return r'no metadata\.yaml'
    if recorder.metadata == 'newer':
        return 'version 42'
    return 'parts are missing' if recorder.part_missing else ''


def everything_for_ticks(bag):
    with open_bag(bag) as reader:
        return list(read_ticks(reader, bag, cameras=True))


def everything_for_the_wire(bag):
    """What the player does."""
    with open_bag(bag) as reader:
        wanted = [c for c in reader.connections if c.topic in topics.SENSOR_TOPICS]
        return [(c.topic, bytes(data)) for c, _, data in messages_in(reader, connections=wanted)]


@pytest.mark.parametrize('recorder', recorders(), ids=str)
def test_right_data_or_one_line(rows, expected, tmp_path, recorder, capsys) -> None:
    path, messages = made(rows, tmp_path, recorder)
    readers = {
        'info': lambda: bag_info(path),
        'train': lambda: load_bag(path, tmp_path / 'cache', MODEL, cameras=False),
        'verify': lambda: everything_for_ticks(path),
        'play': lambda: everything_for_the_wire(path),
    }
    why = refusal(recorder)
    if why:
        for read in readers.values():
            with pytest.raises(BagError, match=why):
                read()
        assert main(['bag', 'info', str(path)]) == main(['bag', 'doctor', str(path)]) == 1
        said = capsys.readouterr()
        assert len(said.err.splitlines()) == 1
        assert len([line for line in said.out.splitlines() if line.startswith('error: ')]) == 1
    else:
        assert Counter(messages_of(path)) == messages
        info = readers['info']()
        assert info['messages'] == messages.total()
        found = examine(path)
        if recorder.foreign:
            for name in ('train', 'verify', 'play'):
                with pytest.raises(BagError, match=f'{topics.ODOMETRY} is geometry_msgs/msg/PoseStamped there'):
                    readers[name]()
            assert any('not nav_msgs/msg/Odometry' in complaint.text for complaint in found)
        elif recorder.clock != 'zero':
            check_data(readers, expected)
        else:
            # All messages have one stamp: whatever a reader makes of that, it is one of the ticks, or one line.
            for name in ('train', 'verify'):
                try:
                    assert len(readers[name]()) <= len(expected[0])
                except BagError as error:
                    assert str(path) in str(error)
        promised = [complaint for complaint in found if 'metadata.yaml promises' in complaint.text]
        assert bool(promised) == (recorder.metadata in ('wrong_counts', 'zero_counts'))
    saved = recover(path, tmp_path / 'saved')
    assert (saved.skipped, saved.damaged, saved.breaks, saved.lost_s) == ({}, 0, 0, {})
    assert saved.account.lines() == []
    assert Counter(messages_of(tmp_path / 'saved')) == messages


def check_data(readers, expected) -> None:
    ticks, arrays = expected
    got = readers['verify']()
    assert [tick.stamp_ns for tick in got] == [tick.stamp_ns for tick in ticks]
    for one, other in zip(got, ticks, strict=True):
        assert np.array_equal(one.images['front'], other.images['front'])
        assert (one.imu, one.odometry, one.transition) == (other.imu, other.odometry, other.transition)
    trained = readers['train']()
    for name in ('masks', 'ego', 'vector', 'action', 'reward', 'flags'):
        assert np.array_equal(getattr(trained, name), getattr(arrays, name)), name
    assert len(readers['play']()) > 0


def test_a_foreign_type_among_the_proposals_is_not_compared(rows, tmp_path) -> None:
    foreign = [(topics.PROPOSED, *row[1:]) for row in rows if row[0] == topics.IMU]
    path = record(foreign, tmp_path / 'bag', Recorder('mcap', 'none'))
    with pytest.raises(BagError, match=f'{topics.PROPOSED} is sensor_msgs/msg/Imu there, not sensor_msgs/msg/Joint'):
        recorded_proposals(path)


def test_two_publishers_of_one_topic_with_different_qos_are_one_topic(rows, tmp_path) -> None:
    """In a bag of two publishers, rosbag2 writes the topic once in metadata.yaml; each channel keeps its own QoS."""
    path = record(rows, tmp_path / 'bag', Recorder('mcap', 'none'))
    file = path / 'metadata.yaml'
    file.write_text(file.read_text().replace('transient_local', 'volatile'))
    assert bag_info(path)['messages'] == len(rows)
    assert Counter(messages_of(path)) == Counter((t, ns, data) for t, _, ns, data in rows)


def test_a_bag_without_message_indices_holds_its_messages(rows, tmp_path) -> None:
    """Readers that go by the index see an empty bag."""
    from mcap.writer import IndexType, Writer

    path = record(rows, tmp_path / 'bag', Recorder('mcap', 'chunk_lz4'))
    for kinds in (IndexType.NONE, IndexType.CHUNK):
        _rewrite(next(path.glob('*.mcap')), Writer, kinds)
        assert Counter(messages_of(path)) == Counter((t, ns, data) for t, _, ns, data in rows)


def _rewrite(file, writer_kind, kinds) -> None:
    from mcap.reader import make_reader

    with file.open('rb') as stream:
        found = list(make_reader(stream).iter_messages())
    writer = writer_kind(str(file), index_types=kinds, chunk_size=2**16)
    writer.start(profile='ros2')
    known = {}
    for schema, channel, message in found:
        if channel.topic not in known:
            number = writer.register_schema(schema.name, schema.encoding, schema.data)
            known[channel.topic] = writer.register_channel(channel.topic, 'cdr', number, dict(channel.metadata))
        writer.add_message(known[channel.topic], message.log_time, message.data, message.publish_time)
    writer.finish()
