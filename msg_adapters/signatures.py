"""Signatures of JointState messages: HMAC-SHA256 (RFC 2104) over topic, session, stamp, names and values.

A signature is kept in `header.frame_id` as `SESSION.TAG`, both hexadecimal, because no common message has a field for
it and stock tools still show and plot the values. The topic in it is the table's name, so that a proposal cannot be
passed off as a command, and that remapping and namespaces do not matter.
"""

from __future__ import annotations

import hashlib
import hmac
import re
import struct
from typing import Any

import numpy as np

KEY_BYTES = 32
# 16 digits of the start time in microseconds, and 8 random ones for two processes of one microsecond.
SESSION_DIGITS = 24
# 128 bits: a forger has to guess online, at the rate of the wire.
TAG_DIGITS = 32
_SIGNATURE = re.compile(rf'([0-9a-f]{{{SESSION_DIGITS}}})\.([0-9a-f]{{{TAG_DIGITS}}})')


def sign(message: Any, topic: str, key: bytes, session: str) -> Any:
    """The message, now signed. session: SESSION_DIGITS hexadecimal digits of the process that sends it."""
    message.header.frame_id = f'{session}.{_tag(message, topic, key, session)}'
    return message


def session_of(message: Any) -> str:
    """Session that the message claims; '' where it is not signed."""
    matched = _SIGNATURE.fullmatch(str(message.header.frame_id))
    return matched[1] if matched else ''


def is_authentic(message: Any, topic: str, key: bytes) -> bool:
    """Whether the message was signed with this key for this topic, and not changed since."""
    matched = _SIGNATURE.fullmatch(str(message.header.frame_id))
    return matched is not None and hmac.compare_digest(matched[2], _tag(message, topic, key, matched[1]))


def _tag(message: Any, topic: str, key: bytes, session: str) -> str:
    digest = hmac.new(key, digestmod=hashlib.sha256)
    # Every text with its length, so that no two messages have the same bytes.
    for text in (topic, session, *message.name):
        data = str(text).encode('utf-8', 'surrogatepass')
        digest.update(struct.pack('<I', len(data)) + data)
    stamp = message.header.stamp
    digest.update(struct.pack('<iI', stamp.sec, stamp.nanosec))
    for values in (message.position, message.velocity, message.effort):
        digest.update(struct.pack('<I', len(values)) + np.asarray(values, '<f8').tobytes())
    return digest.hexdigest()[:TAG_DIGITS]
