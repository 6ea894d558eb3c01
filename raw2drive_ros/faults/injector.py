"""Applies faults between a publisher and its subscribers: CDR bytes in; the same, others or none out, now or later."""

from __future__ import annotations

import zlib
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from msg_adapters.commands import SEQUENCE
from msg_adapters.factory import RosbagsFactory
from msg_adapters.signatures import session_of, sign
from msg_adapters.stamps import set_stamp, stamp_ns
from raw2drive_ros.contracts import topics
from raw2drive_ros.faults.corrupt import corrupt
from raw2drive_ros.faults.plan import Fault


@dataclass(slots=True)
class Injector:
    """faults: of one plan. The same seed and messages give the same faults, for each topic on its own.

    counts: messages affected, by `kind topic`. key: of the signatures: a fault of a sender is signed by that sender,
    so what is corrupted is signed anew; None where nothing is signed.
    """

    faults: list[Fault]
    seed: int = 0
    counts: dict[str, int] = field(default_factory=dict)
    start_ns: int | None = None
    key: bytes | None = None
    _factory: RosbagsFactory = field(default_factory=RosbagsFactory)
    _held: dict[tuple[int, str], bytes] = field(default_factory=dict)
    _rngs: dict[tuple[int, str], np.random.Generator] = field(default_factory=dict)

    def start(self, now_ns: int) -> None:
        """A drive begins: times of the plan count from here."""
        self.start_ns = now_ns
        self.counts.clear()
        self._held.clear()
        self._rngs.clear()

    def now(self, now_ns: int) -> list[str]:
        """`kind topic` of the faults that are active at `now_ns`."""
        if self.start_ns is None:
            return []
        since_s = (now_ns - self.start_ns) * 1e-9
        return [f'{fault.kind} {fault.topic}' for fault in self.faults if fault.holds_at(since_s)]

    def take(self, topic: str, msgtype: str, data: bytes, now_ns: int) -> list[tuple[int, bytes]]:
        """(due time in ns, bytes) of everything to deliver for this message."""
        if self.start_ns is None:
            self.start_ns = now_ns
        since_s = (now_ns - self.start_ns) * 1e-9
        out = [(now_ns, data)]
        for index, fault in enumerate(self.faults):
            if fault.holds(topic, since_s):
                out = [changed for item in out for changed in self._apply(index, fault, topic, msgtype, item)]
            elif fault.kind == 'freeze' and since_s < fault.start_s:
                self._held[index, topic] = data
        return out

    def _apply(
        self, index: int, fault: Fault, topic: str, msgtype: str, item: tuple[int, bytes]
    ) -> list[tuple[int, bytes]]:
        due_ns, data = item
        key = (index, topic)
        # Not `hash`, which Python salts anew in every process.
        rng = self._rngs.setdefault(key, np.random.default_rng([self.seed, index, zlib.crc32(topic.encode())]))
        if fault.kind == 'drop' and rng.random() >= fault.strength:
            return [item]
        name = f'{fault.kind} {topic}'
        before = self.counts.get(name, 0)
        self.counts[name] = before + 1
        if fault.kind == 'drop':
            return []
        if fault.kind == 'delay':
            return [(due_ns + round(fault.strength * 1e9), data)]
        if fault.kind == 'duplicate':
            return [item, item]
        message = self._factory.deserialize(data, msgtype)
        if fault.kind == 'freeze':
            held = self._factory.deserialize(self._held.setdefault(key, data), msgtype)
            set_stamp(held.header.stamp, stamp_ns(message.header.stamp))
            if topic in topics.SIGNED:
                _number_as(message, held)
            message = held
        else:
            corrupt(message, msgtype, fault, before, rng)
        if self.key is not None and topic in topics.SIGNED and (session := session_of(message)):
            sign(message, topic, self.key, session)
        return [(due_ns, self._factory.serialize(message, msgtype))]


def _number_as(message: Any, held: Any) -> None:
    """Give a held message the number of the one in whose place it is sent: a frozen sender counts on."""
    if SEQUENCE in message.name and SEQUENCE in held.name:
        position = np.array(held.position)
        position[list(held.name).index(SEQUENCE)] = message.position[list(message.name).index(SEQUENCE)]
        held.position = position
