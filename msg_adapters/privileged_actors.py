"""`/privileged/actors`: a sensor_msgs/PointCloud2 with a point per actor, light and sign.

For training only: the planner cannot import it.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from msg_adapters.factory import MessageFactory, fill_bytes
from msg_adapters.sensors import BASE_FRAME
from msg_adapters.stamps import set_stamp
from raw2drive_ros.contracts.errors import ContractError
from raw2drive_ros.contracts.privileged import ACTOR_DTYPE, MAX_ACTORS, ActorRows, check_actors

# numpy's name of a type -> constant of sensor_msgs/PointField.
DATATYPES = {'int8': 1, 'uint8': 2, 'int16': 3, 'uint16': 4, 'int32': 5, 'uint32': 6, 'float32': 7, 'float64': 8}
MAX_FIELDS = 64
MAX_POINT_BYTES = 1024


def actor_fields(factory: MessageFactory) -> list[Any]:
    """The PointField messages that describe `ACTOR_DTYPE`; all clouds of a factory may share them."""
    found = []
    for name, (dtype, offset, *_) in (ACTOR_DTYPE.fields or {}).items():
        field = factory.new('sensor_msgs/msg/PointField')
        field.name, field.offset, field.datatype, field.count = name, int(offset), DATATYPES[dtype.name], 1
        found.append(field)
    return found


def actors_to_message(factory: MessageFactory, rows: ActorRows, time_ns: int, fields: list[Any] | None = None) -> Any:
    """(N,) rows of `ACTOR_DTYPE` as an unordered cloud of one row, in `base_link`. fields: of `actor_fields`."""
    message = factory.new('sensor_msgs/msg/PointCloud2')
    set_stamp(message.header.stamp, time_ns)
    message.header.frame_id = BASE_FRAME
    message.height, message.width = 1, len(rows)
    message.fields = actor_fields(factory) if fields is None else fields
    message.is_bigendian, message.is_dense = False, True
    message.point_step, message.row_step = ACTOR_DTYPE.itemsize, ACTOR_DTYPE.itemsize * len(rows)
    message.data = factory.byte_buffer(message.row_step)
    if len(rows):
        fill_bytes(message.data, np.ascontiguousarray(rows).view(np.uint8))
    return message


def actors_from_message(message: Any) -> ActorRows:
    """(N,) rows of `ACTOR_DTYPE`. Fields are found by name, wherever they are in a point; others are left out.

    Raises ContractError for another frame, for sizes that contradict each other, for missing fields or fields of
    another type, and for what `check_actors` refuses.
    """
    if message.header.frame_id != BASE_FRAME:
        raise ContractError(f'actors: frame {message.header.frame_id[:40]!r}, not {BASE_FRAME}')
    size, step = int(message.width), int(message.point_step)
    if message.height != 1 or message.is_bigendian:
        raise ContractError('actors: not one row of little-endian points')
    if size > MAX_ACTORS:
        raise ContractError(f'actors: {size} of them, more than {MAX_ACTORS}')
    data = np.frombuffer(message.data, np.uint8) if len(message.data) else np.zeros(0, np.uint8)
    if message.row_step != size * step or data.size != message.row_step:
        raise ContractError(f'actors: {data.size} bytes for {size} points of {step} bytes')
    layout = _layout(message.fields, step)
    rows = np.zeros(size, ACTOR_DTYPE)
    if size:
        points: NDArray[np.void] = data.view(layout)
        for name in ACTOR_DTYPE.names or ():
            rows[name] = points[name]
    return check_actors(rows)


def _layout(fields: Any, step: int) -> np.dtype[np.void]:
    """Where in a point of `step` bytes the fields of `ACTOR_DTYPE` are. Raises ContractError."""
    if len(fields) > MAX_FIELDS or not ACTOR_DTYPE.itemsize <= step <= MAX_POINT_BYTES:
        raise ContractError(f'actors: {len(fields)} fields in points of {step} bytes')
    found = {str(field.name): field for field in fields}
    if len(found) < len(fields):
        raise ContractError('actors: a field is there more than once')
    wanted: dict[str, Any] = dict(ACTOR_DTYPE.fields or {})
    if missing := [name for name in wanted if name not in found]:
        raise ContractError(f'actors: missing {", ".join(missing)}')
    for name, (dtype, *_) in wanted.items():
        field = found[name]
        if (field.datatype, field.count) != (DATATYPES[dtype.name], 1):
            raise ContractError(f'actors: {name} has type {field.datatype} x {field.count}, not {dtype.name}')
        if field.offset + dtype.itemsize > step:
            raise ContractError(f'actors: {name} lies beyond a point of {step} bytes')
    return np.dtype(
        {
            'names': list(wanted),
            'formats': [dtype for dtype, *_ in wanted.values()],
            'offsets': [int(found[name].offset) for name in wanted],
            'itemsize': step,
        }
    )
