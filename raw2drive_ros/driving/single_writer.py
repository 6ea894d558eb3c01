"""One writer per topic: numbers and signs what a node sends, and recognises whatever comes from anybody else.

ROS 2 delivers the messages of every publisher alike, discovery notices a second one late or never, and rclpy does not
say who sent a message. Therefore the message itself carries a session, a sequence number and a signature.
"""

from __future__ import annotations

import secrets
import time
from dataclasses import dataclass, field
from typing import Any

from msg_adapters import signatures
from msg_adapters.commands import SEQUENCE
from msg_adapters.named_values import MAX_VALUES


def new_session() -> str:
    """Identity of a process as a sender: its start in microseconds of the system clock, then random digits."""
    return f'{time.time_ns() // 1000:016x}{secrets.token_hex(4)}'


@dataclass(slots=True)
class Sender:
    """Numbers and signs the messages that a node sends to `topic` (a name of the topic table).

    key: None sends without signature, for receivers that do not ask for one and for drives within one process.
    """

    topic: str
    key: bytes | None = None
    session: str = field(default_factory=new_session)
    sequence: int = 0

    def next(self) -> int:
        """The sequence number of the next message."""
        self.sequence += 1
        return self.sequence

    def sign(self, message: Any) -> Any:
        """The message with its signature, where there is a key."""
        return message if self.key is None else signatures.sign(message, self.topic, self.key, self.session)


@dataclass(slots=True)
class SingleWriter:
    """Accepts the messages of one sender only: the first valid one since `release` decides whose.

    key: without one, nothing is authenticated: then a second sender is recognised by its sequence numbers, or because
    it says something else under the same stamp. foreign: messages refused so far.
    """

    topic: str
    key: bytes | None = None
    foreign: int = 0
    _session: str | None = None
    # Newest number by session: what was signed once must not be accepted twice, also not after a `release`.
    _numbers: dict[str, int] = field(default_factory=dict)
    _content: tuple[Any, ...] = ()

    @property
    def bound(self) -> bool:
        """Whether a sender has been accepted since the last `release`."""
        return self._session is not None

    def release(self) -> None:
        """Accept another sender from now on."""
        self._session, self._content = None, ()
        if self.key is None:
            # Without signatures all senders share one session, and a new one begins to count at 1.
            self._numbers.clear()

    def check(self, message: Any) -> str:
        """Why the message is not from the one sender, or ''."""
        reason = self._why_not(message)
        if reason:
            self.foreign += 1
        return reason

    def _why_not(self, message: Any) -> str:
        session = signatures.session_of(message)
        if self.key is not None:
            if not session or len(message.name) > MAX_VALUES:
                return 'not signed'
            if not signatures.is_authentic(message, self.topic, self.key):
                return 'its signature does not fit: another key, or changed on the way'
        if self._session is not None and session != self._session:
            return f'another sender ({_who(session)}) than the one so far ({_who(self._session)})'
        number = _number(message)
        if self.key is not None and number is None:
            return 'it has no sequence number'
        newest = self._numbers.get(session, 0)
        if number is not None and number <= newest:
            return f'sequence number {number} after {newest}: repeated, or out of order'
        if self.key is None and number is None:
            stamp = message.header.stamp
            content = (stamp.sec, stamp.nanosec, tuple(message.name), tuple(message.position))
            if self._content[:2] == content[:2] and str(self._content) != str(content):
                return 'it says something else under the same stamp: a second publisher?'
            self._content = content
        self._session = session
        if number is not None:
            self._numbers[session] = number
        return ''


def _number(message: Any) -> int | None:
    """The sequence number, None where there is none; values that are no numbers are left to the message's reader."""
    names = list(message.name)
    if SEQUENCE not in names or names.index(SEQUENCE) >= len(message.position):
        return None
    value = float(message.position[names.index(SEQUENCE)])
    return int(value) if abs(value) < 2.0**63 else None


def _who(session: str) -> str:
    return f'session {session[-8:]}' if session else 'unsigned'
