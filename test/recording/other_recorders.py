"""Bags as other recorders write them: storage, compression, metadata and clocks in all combinations."""

import random
from dataclasses import dataclass, replace
from pathlib import Path

import yaml
from mcap.writer import CompressionType
from mcap.writer import Writer as McapLibraryWriter
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer

from msg_adapters.factory import RosbagsFactory
from raw2drive_ros.contracts import topics
from raw2drive_ros.recording.bag_reader import open_bag
from raw2drive_ros.recording.bag_writer import _qos as qos_of

STORAGES = {
    'mcap': ('none', 'chunk_zstd', 'chunk_lz4', 'file_zstd', 'message_zstd'),
    'sqlite3': ('none', 'file_zstd', 'message_zstd'),
}
MODES = {
    'none': CompressionMode.NONE,
    'chunk_zstd': CompressionMode.STORAGE,
    'file_zstd': CompressionMode.FILE,
    'message_zstd': CompressionMode.MESSAGE,
}
METADATA = ('there', 'absent', 'wrong_counts', 'zero_counts', 'newer')
CLOCKS = ('stamps', 'wall', 'zero')
FACTORY = RosbagsFactory()
FOREIGN = 'geometry_msgs/msg/PoseStamped'
Row = tuple[str, str, int, bytes]


@dataclass(frozen=True)
class Recorder:
    """clock: stamps: log times are the stamps. wall: log times are those of a wall clock. zero: and all stamps are 0.
    part_missing: metadata.yaml names a second part that is not there. foreign: odometry has another type."""

    storage: str
    compression: str
    metadata: str = 'there'
    clock: str = 'stamps'
    part_missing: bool = False
    foreign: bool = False

    def __str__(self) -> str:
        flags = [name for name in ('part_missing', 'foreign') if getattr(self, name)]
        return '-'.join([self.storage, self.compression, self.metadata, self.clock, *flags])


def recorders() -> list[Recorder]:
    """Every storage with every compression and metadata; every storage and compression with every other property; and
    a random sample of everything together."""
    plain = [Recorder(storage, kind) for storage, kinds in STORAGES.items() for kind in kinds]
    found = [replace(each, metadata=metadata) for each in plain for metadata in METADATA]
    for each in plain:
        found += [replace(each, clock=clock) for clock in CLOCKS[1:]]
        found += [replace(each, part_missing=True), replace(each, foreign=True)]
    rng = random.Random(1)
    for _ in range(24):
        each = rng.choice(plain)
        found.append(
            Recorder(
                each.storage,
                each.compression,
                rng.choice(METADATA),
                rng.choice(CLOCKS),
                part_missing=rng.random() < 0.3,
                foreign=rng.random() < 0.4,
            )
        )
    return list(dict.fromkeys(found))


def rows_of(bag: Path, until_ns: int) -> list[Row]:
    """(topic, type, stamp, data) of a drive's first ticks, with its front camera only."""
    skipped = {f'/sensing/camera/{camera}/' for camera in topics.CAMERAS[1:]}
    with open_bag(bag) as reader:
        return [
            (c.topic, c.msgtype, stamp, bytes(data))
            for c, stamp, data in reader.messages(stop=until_ns)
            if not any(c.topic.startswith(prefix) for prefix in skipped)
        ]


def changed(rows: list[Row], recorder: Recorder) -> list[Row]:
    """The rows with the recorder's clock, and with odometry of a foreign type where it has that."""
    wall_ns = 1_764_000_000 * 10**9
    found = []
    for topic, recorded, stamp_ns, data in rows:
        kind = recorded
        log_ns = stamp_ns if recorder.clock == 'stamps' else wall_ns + stamp_ns
        content = data
        if recorder.clock == 'zero' and kind != 'rosgraph_msgs/msg/Clock':
            message = FACTORY.deserialize(data, kind)
            message.header.stamp.sec = message.header.stamp.nanosec = 0
            content = FACTORY.serialize(message, kind)
        if recorder.foreign and topic == topics.ODOMETRY:
            odometry = FACTORY.deserialize(content, kind)
            pose = FACTORY.new(FOREIGN)
            pose.header, pose.pose = odometry.header, odometry.pose.pose
            kind, content = FOREIGN, FACTORY.serialize(pose, FOREIGN)
        found.append((topic, kind, log_ns, content))
    return found


def record(rows: list[Row], folder: Path, recorder: Recorder) -> Path:
    """Write the bag of a recorder."""
    if recorder.compression == 'chunk_lz4':
        _record_lz4(rows, folder)
    else:
        _record(rows, folder, recorder)
    file = folder / 'metadata.yaml'
    loaded = yaml.safe_load(file.read_text())
    body = loaded['rosbag2_bagfile_information']
    if recorder.metadata == 'absent':
        file.unlink()
        return folder
    if recorder.metadata in ('wrong_counts', 'zero_counts'):
        for row in body['topics_with_message_count']:
            row['message_count'] = 0 if recorder.metadata == 'zero_counts' else row['message_count'] // 2
        body['message_count'] = 0 if recorder.metadata == 'zero_counts' else 3
        body['duration']['nanoseconds'] = body['starting_time']['nanoseconds_since_epoch'] = 0
    if recorder.metadata == 'newer':
        body['version'] = 42
    if recorder.part_missing:
        name = body['relative_file_paths'][0]
        body['relative_file_paths'].append(f'second_{name}')
    file.write_text(yaml.safe_dump(loaded))
    return folder


def _record(rows: list[Row], folder: Path, recorder: Recorder) -> None:
    plugin = StoragePlugin.MCAP if recorder.storage == 'mcap' else StoragePlugin.SQLITE3
    writer = Writer(folder, version=9, storage_plugin=plugin)
    writer.set_compression(MODES[recorder.compression], CompressionFormat.ZSTD)
    with writer:
        connections = {}
        for topic, kind, log_ns, data in rows:
            if topic not in connections:
                spec = topics.BY_NAME[topic]
                qos = [qos_of(spec.qos)] if spec.msgtype == kind else []
                connections[topic] = writer.add_connection(
                    topic, kind, typestore=FACTORY.typestore, offered_qos_profiles=qos
                )
            writer.write(connections[topic], log_ns, data)


def _record_lz4(rows: list[Row], folder: Path) -> None:
    folder.mkdir()
    name = f'{folder.name}_0.mcap'
    writer = McapLibraryWriter(str(folder / name), compression=CompressionType.LZ4, chunk_size=2**16)
    writer.start(profile='ros2', library='test')
    schemas, channels, counts = {}, {}, {}
    for number, (topic, kind, log_ns, data) in enumerate(rows):
        if kind not in schemas:
            definition, _ = FACTORY.typestore.generate_msgdef(kind, ros_version=2)
            schemas[kind] = writer.register_schema(kind, 'ros2msg', definition.encode())
        if topic not in channels:
            channels[topic] = writer.register_channel(topic, 'cdr', schemas[kind], {'offered_qos_profiles': ''})
        counts[topic, kind] = counts.get((topic, kind), 0) + 1
        writer.add_message(channels[topic], log_ns, data, log_ns, number)
    writer.finish()
    stamps = [row[2] for row in rows]
    known = [
        {
            'topic_metadata': {
                'name': topic,
                'type': kind,
                'serialization_format': 'cdr',
                'offered_qos_profiles': [],
                'type_description_hash': '',
            },
            'message_count': count,
        }
        for (topic, kind), count in counts.items()
    ]
    body = {
        'version': 9,
        'storage_identifier': 'mcap',
        'relative_file_paths': [name],
        'duration': {'nanoseconds': max(stamps) - min(stamps)},
        'starting_time': {'nanoseconds_since_epoch': min(stamps)},
        'message_count': len(rows),
        'topics_with_message_count': known,
        'compression_format': '',
        'compression_mode': '',
        'custom_data': None,
    }
    (folder / 'metadata.yaml').write_text(yaml.safe_dump({'rosbag2_bagfile_information': body}))
