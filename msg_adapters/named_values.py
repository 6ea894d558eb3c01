"""Stamped, named float64 values in a sensor_msgs/JointState (`name`, `position`): self-describing, and
readable by every stock tool without a message package of our own."""

from __future__ import annotations

from typing import Any

import numpy as np

from msg_adapters.factory import MessageFactory
from msg_adapters.stamps import set_stamp
from raw2drive_ros.contracts.errors import ContractError


def named_values_to_message(factory: MessageFactory, values: dict[str, float], time_ns: int, frame_id: str = '') -> Any:
    """JointState with one name and position per value; velocity and effort stay empty."""
    message = factory.new('sensor_msgs/msg/JointState')
    set_stamp(message.header.stamp, time_ns)
    message.header.frame_id = frame_id
    message.name = list(values)
    message.position = np.array(list(values.values()), np.float64)
    return message


def named_values_from_message(message: Any, *required: str) -> dict[str, float]:
    """All values by name. Raises ContractError where a required name is missing or lengths differ."""
    if len(message.name) != len(message.position):
        raise ContractError(f'named values: {len(message.name)} names but {len(message.position)} positions')
    values = {str(n): float(p) for n, p in zip(message.name, message.position, strict=True)}
    missing = [name for name in required if name not in values]
    if missing:
        raise ContractError(f'named values: missing {", ".join(missing)} (has {", ".join(values)})')
    return values
