"""Decisions to and from JointState messages with named actuators."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from msg_adapters.factory import MessageFactory
from msg_adapters.named_values import count, flag, named_values_from_message, named_values_to_message
from msg_adapters.stamps import stamp_ns
from raw2drive_ros.contracts.errors import ContractError
from raw2drive_ros.contracts.public import Control, Decision

ACTUATORS = ('throttle', 'brake', 'steer', 'reverse')
# Of a command: the gate's newest activation (`Gate.activation`).
ACTIVATION = 'activation'
SEQUENCE = 'sequence'
_FIELDS = (*ACTUATORS, 'action', 'inference_ms', SEQUENCE)


def decision_to_message(factory: MessageFactory, decision: Decision, extras: Mapping[str, float] | None = None) -> Any:
    """JointState with named actuators, action index and inference time (ms); its stamp is that of the input.

    extras: further named values. `sequence` is left out where the decision is not numbered.
    """
    control = decision.control
    values = {
        'throttle': control.throttle,
        'brake': control.brake,
        'steer': control.steer,
        'reverse': float(control.reverse),
        'action': float(decision.action),
        'inference_ms': decision.inference_ms,
    }
    if decision.sequence:
        values[SEQUENCE] = float(decision.sequence)
    return named_values_to_message(factory, values | dict(extras or {}), decision.stamp_ns)


def decision_from_message(message: Any) -> Decision:
    """Further named values are in `info`. Raises ContractError for missing actuators, values that are not finite, a
    reverse gear that is neither 0 nor 1, an action or a sequence number that is not whole; does NOT check the ranges of
    pedals and steering: that is the task of `Control.validate`.
    """
    values = named_values_from_message(message, *ACTUATORS)
    control = Control(values['throttle'], values['brake'], values['steer'], flag(values, 'reverse'))
    action = values.get('action', -1.0)
    if action != -1.0 and action != count(values, 'action'):
        raise ContractError(f'named values: action is {action:g}')
    return Decision(
        stamp_ns(message.header.stamp),
        control,
        int(action),
        values.get('inference_ms', 0.0),
        count(values, SEQUENCE),
        {name: value for name, value in values.items() if name not in _FIELDS},
    )
