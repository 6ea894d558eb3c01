"""rosbags' reader of bag folders with bounds. Topics, types and counts come from the storage files themselves; what
metadata.yaml says of them may be of another recorder's making, or wrong.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator
from contextlib import ExitStack, suppress
from pathlib import Path, PurePath
from tempfile import TemporaryDirectory
from typing import Any, ClassVar

import apsw
from rosbags.interfaces import Connection, ConnectionExtRosbag2, MessageDefinitionFormat
from rosbags.rosbag2 import Reader
from rosbags.rosbag2.metadata import ReaderMetadata
from rosbags.rosbag2.storage_sqlite3 import Sqlite3Reader

from raw2drive_ros.bounds import (
    MAX_INDEX_BYTES,
    MAX_MESSAGE_BYTES,
    MAX_TOPICS,
    MAX_YAML_BYTES,
    Allowance,
    TooLargeError,
    read_yaml,
    require_regular,
)
from raw2drive_ros.recording.bounded_mcap import UNTYPED, qos_from
from raw2drive_ros.recording.stamped_mcap import ARRIVAL, StampedMcapReader
from raw2drive_ros.recording.unpack import unpack_file, unpacked_message

METADATA = 'metadata.yaml'
NEWEST_VERSION = 9
MAX_PARTS = 10_000
# Of a database by rosbag2: tables and indices without computed columns. A view may be an endless query.
_NOT_RECORDED = """SELECT count(*) FROM sqlite_master WHERE type NOT IN ('table', 'index')
    OR upper(sql) LIKE 'CREATE VIRTUAL%' OR upper(sql) LIKE '% AS (%' OR upper(sql) LIKE '% AS(%'"""


class BoundedSqlite(Sqlite3Reader):
    """path: the database. packed_bytes: size of the compressed file that it was unpacked from, if any."""

    def __init__(self, path: Any, packed_bytes: int = 0) -> None:
        super().__init__(path)
        self.packed_bytes = packed_bytes

    def open(self) -> None:
        """Raises OSError, ValueError, or what rosbags and apsw raise, for a damaged database or one of another kind."""
        self.packed_bytes = self.packed_bytes or require_regular(self.path)
        probe = apsw.Connection(f'file:{self.path}?immutable=1', apsw.SQLITE_OPEN_READONLY | apsw.SQLITE_OPEN_URI)
        try:
            _require_plain(probe)
        finally:
            probe.close()
        super().open()
        if self.dbconn is not None:
            # Of a value in the database; longer ones raise apsw.TooBigError before they are loaded.
            self.dbconn.limit(apsw.SQLITE_LIMIT_LENGTH, MAX_MESSAGE_BYTES)

    def messages(
        self, connections: Collection[Connection], start: int | None = None, stop: int | None = None
    ) -> Iterator[tuple[Connection, int, bytes]]:
        """As rosbags. Raises ValueError for values of another kind than a message's."""
        allowance = Allowance(self.packed_bytes)
        for connection, stamp_ns, data in super().messages(connections, start, stop):
            if not isinstance(stamp_ns, int) or not isinstance(data, bytes):
                raise ValueError(f'a message that is {type(data).__name__}, at {stamp_ns!r}')
            allowance.spend(0, 1)
            yield connection, stamp_ns, data


def _require_plain(database: apsw.Connection) -> None:
    if one(database, _NOT_RECORDED):
        raise ValueError('a database with views, triggers or computed columns is not that of a recorder')
    if not one(database, "SELECT count(*) FROM sqlite_master WHERE name = 'topics'"):
        raise ValueError('a database without topics')
    topics, different = (
        one(database, 'SELECT count(*) FROM topics'),
        one(database, 'SELECT count(DISTINCT id) FROM topics'),
    )
    if topics > MAX_TOPICS or topics != different:
        raise TooLargeError(f'{topics} topics, {different} of them different')
    columns = [row[1] for row in database.execute('PRAGMA table_info(topics)')]
    if 'offered_qos_profiles' in columns:
        length = one(database, 'SELECT sum(length(offered_qos_profiles)) FROM topics')
        if (length or 0) > MAX_YAML_BYTES:
            raise TooLargeError(f'{length} bytes of QoS profiles')
    if one(database, "SELECT count(*) FROM sqlite_master WHERE name = 'message_definitions'"):
        length = one(database, 'SELECT sum(length(encoded_message_definition)) FROM message_definitions')
        if (length or 0) > MAX_INDEX_BYTES:
            raise TooLargeError(f'{length} bytes of message definitions')


def one(database: apsw.Connection, query: str) -> Any:
    """The only value of a query's first row."""
    row = database.execute(query).fetchone()
    return row[0] if row else None


STORAGES: dict[str, Any] = {'.mcap': StampedMcapReader, '.db3': BoundedSqlite}


def open_storage(file: Path, stack: ExitStack) -> StampedMcapReader | BoundedSqlite:
    """Open one storage file, unpacked into a temporary folder where it is compressed as a whole.

    `stack` closes it. Raises OSError, ValueError, or what rosbags and apsw raise.
    """
    packed_bytes = require_regular(file)
    plain = file
    if file.suffix == '.zstd':
        plain = Path(stack.enter_context(TemporaryDirectory())) / file.stem
        unpack_file(file, plain, Allowance(packed_bytes))
    if plain.suffix not in STORAGES:
        raise ValueError(f'{file.name}: neither an MCAP file nor an SQLite database')
    storage: StampedMcapReader | BoundedSqlite = STORAGES[plain.suffix](plain, packed_bytes)
    storage.open()
    stack.callback(storage.close)
    return storage


def read_metadata(folder: Path) -> dict[str, Any]:
    """`rosbag2_bagfile_information` of a bag. Raises OSError, yaml.YAMLError or ValueError."""
    loaded = read_yaml(folder / METADATA)
    found = loaded.get('rosbag2_bagfile_information') if isinstance(loaded, dict) else None
    if not isinstance(found, dict):
        raise ValueError(f'{METADATA} is not that of a bag')
    return found


class BoundedFolder:
    """The folder of a bag, as `rosbags.rosbag2.Reader` uses it.

    connections: one per topic and type, those of metadata.yaml first; `msgcount` is counted in the storage.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.connections: list[Connection] = []
        self.metadata = ReaderMetadata(0, 2**63 - 1, 0, 0, None, None, None, None)
        self.storages: list[Any] = []
        self.stack = ExitStack()

    def open(self) -> None:
        """Raises OSError, ValueError, or what the libraries raise for damaged files."""
        try:
            self._open(read_metadata(self.path))
        except BaseException:
            with suppress(Exception):
                self.close()
            raise

    def _open(self, body: dict[str, Any]) -> None:
        version = body.get('version')
        if not isinstance(version, int) or version > NEWEST_VERSION:
            raise ValueError(
                f'{METADATA} has version {version!r}, and up to {NEWEST_VERSION} are known; '
                '`raw2drive bag recover` makes a bag of its storage files'
            )
        mode, kind = str(body.get('compression_mode') or '').lower(), body.get('compression_format') or None
        mode = '' if mode in ('none', 'storage') else mode
        if mode not in ('', 'file', 'message') or (mode and kind != 'zstd'):
            raise ValueError(f'compression {kind!r} of {mode!r} is not known')
        names = [PurePath(str(name)).name for name in body.get('relative_file_paths') or []]
        missing = [name for name in names if not (self.path / name).exists()]
        if missing:
            raise ValueError(
                f'{len(missing)} of its {len(names)} parts are missing ({", ".join(missing[:4])}); '
                '`raw2drive bag recover` makes a bag of the others'
            )
        if len(names) > MAX_PARTS or len(set(names)) < len(names):
            raise ValueError(f'{METADATA} names {len(names)} parts, {len(set(names))} different ones')
        for name in names:
            self.storages.append(open_storage(self.path / name, self.stack))
        self.connections = self._connections(body.get('topics_with_message_count') or [])
        spans = [each.metadata for each in self.storages if each.metadata.message_count]
        begin_ns = min((each.start_time for each in spans), default=2**63 - 1)
        end_ns = max((each.end_time for each in spans), default=0)
        custom, distro = body.get('custom_data'), body.get('ros_distro')
        total = sum(each.message_count for each in spans)
        self.metadata = ReaderMetadata(
            end_ns - begin_ns if spans else 0, begin_ns, end_ns, total, kind, mode or None, distro, custom
        )

    def _connections(self, promised: list[Any]) -> list[Connection]:
        stored: dict[tuple[str, str], list[Connection]] = {}
        for storage in self.storages:
            for each in storage.connections:
                stored.setdefault((each.topic, each.msgtype), []).append(each)
        described = {}
        for row in promised:
            about = row['topic_metadata']
            described[str(about['name']), str(about['type'])] = about
        found = []
        for number, (topic, msgtype) in enumerate(dict.fromkeys([*described, *stored])):
            those, about = stored.get((topic, msgtype), []), described.get((topic, msgtype), {})
            stored_qos = [qos for each in those for qos in _extra(each).offered_qos_profiles]
            qos = qos_from(about.get('offered_qos_profiles')) or stored_qos
            serialization = str(about.get('serialization_format') or 'cdr')
            if {serialization, *(_extra(each).serialization_format for each in those)} != {'cdr'}:
                raise ValueError(f'{topic} is not serialised as CDR')
            definitions = [each.msgdef for each in those if each.msgdef.format != MessageDefinitionFormat.NONE]
            found.append(
                Connection(
                    number + 1,
                    topic,
                    msgtype,
                    definitions[0] if definitions else UNTYPED,
                    str(about.get('type_description_hash') or ''),
                    sum(each.msgcount for each in those),
                    ConnectionExtRosbag2(serialization, qos),
                    self,
                )
            )
        return found

    @property
    def stamped(self) -> bool:
        """Whether every file holds both times: log_time is the time of reception and publish_time the stamp."""
        return bool(self.storages) and all(getattr(storage, 'ranges', None) for storage in self.storages)

    def close(self) -> None:
        """Close all files and delete what was unpacked."""
        self.connections.clear()
        self.storages.clear()
        self.stack.close()

    def messages(
        self, connections: Collection[Connection], start: int | None = None, stop: int | None = None
    ) -> Iterator[tuple[Connection, int, bytes]]:
        """Messages of `connections` by time, part after part. Raises ValueError, or what the libraries raise."""
        by_key = {(each.topic, each.msgtype): each for each in connections}
        for storage in self.storages:
            wanted = [each for each in storage.connections if (each.topic, each.msgtype) in by_key]
            allowance = Allowance(storage.packed_bytes)
            for each, stamp_ns, data in storage.messages(wanted, start, stop) if wanted else ():
                content = data
                if self.metadata.compression_mode == 'message':
                    content = unpacked_message(data)
                    allowance.spend(len(content))
                yield by_key[each.topic, each.msgtype], stamp_ns, content


def _extra(connection: Connection) -> ConnectionExtRosbag2:
    assert isinstance(connection.ext, ConnectionExtRosbag2)
    return connection.ext


class BoundedReader(Reader):
    """`rosbags.rosbag2.Reader` of a folder, with bounds.

    `messages` gives stamps, in order of stamps, where the bag holds both times (`stamped_mcap`); otherwise what rosbags
    gives: log times.
    """

    STORAGE_PLUGINS: ClassVar[Any] = {'dir': BoundedFolder}

    @property
    def stamped(self) -> bool:
        """See `BoundedFolder.stamped`."""
        return bool(getattr(self.storage, 'stamped', False))

    def arrivals(self, connections: Collection[Connection] = ()) -> Iterator[tuple[Connection, int, bytes]]:
        """(connection, log_time, data) in the order in which they were written (sqlite3: in order of log_time)."""
        return self.messages(connections, start=ARRIVAL)
