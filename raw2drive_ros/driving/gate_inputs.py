"""Passes messages to the gate; shared by its ROS node and by drives under faults."""

from __future__ import annotations

from typing import Any

from msg_adapters.commands import decision_from_message
from msg_adapters.sensors import odometry_from_message
from raw2drive_ros.contracts.errors import ContractError
from raw2drive_ros.contracts.public import Decision
from raw2drive_ros.driving.gate import Gate, Moment


def proposal(gate: Gate, message: Any, now: Moment) -> Decision:
    """The gate's command for a proposal, under the proposal's stamp. A message without a command is refused."""
    try:
        decision = decision_from_message(message)
    except ContractError as error:
        return Decision(round(now.ros_s * 1e9), gate.refuse(f'invalid proposal: {error}', now))
    control = gate.propose(decision, now)
    return Decision(decision.stamp_ns, control, decision.action, decision.inference_ms)


def odometry(gate: Gate, message: Any, now: Moment) -> str:
    """Pass the speed to the gate; returns why a message was rejected, which then counts as missing, or ''."""
    try:
        gate.observe(odometry_from_message(message).speed_mps, now)
    except ContractError as error:
        return str(error)
    return ''
