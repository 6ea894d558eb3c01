"""Reading bags with clear errors. Their ticks: `recording.ticks`."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from rosbags.rosbag2 import Reader

from msg_adapters.factory import RosbagsFactory
from msg_adapters.sensors import calibration_from_messages
from raw2drive_ros.contracts import topics
from raw2drive_ros.contracts.errors import BagError, ContractError
from raw2drive_ros.contracts.public import CameraCalibration
from raw2drive_ros.recording.stamped_mcap import StampedReader

# Files of a bag, each of which may be given in place of its folder.
BAG_FILES = ('.mcap', '.db3', '.yaml')
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
        reader = StampedReader(folder)
        reader.open()
    except Exception as error:
        # Damaged files raise all kinds of errors in the library, MemoryError for absurd lengths among them.
        raise BagError(f'{path}: cannot be opened: {str(error) or type(error).__name__}') from error
    try:
        yield reader
    finally:
        reader.close()


def messages_in(reader: Reader, **selection: Any) -> Iterator[tuple[Any, int, bytes]]:
    """`Reader.messages`, with a BagError for whatever the library raises at damaged data."""
    found = reader.messages(**selection)
    while True:
        try:
            item = next(found)
        except StopIteration:
            return
        except Exception as error:
            raise BagError(f'{reader.path}: damaged: {str(error) or type(error).__name__}') from error
        yield item


def is_latched(connection: Any) -> bool:
    """Whether the topic is latched (TRANSIENT_LOCAL): sent once and kept for late subscribers."""
    return any(qos.durability.name == 'TRANSIENT_LOCAL' for qos in connection.ext.offered_qos_profiles)


def begin_ns(reader: Reader) -> int:
    """Stamp of the first message that is not latched: latched ones may have been stamped hours before."""
    flowing = [connection for connection in reader.connections if not is_latched(connection)]
    for _, stamp, _ in messages_in(reader, connections=flowing) if flowing else ():
        return int(stamp)
    return int(reader.start_time)


def decoded(factory: RosbagsFactory, reader: Reader, connection: Any, data: bytes) -> Any:
    """The deserialised message. Raises BagError for bytes that are not of its type."""
    try:
        return factory.deserialize(data, connection.msgtype)
    except Exception as error:
        what = str(error) or type(error).__name__
        raise BagError(f'{reader.path}: {connection.topic}: not a {connection.msgtype}: {what}') from error


def find_bags(roots: list[Path]) -> list[Path]:
    """Every bag folder at or below the given paths, sorted. Raises BagError when there is none."""
    found: set[Path] = set()
    for root in roots:
        if not root.exists():
            raise BagError(f'{root}: no such file or folder')
        complete = (p for p in root.rglob('metadata.yaml') if not any(q.endswith('.partial') for q in p.parts))
        found |= {p.parent for p in complete}
    if not found:
        raise BagError(f'no bags found under {", ".join(map(str, roots))}')
    return sorted(found)


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
