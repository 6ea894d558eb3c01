"""MCAP bags: atomic appearance, provenance, disk-space guard.

A bag is written inside `.<name>.partial/` and moved out when closed, so a folder of bags never holds a
half-written one. MCAP because a killed sqlite3 writer loses everything.
"""

from __future__ import annotations

import json
import platform
import shutil
import subprocess
import time
from pathlib import Path
from types import TracebackType
from typing import Any

from mcap.exceptions import EndOfFile
from mcap.records import Chunk, Message
from mcap.stream_reader import StreamReader
from rosbags.interfaces import Connection, Qos, QosDurability, QosHistory, QosLiveliness, QosReliability, QosTime
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin
from rosbags.rosbag2.storage_mcap import McapWriter
from rosbags.typesys import get_types_from_msg

from msg_adapters.factory import RosbagsFactory
from raw2drive_ros import __version__
from raw2drive_ros.contracts import topics
from raw2drive_ros.contracts.errors import BagExistsError, DiskFullError
from raw2drive_ros.recording.bag_reader import partial_folder
from raw2drive_ros.recording.stamped_mcap import StampedWriter

MIN_FREE_BYTES = 500_000_000
CHECK_SPACE_EVERY_BYTES = 50_000_000
PROVENANCE = 'provenance.json'


def _holds_messages(file: Path) -> bool:
    """Whether the file holds more than its header; what cannot be read counts as more."""
    try:
        with file.open('rb') as stream:
            return any(isinstance(r, Chunk | Message) for r in StreamReader(stream, emit_chunks=True).records)
    except EndOfFile:
        return False
    except Exception:
        # Every kind of damage raises another error.
        return file.stat().st_size > 0


def require_new(path: Path) -> None:
    """Raises BagExistsError where the bag, or what a killed recorder left of it, is already there."""
    if path.exists():
        raise BagExistsError(f'{path} exists already; choose another name or remove it')
    partial = partial_folder(path)
    if any(map(_holds_messages, partial.rglob('*.mcap'))):
        raise BagExistsError(
            f'{partial} holds what a killed recorder left: `raw2drive bag recover {path} --out OTHER` saves it; '
            'choose another name, or remove it'
        )


def require_space(folder: Path, needed: int = MIN_FREE_BYTES) -> None:
    """Raises DiskFullError, which says how much is left and what to do."""
    existing = folder
    while not existing.exists():
        existing = existing.parent
    free = shutil.disk_usage(existing).free
    if free < needed:
        raise DiskFullError(
            f'{free / 1e6:.0f} MB free at {existing}, {needed / 1e6:.0f} MB needed: '
            'free some space or choose another folder'
        )


def git_revision() -> str:
    """Short hash of the source tree, '+' appended when it has changes, or 'unknown'."""
    root = Path(__file__).resolve().parents[2]
    try:
        head = subprocess.run(
            ['git', '-C', str(root), 'rev-parse', '--short', 'HEAD'],
            capture_output=True,
            text=True,
            timeout=5,
            check=True,
        ).stdout.strip()
        dirty = subprocess.run(
            ['git', '-C', str(root), 'status', '--porcelain', '--untracked-files=no'],
            capture_output=True,
            text=True,
            timeout=5,
            check=True,
        ).stdout.strip()
    except (OSError, subprocess.SubprocessError):
        return 'unknown'
    return head + ('+' if dirty else '')


def _qos(profile: topics.QosProfile) -> Qos:
    return Qos(
        QosHistory.KEEP_LAST,
        profile.depth,
        QosReliability.RELIABLE if profile.reliable else QosReliability.BEST_EFFORT,
        QosDurability.TRANSIENT_LOCAL if profile.latched else QosDurability.VOLATILE,
        QosTime(0, 0),
        QosTime(0, 0),
        QosLiveliness.AUTOMATIC,
        QosTime(0, 0),
        avoid_ros_namespace_conventions=False,
    )


class BagWriter:
    """Context manager; `write` takes messages of `RosbagsFactory`, `write_raw` CDR bytes."""

    def __init__(self, path: Path, provenance: dict[str, str] | None = None, *, compress: bool = True) -> None:
        self.path = path
        self.root = partial_folder(path)
        # The final name: rosbag2 names the file inside after its folder.
        self.partial = self.root / path.name
        require_new(path)
        require_space(path.parent)
        if self.root.exists():
            shutil.rmtree(self.root)
        self.root.mkdir(parents=True)
        self.factory = RosbagsFactory()
        self.writer = StampedWriter(self.partial, version=9, storage_plugin=StoragePlugin.MCAP)
        if compress:
            self.writer.set_compression(CompressionMode.STORAGE, CompressionFormat.ZSTD)
        metadata = {
            'raw2drive_version': __version__,
            'git': git_revision(),
            'recorded_on': platform.machine(),
            'recorded_at': time.strftime('%Y-%m-%dT%H:%M:%SZ', time.gmtime()),
        }
        metadata |= provenance or {}
        self.metadata: dict[str, str] = {}
        self.note(metadata)
        self.writer.open()
        self.connections: dict[str, Connection] = {}
        self.counts: dict[str, int] = {}
        self.bytes = self.checked_bytes = 0
        self.first_ns: int | None = None
        self.begins_ns: dict[str, int] = {}
        self.last_ns: dict[str, int] = {}
        self.largest_gap_ns: dict[str, int] = {}

    def __enter__(self) -> BagWriter:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        if kind is None or issubclass(kind, KeyboardInterrupt):
            self.close()
        else:
            self.abort()

    def note(self, metadata: dict[str, str]) -> None:
        """Add to the provenance, any time before the bag is closed."""
        self.metadata |= metadata
        for key, value in metadata.items():
            self.writer.set_custom_data(key, value)
        # metadata.yaml is written when the bag is closed; for a writer that is killed before, this file keeps it.
        (self.root / PROVENANCE).write_text(json.dumps(self.metadata))

    def write(self, topic: str, stamp_ns: int, message: Any) -> None:
        spec = topics.BY_NAME[topic]
        self.write_raw(topic, stamp_ns, self.factory.serialize(message, spec.msgtype))

    def write_raw(
        self,
        topic: str,
        stamp_ns: int,
        data: bytes,
        foreign: tuple[str, str] | None = None,
        received_ns: int | None = None,
    ) -> None:
        """foreign: message type and its definition, for topics that are not in our table. received_ns: time of
        reception (system clock), the message's log_time; None: its stamp, where nobody received it."""
        if topic not in self.connections:
            self.connections[topic] = self._connect(topic, foreign)
        self.writer.write_at(self.connections[topic], stamp_ns, received_ns, data)
        self.counts[topic] = self.counts.get(topic, 0) + 1
        self.bytes += len(data)
        self.first_ns = stamp_ns if self.first_ns is None else min(self.first_ns, stamp_ns)
        gap_ns = stamp_ns - self.last_ns.get(topic, stamp_ns)
        self.largest_gap_ns[topic] = max(self.largest_gap_ns.get(topic, 0), gap_ns)
        self.begins_ns.setdefault(topic, stamp_ns)
        self.last_ns[topic] = stamp_ns
        if self.bytes - self.checked_bytes > CHECK_SPACE_EVERY_BYTES:
            self.checked_bytes = self.bytes
            require_space(self.partial)

    def _connect(self, topic: str, foreign: tuple[str, str] | None) -> Connection:
        spec, typestore = topics.BY_NAME.get(topic), self.factory.typestore
        msgtype = foreign[0] if foreign is not None else topics.BY_NAME[topic].msgtype
        if foreign is not None and msgtype not in typestore.types:
            typestore.register(get_types_from_msg(foreign[1], msgtype))
        qos = [_qos(spec.qos)] if spec is not None and spec.msgtype == msgtype else []
        return self.writer.add_connection(topic, msgtype, typestore=typestore, offered_qos_profiles=qos)

    def flush(self) -> None:
        """Hand everything so far to the operating system: a kill from here on does not lose it."""
        storage = self.writer.storage
        # rosbags closes a chunk when it holds a megabyte, which may take any time.
        if isinstance(storage, McapWriter):
            if storage.chunk.msgs:
                storage.close_chunk()
            storage.bio.flush()

    def close(self) -> Path:
        """Finish the bag and give it its name."""
        self.writer.close()
        self.partial.replace(self.path)
        (self.root / PROVENANCE).unlink(missing_ok=True)
        self.root.rmdir()
        return self.path

    def abort(self) -> None:
        """Close what was written so that it can be read, and leave it inside `.<name>.partial/`."""
        if self.writer.storage is not None:
            self.writer.close()
