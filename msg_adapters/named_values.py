"""Stamped, named float64 values in a sensor_msgs/JointState (`name`, `position`): self-describing, and
readable by every stock tool without a message package of our own."""

from __future__ import annotations

from typing import Any

import numpy as np

from msg_adapters.factory import MessageFactory
from msg_adapters.stamps import set_stamp
from raw2drive_ros.contracts.errors import ContractError

# The longest message of ours, a transition with its reward terms, has about 20; a million would take a second to read.
MAX_VALUES = 256


def named_values_to_message(factory: MessageFactory, values: dict[str, float], time_ns: int, frame_id: str = '') -> Any:
    """JointState with one name and position per value; velocity and effort stay empty."""
    message = factory.new('sensor_msgs/msg/JointState')
    set_stamp(message.header.stamp, time_ns)
    message.header.frame_id = frame_id
    message.name = list(values)
    message.position = np.array(list(values.values()), np.float64)
    return message


def named_values_from_message(message: Any, *required: str) -> dict[str, float]:
    """All values by name.

    Raises ContractError where a required name is missing, a name occurs twice, a value is not finite, lengths differ,
    or there are more than MAX_VALUES.
    """
    names, positions = message.name, message.position
    if len(names) != len(positions):
        raise ContractError(f'named values: {len(names)} names but {len(positions)} positions')
    if len(names) > MAX_VALUES:
        raise ContractError(f'named values: {len(names)} of them, more than {MAX_VALUES}')
    values = {str(n): float(p) for n, p in zip(names, positions, strict=True)}
    if len(values) < len(names):
        twice = sorted({str(name) for name in names if list(names).count(name) > 1})
        raise ContractError(f'named values: {", ".join(twice)} more than once')
    wrong = [f'{name} is {value}' for name, value in values.items() if not np.isfinite(value)]
    if wrong:
        raise ContractError(f'named values: not finite: {", ".join(wrong)}')
    missing = [name for name in required if name not in values]
    if missing:
        raise ContractError(f'named values: missing {", ".join(missing)} (has {", ".join(values)})')
    return values


def flag(values: dict[str, float], name: str) -> bool:
    """A value that is 0 or 1. Raises ContractError for any other number: 0.7 is no more true than it is false."""
    if values[name] not in (0.0, 1.0):
        raise ContractError(f'named values: {name} is {values[name]:g}, not 0 or 1')
    return values[name] == 1.0


def count(values: dict[str, float], name: str) -> int:
    """A whole number from 0 to 2^53, the largest up to which float64 is exact; 0 where the name is absent."""
    value = values.get(name, 0.0)
    if not 0.0 <= value <= 2.0**53 or value != int(value):
        raise ContractError(f'named values: {name} is {value:g}, not a whole number from 0 on')
    return int(value)
