"""From messages to the gate: the same for its ROS node and for drives under faults."""

from __future__ import annotations

from typing import Any

from msg_adapters.commands import decision_from_message
from msg_adapters.sensors import odometry_from_message
from raw2drive_ros.contract import Decision
from raw2drive_ros.driving.gate import Gate, Moment
from raw2drive_ros.errors import ContractError


def proposal(gate: Gate, message: Any, now: Moment) -> Decision:
    """The gate's answer to a proposal, under the proposal's stamp; one that is no command at all is refused."""
    try:
        decision = decision_from_message(message)
    except ContractError as error:
        return Decision(round(now.ros_s * 1e9), gate.refuse(f'invalid proposal: {error}', now))
    control = gate.propose(decision, now)
    return Decision(decision.stamp_ns, control, decision.action, decision.inference_ms)


def odometry(gate: Gate, message: Any, now: Moment) -> str:
    """Tell the gate the speed; returns why a message was not used, which then counts as silence."""
    try:
        gate.observe(odometry_from_message(message).speed_mps, now)
    except ContractError as error:
        return str(error)
    return ''
