"""Where new messages come from: rclpy's generated classes, or rosbags' classes without any ROS."""

from __future__ import annotations

import array
import copy
import importlib
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
        self._prototypes: dict[str, Any] = {}

    def new(self, msgtype: str) -> Any:
        if msgtype not in self._prototypes:
            self._prototypes[msgtype] = self._zero(msgtype)
        return copy.deepcopy(self._prototypes[msgtype])

    def byte_buffer(self, size: int) -> Any:
        return np.zeros(size, np.uint8)

    def serialize(self, message: Any, msgtype: str) -> bytes:
        """CDR bytes of a message."""
        return bytes(self.typestore.serialize_cdr(message, msgtype))

    def deserialize(self, data: bytes, msgtype: str) -> Any:
        """A message from CDR bytes; its arrays are read-only views of `data`."""
        return self.typestore.deserialize_cdr(data, msgtype)

    def _zero(self, msgtype: str) -> Any:
        _, fields = self.typestore.fielddefs[msgtype]
        return self.typestore.types[msgtype](**{name: self._default(d) for name, d in fields})

    def _default(self, definition: Any) -> Any:
        node, detail = definition
        if node == Nodetype.BASE:
            return {'string': '', 'bool': False}.get(detail[0], 0.0 if detail[0].startswith('float') else 0)
        if node == Nodetype.NAME:
            return self._zero(detail)
        (inner_node, inner_detail), count = detail
        if inner_node == Nodetype.BASE and inner_detail[0] != 'string':
            return np.zeros(count if node == Nodetype.ARRAY else 0, np.dtype(_dtype(inner_detail[0])))
        return [self._default((inner_node, inner_detail)) for _ in range(count if node == Nodetype.ARRAY else 0)]


def _dtype(name: str) -> str:
    return {'octet': 'uint8', 'byte': 'uint8', 'char': 'uint8'}.get(name, name)


def fill_bytes(field: Any, source: NDArray[np.uint8]) -> None:
    """Copy `source` into a message's byte buffer in place (numpy speed, no setter involved)."""
    np.frombuffer(field, np.uint8)[:] = source.reshape(-1)
