"""The vehicle's status to and from a JointState with named values."""

from __future__ import annotations

from typing import Any

from msg_adapters.commands import ACTIVATION, SEQUENCE
from msg_adapters.factory import MessageFactory
from msg_adapters.named_values import count, flag, named_values_from_message, named_values_to_message
from msg_adapters.stamps import stamp_ns
from raw2drive_ros.contracts.public import VehicleStatus

SPEED, STOPPED, PLACED, TICKS = 'speed_mps', 'stopped', 'placed', 'ticks'


def status_to_message(factory: MessageFactory, status: VehicleStatus) -> Any:
    """JointState; `speed_mps` is left out where it is not known."""
    values = {} if status.speed_mps is None else {SPEED: status.speed_mps}
    values |= {
        STOPPED: float(status.stopped),
        ACTIVATION: float(status.activation),
        PLACED: float(status.placed),
        TICKS: float(status.ticks),
        SEQUENCE: float(status.sequence),
    }
    return named_values_to_message(factory, values, status.stamp_ns)


def status_from_message(message: Any) -> VehicleStatus:
    """Raises ContractError where `stopped` is missing or a value is not what `VehicleStatus` says."""
    values = named_values_from_message(message, STOPPED)
    return VehicleStatus(
        stamp_ns(message.header.stamp),
        values.get(SPEED),
        flag(values, STOPPED),
        count(values, ACTIVATION),
        count(values, PLACED),
        count(values, TICKS),
        count(values, SEQUENCE),
    ).validate()
