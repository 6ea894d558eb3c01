"""A recording that survives a kill and can be split, and the ring buffer of snapshots; no ROS here."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

from raw2drive_ros.contracts import topics
from raw2drive_ros.recording.bag_writer import BagWriter, require_new
from raw2drive_ros.recording.first_tick import FirstTick
from raw2drive_ros.recording.time_lines import NEAR_NS, TimeLines

MAX_WAITING = 1000


class Message(NamedTuple):
    """received_ns: time of reception, system clock of the recorder's host; None: nobody received it."""

    topic: str
    stamp_ns: int
    data: bytes
    received_ns: int | None


@dataclass(slots=True)
class Recording:
    """Writes to the bag `path` or, if split, to complete bags `path/NAME_000`, `path/NAME_001` and so on.

    split_s, split_bytes: close a bag after this much; 0: never. When time goes back (see `TimeLines`) a new bag begins
    in any case: `path/NAME_001` and so on, also inside the folder of the bag `path`, which keeps its name. Each bag
    begins with the latched messages. Its provenance says which `part` it is, why it `began`, and with which tick of an
    episode it `begins`. `notes`: what the user should hear of that, taken away by whoever tells them.

    Latched messages, diagnostics and messages without a time (stamp of 0 or less) are held until the first other
    message sets the time base; a kill before that loses them. `untimed`: messages without a time by topic: they keep
    their stamp, and get the time of their neighbours in the bag.
    """

    path: Path
    provenance: dict[str, str]
    split_s: float = 0.0
    split_bytes: int = 0
    bags: list[Path] = field(default_factory=list)
    counts: dict[str, int] = field(default_factory=dict)
    largest_gap_ns: dict[str, int] = field(default_factory=dict)
    untimed: dict[str, int] = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)
    _writer: BagWriter | None = None
    _latched: dict[str, Message] = field(default_factory=dict)
    _waiting: list[Message] = field(default_factory=list)
    _newest_ns: int | None = None
    _lines: TimeLines[Message] = field(default_factory=TimeLines)
    _line: int = 0
    _first_tick: FirstTick = field(default_factory=FirstTick)

    def __post_init__(self) -> None:
        require_new(self.path)
        self._writer = self._open('')

    @property
    def splits(self) -> bool:
        return self.split_s > 0 or self.split_bytes > 0

    @property
    def went_back(self) -> list[str]:
        """Why each time line after the first began."""
        return self._lines.began

    @property
    def strays(self) -> dict[str, int]:
        """Messages by topic whose stamps went back while the others' did not; they are in the bag."""
        return self._lines.strays

    def write(self, topic: str, stamp_ns: int, data: bytes, received_ns: int | None = None) -> None:
        """Raises DiskFullError; what was written before stays."""
        self._write_all(self._lines.feed(topic, stamp_ns, Message(topic, stamp_ns, data, received_ns)))

    def _write_all(self, decided: list[tuple[int, Message]]) -> None:
        for line, message in decided:
            if line != self._line:
                self._line = line
                self._begin_line(self._lines.began[line - 1])
            self._write(message)

    def _write(self, message: Message) -> None:
        topic, stamp_ns = message.topic, message.stamp_ns
        latched = topics.BY_NAME[topic].qos.latched
        if latched or topic == topics.DIAGNOSTICS or stamp_ns <= 0:
            if stamp_ns <= 0 and not latched:
                self.untimed[topic] = self.untimed.get(topic, 0) + 1
            if self._newest_ns is None:
                self._wait(message)
                return
            stamp_ns = self._near(stamp_ns)
        else:
            self._newest_ns = stamp_ns
            self._write_waiting()
        if self._full(stamp_ns):
            self._split(stamp_ns)
        if latched:
            self._latched[topic] = message
        self._put(message, stamp_ns)

    def _put(self, message: Message, stamp_ns: int) -> None:
        writer, first = self._writer, self._first_tick
        assert writer is not None
        writer.write_raw(message.topic, stamp_ns, message.data, None, message.received_ns)
        if message.topic == topics.TRANSITION and first.hear(writer.factory, message.data) and first.late:
            # Already now, for a recorder that is killed.
            writer.note({'begins': first.text})
            self._say_first_tick()

    def _wait(self, message: Message) -> None:
        """Hold a message. A vehicle may appear hours later: latched ones are kept, others up to MAX_WAITING."""
        if topics.BY_NAME[message.topic].qos.latched:
            self._latched[message.topic] = message
            self._waiting = [held for held in self._waiting if held.topic != message.topic]
        elif len(self._waiting) >= MAX_WAITING:
            self._waiting.pop(
                next(i for i, held in enumerate(self._waiting) if not topics.BY_NAME[held.topic].qos.latched)
            )
        self._waiting.append(message)

    def _near(self, stamp_ns: int) -> int:
        if self._newest_ns is None:
            return max(0, stamp_ns)
        return stamp_ns if stamp_ns > 0 and abs(stamp_ns - self._newest_ns) <= NEAR_NS else self._newest_ns

    def _write_waiting(self) -> None:
        for message in self._waiting:
            self._put(message, self._near(message.stamp_ns))
        self._waiting.clear()

    def flush(self) -> None:
        """A kill of the process from here on loses nothing from before."""
        if self._writer is not None:
            self._write_all(self._lines.settle())
            self._writer.flush()

    def close(self) -> list[Path]:
        """Finish the last bag; returns every bag that was made."""
        if self._writer is not None:
            self._write_all(self._lines.finish())
            self._write_waiting()
            self._finish()
        return self.bags

    def _begin_line(self, why: str) -> None:
        self._finish()
        self._writer = self._open(why)
        self.notes.append(f'{why}: another drive begins, which goes to {self._writer.path}')
        # At the time of the first message: their stamps are of the time before.
        self._newest_ns = None
        self._waiting = [message._replace(stamp_ns=0) for message in self._latched.values()]

    def _split(self, stamp_ns: int) -> None:
        writer = self._writer
        assert writer is not None
        long = self.split_s > 0 and writer.first_ns is not None and (stamp_ns - writer.first_ns) * 1e-9 >= self.split_s
        self._finish()
        self._writer = self._open(f'split after {self.split_s:g} s' if long else 'split by size')
        for message in self._latched.values():
            self._put(message, stamp_ns)

    def _open(self, began: str) -> BagWriter:
        number = len(self.bags)
        whole = number == 0 and not self.splits
        path = self.path if whole else self.path / f'{self.path.name}_{number:03d}'
        metadata = self.provenance | ({} if whole else {'part': str(number)}) | ({'began': began} if began else {})
        path.parent.mkdir(parents=True, exist_ok=True)
        self._first_tick = FirstTick(expected=not began.startswith('split'))
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
        if self._first_tick.judge(writer.begins_ns):
            writer.note({'begins': self._first_tick.text})
            self._say_first_tick()
        self.bags.append(writer.close())
        for name, count in writer.counts.items():
            self.counts[name] = self.counts.get(name, 0) + count
            self.largest_gap_ns[name] = max(self.largest_gap_ns.get(name, 0), writer.largest_gap_ns[name])

    def _say_first_tick(self) -> None:
        said = self._first_tick.take_warning()
        if said:
            self.notes.append(said)

    @property
    def received(self) -> dict[str, int]:
        """Messages per topic so far, in all bags."""
        now = self._writer.counts if self._writer is not None else {}
        return {name: self.counts.get(name, 0) + now.get(name, 0) for name in self.counts | now}


class Held(NamedTuple):
    """A message in the ring. now_ns: when it arrived. stamp_ns: its own stamp. received_ns: see `Message`."""

    now_ns: int
    stamp_ns: int
    topic: str
    data: bytes
    received_ns: int | None = None


@dataclass(slots=True)
class RingBuffer:
    """The last `seconds` of everything, at most `limit_bytes`; latched messages are kept however old they are.

    Age is measured from arrival: a wrong stamp must neither keep old messages nor drop the others. A clock of arrival
    that is set back (a simulation that starts again) goes on from where it was: what came before grows old as usual.
    """

    seconds: float
    limit_bytes: int = 2_000_000_000
    held: deque[Held] = field(default_factory=deque)
    size: int = 0
    dropped: int = 0
    _latched: dict[str, Message] = field(default_factory=dict)
    _last_ns: int | None = None
    _set_back_ns: int = 0

    def add(self, topic: str, stamp_ns: int, data: bytes, now_ns: int, received_ns: int | None = None) -> None:
        """now_ns: when it arrived; a jump of that clock ahead by more than `seconds` drops what came before."""
        if topics.BY_NAME[topic].qos.latched:
            self._latched[topic] = Message(topic, stamp_ns, data, received_ns)
            return
        if self._last_ns is not None and now_ns < self._last_ns:
            self._set_back_ns += self._last_ns - now_ns
        self._last_ns = now_ns
        now_ns += self._set_back_ns
        self.held.append(Held(now_ns, stamp_ns, topic, data, received_ns))
        self.size += len(data)
        while (now_ns - self.held[0].now_ns) * 1e-9 > self.seconds:
            self.size -= len(self.held.popleft().data)
        while self.size > self.limit_bytes:
            self.size -= len(self.held.popleft().data)
            self.dropped += 1

    def save(self, path: Path, provenance: dict[str, str]) -> int:
        """Write what is held to a new bag; returns the number of messages, 0 when there is nothing, and no bag.

        Where time went back in between, the drives are bags of their own, as in a `Recording`.
        """
        # A recorder without other nodes still receives its own diagnostics.
        if all(held.topic == topics.DIAGNOSTICS for held in self.held):
            return 0
        recording = Recording(path, provenance)
        for message in self._latched.values():
            recording.write(message.topic, self.held[0].stamp_ns, message.data, message.received_ns)
        for held in self.held:
            recording.write(held.topic, held.stamp_ns, held.data, held.received_ns)
        recording.close()
        return sum(recording.counts.values())
