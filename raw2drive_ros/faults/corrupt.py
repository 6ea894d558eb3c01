"""Applies a fault to one message, in place; arrays are replaced, because those of a message may be read-only."""

from __future__ import annotations

from typing import Any

import numpy as np

from msg_adapters.commands import ACTUATORS
from msg_adapters.stamps import set_stamp, stamp_ns
from msg_adapters.vehicle_status import SPEED
from raw2drive_ros.faults.plan import Fault

VECTORS = {
    'sensor_msgs/msg/Imu': ('linear_acceleration', 'angular_velocity'),
    'nav_msgs/msg/Odometry': ('pose.pose.position', 'twist.twist.linear', 'twist.twist.angular'),
}


def corrupt(message: Any, msgtype: str, fault: Fault, count: int, rng: np.random.Generator) -> None:
    """count: messages that this fault has changed before. Kinds that only concern delivery change nothing here."""
    if fault.kind == 'stamp':
        # No message can hold a stamp before the epoch; the epoch itself is just as wrong.
        set_stamp(message.header.stamp, max(0, stamp_ns(message.header.stamp) + round(fault.strength * 1e9)))
    elif msgtype == 'sensor_msgs/msg/Image':
        _image(message, fault, rng)
    elif msgtype == 'sensor_msgs/msg/JointState':
        _command(message, fault, count)
    elif fault.kind in ('nan', 'scale', 'noise'):
        for name in VECTORS[msgtype]:
            _vector(message, name, fault, rng)


def _image(message: Any, fault: Fault, rng: np.random.Generator) -> None:
    if fault.kind in ('black', 'white'):
        message.data = np.full(len(message.data), 0 if fault.kind == 'black' else 255, np.uint8)
    elif fault.kind == 'noise':
        noisy = np.asarray(message.data, np.float32) + rng.normal(0.0, fault.strength, len(message.data))
        message.data = noisy.clip(0, 255).astype(np.uint8)
    elif fault.kind == 'shrink':
        message.height //= 2


def _command(message: Any, fault: Fault, count: int) -> None:
    """Actuators, or the speed of a status; not the number of the message, which a sender at fault counts on."""
    values, names = np.array(message.position, np.float64), list(message.name)
    measured = [names.index(name) for name in (*ACTUATORS, SPEED) if name in names]
    if fault.kind == 'nan':
        values[measured] = np.nan
    elif fault.kind == 'scale':
        values[measured] *= fault.strength
    elif 'steer' in names:
        steer = fault.strength * (-1.0) ** count if fault.kind == 'swing' else fault.strength
        values[names.index('steer')] = steer
    message.position = values


def _vector(message: Any, name: str, fault: Fault, rng: np.random.Generator) -> None:
    for part in name.split('.'):
        message = getattr(message, part)
    for axis in 'xyz':
        value = getattr(message, axis)
        if fault.kind == 'nan':
            value = float('nan')
        elif fault.kind == 'scale':
            value *= fault.strength
        else:
            value += float(rng.normal(0.0, fault.strength))
        setattr(message, axis, value)
