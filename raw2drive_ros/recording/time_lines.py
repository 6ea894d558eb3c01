"""Where time begins again in a stream of messages: a simulation reset, a bag in a loop, a system clock set back.

Recorder and readers decide it by the same class, `TimeLines`, message by message in the order of arrival.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass, field
from typing import Generic, TypeVar

from raw2drive_ros.contracts import topics

# A stamp this far behind the newest of its topic has gone back; as much as a planner takes for a jump of time.
BACK_NS = 500_000_000
# After so much of the new time it is decided whether all went back or one sensor only. Messages of the old time that
# are still on their way arrive meanwhile.
SETTLE_NS = 400_000_000
# One stamp so far ahead of its topic may be damaged; the second one moves the topic's time.
AHEAD_NS = 10_000_000_000
MAX_HELD = 1000
# Latched messages may have any stamp (of the boot, of a map file), and nodes without simulated time stamp diagnostics
# with the wall clock. Farther than this from the newest of the other messages, they get its stamp: a bag has one time
# base.
NEAR_NS = 5_000_000_000


def _sources() -> dict[str, str]:
    found = {topics.CLOCK: 'clock', topics.IMU: 'imu', topics.ODOMETRY: 'odometry'}
    for camera in topics.CAMERAS:
        for name in (topics.image_topic, topics.compressed_topic, topics.camera_info_topic):
            found[name(camera)] = 'cameras'
    return found | dict.fromkeys(topics.published_by(topics.Publisher.SIMULATION), 'simulation')


# Topics that tell the vehicle's time, by what measures it. Commands repeat stamps of others, latched messages and
# diagnostics have any stamp.
SOURCES = _sources()
_TYPES = {spec.msgtype for spec in topics.TOPICS}
_Item = TypeVar('_Item')


def stamp_of(msgtype: str, data: bytes) -> int | None:
    """The stamp in a message's CDR bytes, in ns; None for a type that is not in the topic table, or no stamp there."""
    if msgtype not in _TYPES or len(data) < 12:
        return None
    # After the 4-byte CDR header, whose second byte is odd for little endian, every type of the table starts with it.
    sec, nanosec = struct.unpack_from('<iI' if data[1] & 1 else '>iI', data, 4)
    return int(sec) * 1_000_000_000 + int(nanosec)


@dataclass(slots=True)
class TimeLines(Generic[_Item]):
    """Numbers the time lines of a stream: within one, the stamps of no topic that tells the time go back by BACK_NS.

    A new line begins when `/clock` goes back or, without it, more of the time's sources than go on as before. Until
    that is decided messages are held. `began`: why each line after the first began. `strays`: messages by topic whose
    stamps went back while time did not: they stay where they arrived.
    """

    line: int = 0
    began: list[str] = field(default_factory=list)
    strays: dict[str, int] = field(default_factory=dict)
    _newest: dict[str, int] = field(default_factory=dict)
    _ahead: set[str] = field(default_factory=set)
    _held: list[tuple[str, int | None, _Item]] = field(default_factory=list)
    _going_on: set[str] = field(default_factory=set)
    # The first topic that went back: its newest stamp before, and the stamp to which it went.
    _before_ns: int = 0
    _since_ns: int = 0

    def feed(self, topic: str, stamp_ns: int | None, item: _Item) -> list[tuple[int, _Item]]:
        """(line, item) of all that is decided now, in order. Stamps of 0 and less, and None, tell no time."""
        if stamp_ns is not None and stamp_ns <= 0:
            stamp_ns = None
        if not self._held:
            if stamp_ns is not None and self._is_back(topic, stamp_ns):
                self._held.append((topic, stamp_ns, item))
                self._going_on.clear()
                self._before_ns, self._since_ns = self._newest[topic], stamp_ns
                return []
            self._note(topic, stamp_ns)
            return [(self.line, item)]
        if stamp_ns is not None and self._is_of_the_held(topic, stamp_ns):
            self._held.append((topic, stamp_ns, item))
            return self._decide() if self._settled() else []
        return [*self._go_on(topic, stamp_ns), (self.line, item)]

    def settle(self) -> list[tuple[int, _Item]]:
        """Decide now, because nothing more may come, if a topic has gone on in the new time."""
        told = [topic for topic, *_ in self._held if topic in SOURCES]
        return self._decide() if len(told) > len(set(told)) else []

    def finish(self) -> list[tuple[int, _Item]]:
        """What is still held, at the end of the stream."""
        found = self.settle()
        while self._held:
            found += self._release({topic for topic, *_ in self._held})
        return found

    def _is_back(self, topic: str, stamp_ns: int) -> bool:
        return topic in SOURCES and stamp_ns < self._newest.get(topic, stamp_ns) - BACK_NS

    def _note(self, topic: str, stamp_ns: int | None) -> None:
        if topic not in SOURCES or stamp_ns is None:
            return
        newest = self._newest.get(topic, stamp_ns)
        if stamp_ns - newest > AHEAD_NS and topic not in self._ahead:
            self._ahead.add(topic)
            return
        self._ahead.discard(topic)
        self._newest[topic] = max(newest, stamp_ns)

    def _is_of_the_held(self, topic: str, stamp_ns: int) -> bool:
        if topic in self._newest and all(topic != name for name, *_ in self._held):
            return self._is_back(topic, stamp_ns)
        # It has gone back already, or has no time of its own: is it nearer to the held messages than to those before?
        return abs(stamp_ns - self._held_newest()) < abs(stamp_ns - self._before_ns)

    def _held_newest(self) -> int:
        return max(stamp for topic, stamp, _ in self._held if stamp is not None and topic in SOURCES)

    def _settled(self) -> bool:
        return self._held_newest() - self._since_ns >= SETTLE_NS or len(self._held) >= MAX_HELD

    def _go_on(self, topic: str, stamp_ns: int | None) -> list[tuple[int, _Item]]:
        """A message as before has come; what of its own topic was held is stray."""
        if topic not in SOURCES or stamp_ns is None:
            return []
        self._going_on.add(SOURCES[topic])
        self._note(topic, stamp_ns)
        return self._release({topic})

    def _release(self, names: set[str]) -> list[tuple[int, _Item]]:
        found = [item for topic, _, item in self._held if topic in names]
        for topic, _, _ in self._held:
            if topic in names and topic in SOURCES:
                self.strays[topic] = self.strays.get(topic, 0) + 1
        self._held = [held for held in self._held if held[0] not in names]
        if not any(topic in SOURCES for topic, *_ in self._held):
            found += [item for *_, item in self._held]
            self._held = []
        return [(self.line, item) for item in found]

    def _decide(self) -> list[tuple[int, _Item]]:
        back = {SOURCES[topic] for topic, *_ in self._held if topic in SOURCES}
        going_on = self._going_on - back
        held = self._held
        if 'clock' not in back and ('clock' in going_on or len(back) <= len(going_on)):
            # Their clock may stay back: they are measured by it from now on.
            self._newest |= {topic: stamp for topic, stamp, _ in held if topic in SOURCES and stamp is not None}
            return self._release({topic for topic, *_ in held})
        self.line += 1
        self.began.append(f'time went back by {(self._before_ns - self._since_ns) * 1e-9:.1f} s')
        self._newest, self._held = {}, []
        self._ahead.clear()
        found = []
        for topic, stamp, item in held:
            found += self.feed(topic, stamp, item)
        return found
