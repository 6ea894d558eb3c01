"""Where new messages come from: rclpy's generated classes, or rosbags' classes without any ROS."""

from __future__ import annotations

import array
import importlib
from collections.abc import Callable
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray
from rosbags.interfaces import Nodetype
from rosbags.typesys import Stores, get_typestore


class MessageFactory(Protocol):
    """Makes zero-initialised messages, and the kind of byte buffer that their setters take fastest."""

    def new(self, msgtype: str) -> Any:
        """A zero-initialised message of e.g. 'sensor_msgs/msg/Image'."""

    def byte_buffer(self, size: int) -> Any:
        """A writable uint8 buffer of `size` bytes that a message field takes without conversion."""


class RclpyFactory:
    """Messages of the running ROS installation."""

    def __init__(self) -> None:
        self._classes: dict[str, Any] = {}

    def new(self, msgtype: str) -> Any:
        if msgtype not in self._classes:
            package, kind, name = msgtype.split('/')
            self._classes[msgtype] = getattr(importlib.import_module(f'{package}.{kind}'), name)
        return self._classes[msgtype]()

    def byte_buffer(self, size: int) -> Any:
        # The only type that rclpy's setters take quickly whether or not field checks are on.
        return array.array('B', bytes(size))


class RosbagsFactory:
    """Messages of the rosbags library (ROS 2 Jazzy definitions); needs no ROS at all."""

    def __init__(self) -> None:
        self.typestore = get_typestore(Stores.ROS2_JAZZY)
        self._makers: dict[str, Callable[[], Any]] = {}

    def new(self, msgtype: str) -> Any:
        maker = self._makers.get(msgtype)
        if maker is None:
            maker = self._makers[msgtype] = self._maker(msgtype)
        return maker()

    def byte_buffer(self, size: int) -> Any:
        return np.zeros(size, np.uint8)

    def serialize(self, message: Any, msgtype: str) -> bytes:
        """CDR bytes of a message."""
        return bytes(self.typestore.serialize_cdr(message, msgtype))

    def deserialize(self, data: bytes, msgtype: str) -> Any:
        """A message from CDR bytes; its arrays are read-only views of `data`."""
        return self.typestore.deserialize_cdr(data, msgtype)

    def _maker(self, msgtype: str) -> Callable[[], Any]:
        """A function that makes messages of a type: six times as fast as copies of one message."""
        _, fields = self.typestore.fielddefs[msgtype]
        make, makers = self.typestore.types[msgtype], [self._default(definition) for _, definition in fields]
        return lambda: make(*[each() for each in makers])

    def _default(self, definition: Any) -> Callable[[], Any]:
        """A function that makes the zero value of a field."""
        node, detail = definition
        if node == Nodetype.BASE:
            zero = {'string': '', 'bool': False}.get(detail[0], 0.0 if detail[0].startswith('float') else 0)
            return lambda: zero
        if node == Nodetype.NAME:
            return self._maker(detail)
        (inner_node, inner_detail), count = detail
        length = count if node == Nodetype.ARRAY else 0
        if inner_node == Nodetype.BASE and inner_detail[0] != 'string':
            dtype = np.dtype(_dtype(inner_detail[0]))
            return lambda: np.zeros(length, dtype)
        inner = self._default((inner_node, inner_detail))
        return lambda: [inner() for _ in range(length)]


def _dtype(name: str) -> str:
    return {'octet': 'uint8', 'byte': 'uint8', 'char': 'uint8'}.get(name, name)


def fill_bytes(field: Any, source: NDArray[np.uint8]) -> None:
    """Copy `source` into a message's byte buffer in place (numpy speed, no setter involved)."""
    np.frombuffer(field, np.uint8)[:] = source.reshape(-1)
