"""Copies messages into a new bag, keeps account of every one that is left out, and checks what was written."""

from __future__ import annotations

import hashlib
from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from rosbags.interfaces import MessageDefinition, MessageDefinitionFormat, Nodetype
from rosbags.typesys import get_types_from_idl, get_types_from_msg

from raw2drive_ros.bounds import MAX_MESSAGE_BYTES, MAX_STRUCTURED_BYTES
from raw2drive_ros.contracts import topics
from raw2drive_ros.contracts.errors import BagError
from raw2drive_ros.recording.bag_reader import FLAT_TYPES, messages_in, open_bag, said
from raw2drive_ros.recording.bag_writer import BagWriter

# The longest definitions, with all types that they use, have 60 KB.
MAX_DEFINITION_BYTES = 2**17
# The library unrolls arrays of messages into code, element by element.
MAX_UNROLLED = 2000
MAX_DEPTH = 20
MASK = 2**128 - 1


@dataclass(slots=True)
class Account:
    """What became of the messages that were read.

    counts: messages written, per topic. topics: topics that were left out, with the reason. refused: messages that were
    left out, per topic and reason. undecoded: messages of types that nothing here decodes, per topic: they are copied
    and compared byte by byte.
    """

    counts: Counter[str] = field(default_factory=Counter)
    topics: dict[str, str] = field(default_factory=dict)
    refused: dict[str, Counter[str]] = field(default_factory=dict)
    undecoded: Counter[str] = field(default_factory=Counter)

    def refuse(self, topic: str, why: str) -> None:
        self.refused.setdefault(topic, Counter())[why] += 1

    def lines(self) -> list[str]:
        """One line for each topic that was left out, in whole or in part, and one for what was not decoded."""
        found = [f'left out {topic}: {why}' for topic, why in sorted(self.topics.items())]
        found += [
            f'left out {count} messages of {topic}: {why}'
            for topic, reasons in sorted(self.refused.items())
            for why, count in reasons.most_common()
        ]
        if self.undecoded:
            names = ', '.join(sorted(self.undecoded)[:4]) + (' ...' if len(self.undecoded) > 4 else '')
            found.append(f'{self.undecoded.total()} messages of unknown types were copied without decoding: {names}')
        return found


class Copier:
    """Writes messages with their types into `writer`, except those that cannot be decoded."""

    def __init__(self, writer: BagWriter, account: Account) -> None:
        self.writer = writer
        self.account = account
        self.types: dict[str, str] = {}
        self.typestore = writer.factory.typestore
        self.ours = frozenset(self.typestore.types)
        # Types that are never decoded, because the code for that would be too long.
        self.opaque: set[str] = set()
        # Sum of the hashes of all messages, which does not depend on their order.
        self.checksum = 0

    def write(
        self,
        topic: str,
        stamp_ns: int,
        data: bytes,
        msgtype: str,
        definition: MessageDefinition,
        received_ns: int | None = None,
    ) -> bool:
        """Copy one message; returns whether it was copied. What is left out is in `account`.

        received_ns: see `BagWriter.write_raw`.
        """
        if topic in self.account.topics:
            return False
        if not 0 <= stamp_ns < 2**63:
            self.account.refuse(topic, 'a time of recording that no bag can hold')
            return False
        known = self.types.get(topic)
        if known is None:
            why = self._register(msgtype, definition)
            if why:
                self.account.topics[topic] = why
                return False
            known = self.types[topic] = msgtype
        if known != msgtype:
            self.account.refuse(topic, f'{msgtype}, where the first ones are {known}')
            return False
        why = self._damage(topic, data, msgtype)
        if why:
            self.account.refuse(topic, why)
            return False
        self.writer.write_raw(topic, stamp_ns, data, (msgtype, ''), received_ns)
        self.account.counts[topic] += 1
        self.checksum = (self.checksum + _hash(topic, stamp_ns, data)) & MASK
        return True

    def _register(self, msgtype: str, definition: MessageDefinition) -> str:
        """Make the type known to the writer; returns why that is impossible, or ''."""
        if msgtype in self.typestore.types:
            return ''
        if definition.format == MessageDefinitionFormat.NONE or not definition.data:
            return f'{msgtype} is unknown, and the bag does not define it'
        if len(definition.data) > MAX_DEFINITION_BYTES:
            return f'a definition of {msgtype} of {len(definition.data)} bytes'
        try:
            if definition.format == MessageDefinitionFormat.IDL:
                self.typestore.register(get_types_from_idl(definition.data))
            else:
                self.typestore.register(get_types_from_msg(definition.data, msgtype))
            if _unrolled(self.typestore.fielddefs, msgtype, ()) > MAX_UNROLLED:
                self.opaque.add(msgtype)
            self.typestore.generate_msgdef(msgtype, ros_version=2)
            self.typestore.hash_rihs01(msgtype)
        except Exception as error:
            # A damaged definition raises all kinds of errors.
            self.typestore.types.pop(msgtype, None)
            return f'the definition of {msgtype} cannot be used: {said(error).splitlines()[0]}'
        return ''

    def _damage(self, topic: str, data: bytes, msgtype: str) -> str:
        """Why a message cannot be decoded, or ''."""
        if len(data) > MAX_MESSAGE_BYTES:
            return f'more than {MAX_MESSAGE_BYTES} bytes'
        large = len(data) > MAX_STRUCTURED_BYTES and msgtype not in FLAT_TYPES
        if large and topic in topics.BY_NAME:
            return f'more than {MAX_STRUCTURED_BYTES} bytes of {msgtype}'
        if large or msgtype in self.opaque:
            self.account.undecoded[topic] += 1
            return ''
        try:
            self.typestore.deserialize_cdr(data, msgtype)
        except Exception as error:
            # Bytes that are not of the type raise all kinds of errors.
            return f'cannot be decoded as {msgtype} ({type(error).__name__})'
        return ''


def _unrolled(definitions: Any, msgtype: str, inside: tuple[str, ...]) -> int:
    """Fields of a message type, those of its parts included. Raises ValueError for a type that holds itself."""
    if msgtype in inside or len(inside) > MAX_DEPTH:
        raise ValueError(f'{msgtype} holds itself, or is nested too deeply')
    total = 1
    for _, (node, detail) in definitions[msgtype][1]:
        count = 1
        if node in (Nodetype.ARRAY, Nodetype.SEQUENCE):
            (node, detail), length = detail
            count = length if node == Nodetype.NAME or detail[0] == 'string' else 1
        # A sequence, whose length is 0 here unless it has a limit, is a loop.
        total += max(1, count) * (_unrolled(definitions, detail, (*inside, msgtype)) if node == Nodetype.NAME else 1)
        if total > MAX_UNROLLED:
            break
    return total


def _hash(topic: str, stamp_ns: int, data: bytes) -> int:
    digest = hashlib.blake2b(data, digest_size=16, key=f'{topic}\0{stamp_ns}'.encode()[:64])
    return int.from_bytes(digest.digest(), 'little')


def verify(bag: Path, copier: Copier) -> None:
    """Read the bag again. Raises BagError unless it holds every message that was copied, and no other."""
    counts: Counter[str] = Counter()
    checksum = 0
    with open_bag(bag) as reader:
        for connection, stamp_ns, data in messages_in(reader, any_type=True):
            counts[connection.topic] += 1
            checksum = (checksum + _hash(connection.topic, stamp_ns, data)) & MASK
    if counts != copier.account.counts or checksum != copier.checksum:
        raise BagError(
            f'{bag}: {copier.account.counts.total()} messages were written, but reading it again gives '
            f'{counts.total()}, or others; is the disk sound?'
        )
