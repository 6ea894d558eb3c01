"""Decisions to and from JointState messages with named actuators."""

from __future__ import annotations

import math
from typing import Any

from msg_adapters.factory import MessageFactory
from msg_adapters.named_values import named_values_from_message, named_values_to_message
from msg_adapters.stamps import stamp_ns
from raw2drive_ros.contracts.public import Control, Decision

ACTUATORS = ('throttle', 'brake', 'steer', 'reverse')


def decision_to_message(factory: MessageFactory, decision: Decision) -> Any:
    """JointState with named actuators, action index and inference time (ms); its stamp is that of the input."""
    control = decision.control
    values = {
        'throttle': control.throttle,
        'brake': control.brake,
        'steer': control.steer,
        'reverse': float(control.reverse),
        'action': float(decision.action),
        'inference_ms': decision.inference_ms,
    }
    return named_values_to_message(factory, values, decision.stamp_ns)


def decision_from_message(message: Any) -> Decision:
    """Raises ContractError for missing actuators; does NOT check ranges: that is the gate's task."""
    values = named_values_from_message(message, *ACTUATORS)
    control = Control(values['throttle'], values['brake'], values['steer'], values['reverse'] > 0.5)
    action = values.get('action', -1.0)
    return Decision(
        stamp_ns(message.header.stamp),
        control,
        int(action) if math.isfinite(action) else -1,
        values.get('inference_ms', 0.0),
    )
