"""Passes messages to the gate; shared by its ROS node and by drives under faults."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

from msg_adapters.commands import decision_from_message
from msg_adapters.sensors import odometry_from_message
from msg_adapters.vehicle_status import status_from_message
from raw2drive_ros.contracts import topics
from raw2drive_ros.contracts.errors import ContractError
from raw2drive_ros.contracts.public import Decision
from raw2drive_ros.driving.gate import Gate
from raw2drive_ros.driving.gate_state import STOPS, GateState, Moment
from raw2drive_ros.driving.single_writer import SingleWriter


@dataclass(slots=True)
class GateInputs:
    """Checks who sent a message, reads it, and passes it to `gate`.

    key: of the signatures; None takes unsigned messages, as within one process. signed_proposals: False takes a planner
    that cannot sign.
    """

    gate: Gate
    key: bytes | None = None
    signed_proposals: bool = True
    proposals: SingleWriter = field(init=False)
    statuses: SingleWriter = field(init=False)

    def __post_init__(self) -> None:
        self.proposals = SingleWriter(topics.PROPOSED, self.key if self.signed_proposals else None)
        self.statuses = SingleWriter(topics.STATUS, self.key)

    def proposal(self, message: Any, now: Moment) -> Decision:
        """The gate's command for a proposal, under the proposal's stamp. A message without a command is refused.

        A drive has one sender from its first proposal on. Before and after, the planner may become another process.
        """
        gate = self.gate
        if gate.state is not GateState.DRIVING:
            self.proposals.release()
        why = self.proposals.check(message)
        if why and gate.state in STOPS:
            # Nothing is passed on anyway, and the reason of the stop stays.
            gate.count('foreign_proposals')
            return Decision(round(now.ros_s * 1e9), gate.tick(now))
        try:
            if why:
                raise ContractError(why)
            decision = decision_from_message(message)
        except ContractError as error:
            return Decision(round(now.ros_s * 1e9), gate.refuse(f'invalid proposal: {error}', now))
        control = gate.propose(decision, now)
        return Decision(decision.stamp_ns, control, decision.action, decision.inference_ms)

    def odometry(self, message: Any, now: Moment) -> str:
        """Pass the speed on; returns why a message was rejected, which then counts as missing, or ''."""
        try:
            sample = odometry_from_message(message)
        except ContractError as error:
            return str(error)
        self.gate.observe(sample.speed_mps, now, sample.stamp_ns * 1e-9)
        return ''

    def status(self, message: Any, now: Moment) -> str:
        """Pass the vehicle's status on; returns why a message was rejected, or ''. A foreign one stops the car."""
        why = self.statuses.check(message)
        try:
            if why:
                raise ContractError(why)
            status = status_from_message(message)
        except ContractError as error:
            self.gate.refuse(f'invalid vehicle status: {error}', now)
            # The vehicle's process may have been started again.
            self.statuses.release()
            return str(error)
        self.gate.vehicle(status, now)
        return ''
