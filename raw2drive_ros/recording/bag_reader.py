"""Reading bags with clear errors. Their ticks: `recording.ticks`."""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from rosbags.rosbag2 import Reader

from msg_adapters.factory import RosbagsFactory
from msg_adapters.sensors import calibration_from_messages
from raw2drive_ros.bounds import MAX_MESSAGE_BYTES, MAX_STRUCTURED_BYTES
from raw2drive_ros.contracts import topics
from raw2drive_ros.contracts.errors import BagError, ContractError
from raw2drive_ros.contracts.public import CameraCalibration
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
def open_bag(path: Path) -> Iterator[BoundedReader]:
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
    # A cloud may also hold a list of fields, which does multiply; that of actors is small, others are never read.
    flat = connection.msgtype in FLAT_TYPES and connection.topic != topics.ACTORS
    most = MAX_MESSAGE_BYTES if flat else MAX_STRUCTURED_BYTES
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


def read_calibrations(reader: Reader, factory: RosbagsFactory) -> tuple[CameraCalibration, ...]:
    """The cameras of a bag in the order of `topics.CAMERAS`, those of which it has a usable calibration: the first."""
    found: dict[str, CameraCalibration] = {}
    newest: dict[str, Any] = {}
    camera_of = {topic(c): c for c in topics.CAMERAS for topic in (topics.camera_info_topic, topics.extrinsics_topic)}
    connections = [c for c in reader.connections if c.topic in camera_of]
    cameras = {camera_of[c.topic] for c in connections}
    for connection, _, data in messages_in(reader, connections=connections) if connections else ():
        camera = camera_of[connection.topic]
        if camera in found:
            continue
        with suppress(BagError):
            newest[connection.topic] = decoded(factory, reader, connection, data)
        info, pose = newest.get(topics.camera_info_topic(camera)), newest.get(topics.extrinsics_topic(camera))
        if info is not None and pose is not None:
            # What the planner refuses, `recording.ticks` refuses and counts too.
            with suppress(ContractError):
                found[camera] = calibration_from_messages(camera, info, pose)
        if len(found) == len(cameras):
            break
    return tuple(found[camera] for camera in topics.CAMERAS if camera in found)
