"""Reading bags with clear errors, and turning them back into ticks."""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from rosbags.rosbag2 import Reader

from msg_adapters.compressed import image_from_compressed_message
from msg_adapters.factory import RosbagsFactory
from msg_adapters.privileged import advice_from_message, privileged_from_messages, transition_from_message
from msg_adapters.sensors import (
    calibration_from_messages,
    image_from_message,
    imu_from_message,
    odometry_from_message,
    route_from_message,
)
from msg_adapters.stamps import stamp_ns
from raw2drive_ros.bounds import MAX_MESSAGE_BYTES, MAX_STRUCTURED_BYTES
from raw2drive_ros.contracts import topics
from raw2drive_ros.contracts.errors import BagError
from raw2drive_ros.contracts.privileged import PrivilegedFrame, Transition
from raw2drive_ros.contracts.public import CameraCalibration, Image8, ImuSample, OdometrySample, Route
from raw2drive_ros.recording.bounded_bag import BoundedReader

# Files of a bag, each of which may be given in place of its folder.
BAG_FILES = ('.mcap', '.db3', '.yaml')
# Types whose size is in one array of bytes, so that decoding does not multiply it.
FLAT_TYPES = frozenset({'sensor_msgs/msg/Image', 'sensor_msgs/msg/CompressedImage', 'sensor_msgs/msg/PointCloud2'})
UNFINISHED = ': its recorder was killed or still writes; once it has ended, `raw2drive bag recover` saves what is there'


def partial_folder(path: Path) -> Path:
    """Where the bag `path` is written until it is complete."""
    return path.with_name(f'.{path.name}.partial')


def _whose(folder: Path) -> str:
    """What a folder without metadata.yaml probably is, as the end of an error message."""
    below = sorted(file.parent.name for file in folder.glob('*/metadata.yaml'))
    if below:
        return f'; below it there are bags: {", ".join(below[:4])}{" ..." if len(below) > 4 else ""}'
    if any(folder.glob('**/*.mcap')):
        return UNFINISHED
    return ': nothing in it comes from a recorder'


def bag_folder(path: Path) -> Path:
    """The folder of a bag; a file in it may be given in its place."""
    return path.parent if path.is_file() else path


@contextmanager
def open_bag(path: Path) -> Iterator[Reader]:
    """A rosbags Reader. Raises BagError for anything that is not a whole, readable bag."""
    if not path.exists():
        killed = partial_folder(path).is_dir()
        raise BagError(f'{path}: no such bag' + (f', but {partial_folder(path).name}{UNFINISHED}' if killed else ''))
    folder = bag_folder(path)
    if path.is_file() and path.suffix not in BAG_FILES:
        raise BagError(f'{path}: not a bag; a bag is a folder with a metadata.yaml and .mcap or .db3 files')
    if not (folder / 'metadata.yaml').is_file():
        alone = '; `raw2drive bag recover` makes a bag of it' if path.suffix == '.mcap' else _whose(folder)
        raise BagError(f'{path}: not a complete bag (no metadata.yaml){alone}')
    try:
        reader = BoundedReader(folder)
        reader.open()
    except Exception as error:
        # Damaged files raise all kinds of errors in the library.
        raise BagError(f'{path}: cannot be opened: {said(error)}') from error
    try:
        yield reader
    finally:
        reader.close()


def messages_in(reader: Reader, *, any_type: bool = False, **selection: Any) -> Iterator[tuple[Any, int, bytes]]:
    """`Reader.messages`, with a BagError for whatever the library raises at damaged data.

    any_type: also messages whose type is not the one that their topic has in `contracts.topics`. Without it they are a
    BagError: whoever decodes or publishes them would take them for something else.
    """
    if not any_type:
        require_types(reader, selection.get('connections') or reader.connections)
    found = reader.messages(**selection)
    while True:
        try:
            item = next(found)
        except StopIteration:
            return
        except Exception as error:
            raise BagError(f'{reader.path}: damaged: {said(error)}') from error
        yield item


def said(error: Exception) -> str:
    """What an error says, or its kind where it says nothing."""
    if isinstance(error, OSError) and error.strerror:
        return f'{error.filename}: {error.strerror}' if error.filename else error.strerror
    return str(error) or type(error).__name__


def require_types(reader: Reader, connections: Iterable[Any]) -> None:
    """Raises BagError where a topic of `contracts.topics` has another type in the bag."""
    for connection in connections:
        spec = topics.BY_NAME.get(connection.topic)
        if spec is not None and connection.msgtype != spec.msgtype:
            raise BagError(f'{reader.path}: {connection.topic} is {connection.msgtype} there, not {spec.msgtype}')


def is_latched(connection: Any) -> bool:
    """Whether the topic is latched (TRANSIENT_LOCAL): sent once and kept for late subscribers."""
    return any(qos.durability.name == 'TRANSIENT_LOCAL' for qos in connection.ext.offered_qos_profiles)


def begin_ns(reader: Reader) -> int:
    """Stamp of the first message that is not latched: latched ones may have been stamped hours before."""
    flowing = [connection for connection in reader.connections if not is_latched(connection)]
    for _, stamp, _ in messages_in(reader, any_type=True, connections=flowing) if flowing else ():
        return int(stamp)
    return int(reader.start_time)


def decoded(factory: RosbagsFactory, reader: Reader, connection: Any, data: bytes) -> Any:
    """The deserialised message. Raises BagError for bytes that are not of its type, and for implausibly many."""
    most = MAX_MESSAGE_BYTES if connection.msgtype in FLAT_TYPES else MAX_STRUCTURED_BYTES
    if len(data) > most:
        raise BagError(
            f'{reader.path}: {connection.topic}: a {connection.msgtype} of {len(data)} bytes, '
            f'and no more than {most} are read'
        )
    try:
        return factory.deserialize(data, connection.msgtype)
    except Exception as error:
        what = str(error) or type(error).__name__
        raise BagError(f'{reader.path}: {connection.topic}: not a {connection.msgtype}: {what}') from error


@dataclass(slots=True)
class BagSearch:
    """bags: every bag folder that was found, sorted. The others were left out: links: linked folders below the given
    ones, which are not followed. unfinished: what killed recorders left. twice: the same folder by another path."""

    bags: list[Path] = field(default_factory=list)
    links: list[Path] = field(default_factory=list)
    unfinished: list[Path] = field(default_factory=list)
    twice: list[Path] = field(default_factory=list)

    def left_out(self) -> list[str]:
        """A line for each kind of folder that was left out."""
        kinds = (
            (self.links, 'linked folders are not followed; name them to use their bags'),
            (self.unfinished, 'unfinished recordings left out; `raw2drive bag recover` makes bags of them'),
            (self.twice, 'bags were named twice, and are used once'),
        )
        return [f'{len(paths)} {what}: {_listed(paths)}' for paths, what in kinds if paths]


def _listed(paths: list[Path]) -> str:
    return ', '.join(map(str, sorted(paths)[:3])) + (' ...' if len(paths) > 3 else '')


def search_bags(roots: list[Path]) -> BagSearch:
    """Every bag at or below the given paths, and what was left out. Raises BagError when there is none."""
    found: dict[Path, Path] = {}
    search = BagSearch()
    for root in roots:
        if not root.exists():
            raise BagError(f'{root}: no such file or folder')
        for folder, folders, files in os.walk(root):
            here = Path(folder)
            search.links += [here / name for name in folders if (here / name).is_symlink()]
            hidden = [name for name in folders if name.endswith('.partial')]
            search.unfinished += [here / name for name in hidden if any((here / name).rglob('*.mcap'))]
            folders[:] = sorted(name for name in folders if name not in hidden)
            if 'metadata.yaml' not in files or any(part.endswith('.partial') for part in here.parts):
                continue
            known = found.setdefault(here.resolve(), here)
            if known != here:
                search.twice.append(here)
    search.bags = sorted(found.values())
    if not search.bags:
        left = '; '.join(search.left_out())
        raise BagError(f'no bags found under {", ".join(map(str, roots))}' + (f'; {left}' if left else ''))
    return search


def find_bags(roots: list[Path]) -> list[Path]:
    """Every bag folder at or below the given paths, sorted. Raises BagError when there is none."""
    return search_bags(roots).bags


def require_topics(reader: Reader, path: Path, wanted: list[str], purpose: str) -> None:
    """Raises BagError that lists the missing topics."""
    present = {connection.topic for connection in reader.connections}
    missing = [topic for topic in wanted if topic not in present]
    if missing:
        raise BagError(
            f'{path}: {purpose} needs {", ".join(missing)}, which this bag does not have; '
            'record with the simulator bridge, or use another bag'
        )


@dataclass(slots=True)
class BagTick:
    """One decision tick read back from a bag; cameras only where the bag has them."""

    stamp_ns: int
    images: dict[str, Image8]
    imu: ImuSample
    odometry: OdometrySample
    route: Route
    privileged: PrivilegedFrame | None
    transition: Transition | None
    episode: str


def read_calibrations(reader: Reader, factory: RosbagsFactory) -> tuple[CameraCalibration, ...]:
    """The cameras of a bag in the order of `topics.CAMERAS`, those that it has."""
    first: dict[str, Any] = {}
    wanted = {topics.camera_info_topic(c) for c in topics.CAMERAS} | {
        topics.extrinsics_topic(c) for c in topics.CAMERAS
    }
    connections = [c for c in reader.connections if c.topic in wanted]
    for connection, _, data in messages_in(reader, connections=connections):
        if connection.topic not in first:
            first[connection.topic] = decoded(factory, reader, connection, data)
            if len(first) == len(connections):
                break
    return tuple(
        calibration_from_messages(
            camera, first[topics.camera_info_topic(camera)], first[topics.extrinsics_topic(camera)]
        )
        for camera in topics.CAMERAS
        if topics.camera_info_topic(camera) in first and topics.extrinsics_topic(camera) in first
    )


def read_advice(reader: Reader, factory: RosbagsFactory) -> dict[int, int]:
    """stamp -> the expert's action there, in bags that hold it."""
    connections = [c for c in reader.connections if c.topic == topics.ADVICE]
    if not connections:
        return {}
    messages = messages_in(reader, connections=connections)
    return dict(advice_from_message(decoded(factory, reader, c, data)) for c, _, data in messages)


def camera_topics(reader: Reader) -> dict[str, str]:
    """topic -> camera for every camera that the bag holds: its raw topic, or else its compressed one."""
    present = {connection.topic for connection in reader.connections}
    found = {}
    for camera in topics.CAMERAS:
        for topic in (topics.image_topic(camera), topics.compressed_topic(camera)):
            if topic in present:
                found[topic] = camera
                break
    return found


def _image(topic: str, message: Any) -> Image8:
    return image_from_compressed_message(message) if topics.BY_NAME[topic].optional else image_from_message(message)


def read_ticks(reader: Reader, path: Path, *, cameras: bool, privileged: bool = True) -> Iterator[BagTick]:
    """Decision ticks in time order. A tick is complete when its last expected message has arrived."""
    factory = RosbagsFactory()
    image_topics = camera_topics(reader) if cameras else {}
    wanted = set(image_topics) | {topics.IMU, topics.ODOMETRY, topics.ROUTE}
    if privileged:
        wanted |= {topics.BEV, topics.EGO, topics.TRANSITION}
    connections = [c for c in reader.connections if c.topic in wanted]
    route: Route | None = None
    last_ns = -1
    imus: dict[int, ImuSample] = {}
    odometries: dict[int, OdometrySample] = {}
    pending: dict[int, dict[str, Any]] = {}
    needed = len(image_topics) + (3 if privileged else 0)
    try:
        for connection, _, data in messages_in(reader, connections=connections):
            topic = connection.topic
            message = decoded(factory, reader, connection, data)
            if topic == topics.ROUTE:
                route = route_from_message(message)
                continue
            stamp = stamp_ns(message.header.stamp)
            if stamp <= last_ns:
                # A tick that the bridge resent.
                continue
            if topic == topics.IMU:
                imus[stamp] = imu_from_message(message)
            elif topic == topics.ODOMETRY:
                odometries[stamp] = odometry_from_message(message)
            else:
                pending.setdefault(stamp, {})[topic] = message
            # Messages of one stamp come in any order: whichever is last completes the tick.
            parts = pending.get(stamp, {})
            if route is None or len(parts) < needed or stamp not in imus or stamp not in odometries:
                continue
            del pending[stamp]
            last_ns = stamp
            images = {image_topics[t]: _image(t, m) for t, m in parts.items() if t in image_topics}
            frame, transition, episode = None, None, ''
            if privileged:
                frame = privileged_from_messages(parts[topics.BEV], parts[topics.EGO])
                transition, episode = transition_from_message(parts[topics.TRANSITION])
            yield BagTick(stamp, images, imus[stamp], odometries[stamp], route, frame, transition, episode)
            imus = {s: v for s, v in imus.items() if s > stamp}
            odometries = {s: v for s, v in odometries.items() if s > stamp}
            pending = {s: v for s, v in pending.items() if s > stamp}
    except BagError:
        raise
    except Exception as error:
        raise BagError(f'{path}: damaged after {reader.message_count} messages were promised: {error}') from error
