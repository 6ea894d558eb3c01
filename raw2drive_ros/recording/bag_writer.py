"""MCAP bags: atomic appearance, provenance, disk-space guard.

A bag is written inside `.<name>.partial/` and moved out when closed, so a folder of bags never holds a
half-written one. MCAP because a killed sqlite3 writer loses everything.
"""

from __future__ import annotations

import platform
import shutil
import subprocess
import time
from pathlib import Path
from types import TracebackType
from typing import Any

from rosbags.interfaces import Connection, Qos, QosDurability, QosHistory, QosLiveliness, QosReliability, QosTime
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer

from msg_adapters.factory import RosbagsFactory
from raw2drive_ros import __version__, topics

MIN_FREE_BYTES = 500_000_000


class DiskFullError(OSError):
    """Less than the stated space is left on the disk."""


class BagExistsError(FileExistsError):
    """The target bag exists already; bags are never overwritten."""


def require_space(folder: Path, needed: int = MIN_FREE_BYTES) -> None:
    """Raises DiskFullError with what is left and what to do."""
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


def _qos(spec: topics.TopicSpec) -> Qos:
    return Qos(
        QosHistory.KEEP_LAST,
        spec.depth,
        QosReliability.RELIABLE if spec.reliable else QosReliability.BEST_EFFORT,
        QosDurability.TRANSIENT_LOCAL if spec.latched else QosDurability.VOLATILE,
        QosTime(0, 0),
        QosTime(0, 0),
        QosLiveliness.AUTOMATIC,
        QosTime(0, 0),
        False,
    )


class BagWriter:
    """Context manager; `write` takes messages of `RosbagsFactory`, `write_raw` CDR bytes."""

    def __init__(self, path: Path, provenance: dict[str, str] | None = None, *, compress: bool = True) -> None:
        self.path = path
        self.root = path.with_name(f'.{path.name}.partial')
        # The same last name: rosbag2 names the file inside after its folder.
        self.partial = self.root / path.name
        if path.exists():
            raise BagExistsError(f'{path} exists already; choose another name or remove it')
        require_space(path.parent)
        if self.root.exists():
            shutil.rmtree(self.root)
        self.root.mkdir(parents=True)
        self.factory = RosbagsFactory()
        self.writer = Writer(self.partial, version=9, storage_plugin=StoragePlugin.MCAP)
        if compress:
            self.writer.set_compression(CompressionMode.STORAGE, CompressionFormat.ZSTD)
        facts = {
            'raw2drive_version': __version__,
            'git': git_revision(),
            'recorded_on': platform.machine(),
            'recorded_at': time.strftime('%Y-%m-%dT%H:%M:%SZ', time.gmtime()),
        }
        for key, value in (facts | (provenance or {})).items():
            self.writer.set_custom_data(key, value)
        self.writer.open()
        self.connections: dict[str, Connection] = {}
        self.counts: dict[str, int] = {}

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

    def write(self, topic: str, stamp_ns: int, message: Any) -> None:
        spec = topics.BY_NAME[topic]
        self.write_raw(topic, stamp_ns, self.factory.serialize(message, spec.msgtype))

    def write_raw(self, topic: str, stamp_ns: int, data: bytes) -> None:
        if topic not in self.connections:
            spec = topics.BY_NAME[topic]
            self.connections[topic] = self.writer.add_connection(
                topic, spec.msgtype, typestore=self.factory.typestore, offered_qos_profiles=[_qos(spec)]
            )
        self.writer.write(self.connections[topic], stamp_ns, data)
        self.counts[topic] = self.counts.get(topic, 0) + 1
        total = sum(self.counts.values())
        if total % 2000 == 0:
            require_space(self.partial)

    def close(self) -> Path:
        """Finish the bag and give it its name."""
        self.writer.close()
        self.partial.replace(self.path)
        self.root.rmdir()
        return self.path

    def abort(self) -> None:
        """Close what was written so that it can be read, and leave it inside `.<name>.partial/`."""
        self.writer.close()
