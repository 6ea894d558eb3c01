"""A recording that survives a kill and can be split, and the ring buffer of snapshots; no ROS here."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

from raw2drive_ros.contracts import topics
from raw2drive_ros.recording.bag_writer import BagWriter, require_new

# Latched messages may have any stamp (of the boot, of a map file), and nodes without simulated time stamp diagnostics
# with the wall clock. Farther than this from the newest of the other messages, they get its stamp: a bag has one time
# base.
NEAR_NS = 5_000_000_000
MAX_WAITING = 1000


@dataclass(slots=True)
class Recording:
    """Writes to the bag `path` or, if split, to complete bags `path/NAME_000`, `path/NAME_001` and so on.

    split_s, split_bytes: close a bag after this much; 0: never. Each bag begins with the latched messages. Latched
    messages, diagnostics and messages without a time (stamp 0) are held until the first other message sets the time
    base; a kill before that loses them.
    """

    path: Path
    provenance: dict[str, str]
    split_s: float = 0.0
    split_bytes: int = 0
    bags: list[Path] = field(default_factory=list)
    counts: dict[str, int] = field(default_factory=dict)
    largest_gap_ns: dict[str, int] = field(default_factory=dict)
    _writer: BagWriter | None = None
    _latched: dict[str, bytes] = field(default_factory=dict)
    _waiting: list[tuple[str, int, bytes]] = field(default_factory=list)
    _newest_ns: int | None = None

    def __post_init__(self) -> None:
        require_new(self.path)
        self._writer = self._open()

    @property
    def splits(self) -> bool:
        return self.split_s > 0 or self.split_bytes > 0

    def write(self, topic: str, stamp_ns: int, data: bytes) -> None:
        """Raises DiskFullError; what was written before stays."""
        assert self._writer is not None
        latched = topics.BY_NAME[topic].qos.latched
        if latched or topic == topics.DIAGNOSTICS or stamp_ns == 0:
            if self._newest_ns is None:
                self._wait(topic, stamp_ns, data)
                return
            stamp_ns = self._near(stamp_ns)
        else:
            self._newest_ns = stamp_ns
            self._write_waiting()
        if self._full(stamp_ns):
            self._finish()
            self._writer = self._open()
            for name, said in self._latched.items():
                self._writer.write_raw(name, stamp_ns, said)
        if latched:
            self._latched[topic] = data
        self._writer.write_raw(topic, stamp_ns, data)

    def _wait(self, topic: str, stamp_ns: int, data: bytes) -> None:
        """Hold a message. A vehicle may appear hours later: latched ones are kept, others up to MAX_WAITING."""
        if topics.BY_NAME[topic].qos.latched:
            self._latched[topic] = data
            self._waiting = [held for held in self._waiting if held[0] != topic]
        elif len(self._waiting) >= MAX_WAITING:
            self._waiting.pop(
                next(i for i, held in enumerate(self._waiting) if not topics.BY_NAME[held[0]].qos.latched)
            )
        self._waiting.append((topic, stamp_ns, data))

    def _near(self, stamp_ns: int) -> int:
        far = self._newest_ns is not None and abs(stamp_ns - self._newest_ns) > NEAR_NS
        return self._newest_ns if far and self._newest_ns is not None else stamp_ns

    def _write_waiting(self) -> None:
        assert self._writer is not None
        for topic, stamp_ns, data in self._waiting:
            self._writer.write_raw(topic, self._near(stamp_ns), data)
        self._waiting.clear()

    def flush(self) -> None:
        """A kill of the process from here on loses nothing from before."""
        if self._writer is not None:
            self._writer.flush()

    def close(self) -> list[Path]:
        """Finish the last bag; returns every bag that was made."""
        if self._writer is not None:
            self._write_waiting()
            self._finish()
        return self.bags

    def _open(self) -> BagWriter:
        number = len(self.bags)
        path = self.path / f'{self.path.name}_{number:03d}' if self.splits else self.path
        metadata = self.provenance | ({'part': str(number)} if self.splits else {})
        path.parent.mkdir(parents=True, exist_ok=True)
        return BagWriter(path, metadata)

    def _full(self, stamp_ns: int) -> bool:
        writer = self._writer
        if writer is None or writer.first_ns is None:
            return False
        lasted = (stamp_ns - writer.first_ns) * 1e-9
        return 0 < self.split_s <= lasted or 0 < self.split_bytes <= writer.bytes

    def _finish(self) -> None:
        writer, self._writer = self._writer, None
        assert writer is not None
        self.bags.append(writer.close())
        for name, count in writer.counts.items():
            self.counts[name] = self.counts.get(name, 0) + count
            self.largest_gap_ns[name] = max(self.largest_gap_ns.get(name, 0), writer.largest_gap_ns[name])

    @property
    def received(self) -> dict[str, int]:
        """Messages per topic so far, in all bags."""
        now = self._writer.counts if self._writer is not None else {}
        return {name: self.counts.get(name, 0) + now.get(name, 0) for name in self.counts | now}


class Held(NamedTuple):
    """A message in the ring. now_ns: when it arrived. stamp_ns: its own stamp."""

    now_ns: int
    stamp_ns: int
    topic: str
    data: bytes


@dataclass(slots=True)
class RingBuffer:
    """The last `seconds` of everything, at most `limit_bytes`; latched messages are kept however old they are.

    Age is measured from arrival: a wrong stamp must neither keep old messages nor drop the others.
    """

    seconds: float
    limit_bytes: int = 2_000_000_000
    held: deque[Held] = field(default_factory=deque)
    size: int = 0
    dropped: int = 0
    _latched: dict[str, bytes] = field(default_factory=dict)

    def add(self, topic: str, stamp_ns: int, data: bytes, now_ns: int) -> None:
        """now_ns: when it arrived; a jump of that clock by more than `seconds`, either way, drops what came before."""
        if topics.BY_NAME[topic].qos.latched:
            self._latched[topic] = data
            return
        self.held.append(Held(now_ns, stamp_ns, topic, data))
        self.size += len(data)
        while abs(now_ns - self.held[0].now_ns) * 1e-9 > self.seconds:
            self.size -= len(self.held.popleft().data)
        while self.size > self.limit_bytes:
            self.size -= len(self.held.popleft().data)
            self.dropped += 1

    def save(self, path: Path, provenance: dict[str, str]) -> int:
        """Write what is held to a new bag; returns the number of messages, 0 when there is nothing, and no bag."""
        # A recorder without other nodes still receives its own diagnostics.
        if all(held.topic == topics.DIAGNOSTICS for held in self.held):
            return 0
        with BagWriter(path, provenance) as bag:
            for topic, data in self._latched.items():
                bag.write_raw(topic, self.held[0].stamp_ns, data)
            for held in self.held:
                bag.write_raw(held.topic, held.stamp_ns, held.data)
            return sum(bag.counts.values())
