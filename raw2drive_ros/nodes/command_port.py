"""The vehicle's end of `/control/command` as part of a node: subscription, checks, and the report to the gate."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from rclpy.node import Node

from msg_adapters.diagnostics import ERROR, OK, WARN
from msg_adapters.factory import RclpyFactory
from msg_adapters.vehicle_status import status_to_message
from raw2drive_ros.contracts import topics
from raw2drive_ros.contracts.public import Decision
from raw2drive_ros.driving.command_policy import CommandPolicy
from raw2drive_ros.driving.command_receiver import REMEDY, CommandReceiver
from raw2drive_ros.driving.single_writer import Sender
from raw2drive_ros.nodes.keys import load_key
from raw2drive_ros.nodes.quality import LossCounter, make_publisher, make_subscription

UNSIGNED = 'commands are not authenticated: whoever publishes in this ROS domain drives this vehicle'


class CommandPort:
    """Passes every valid command to `on_command`; `receiver` says whether the vehicle has stopped by itself.

    signed: False obeys a gate that cannot sign, and says so in the log and in the diagnostics. Raises KeyFileError.
    """

    def __init__(
        self,
        node: Node,
        policy: CommandPolicy,
        losses: LossCounter,
        on_command: Callable[[Decision], None],
        *,
        signed: bool = True,
    ) -> None:
        key = load_key(node.context.get_domain_id()) if signed else None
        self.node, self.on_command, self.signed = node, on_command, signed
        self.receiver = CommandReceiver(policy, key)
        self.sender = Sender(topics.STATUS, key)
        self.factory = RclpyFactory()
        self.output = make_publisher(node, topics.STATUS)
        self.topic_name = make_subscription(node, topics.COMMAND, self._receive, losses).topic_name
        if not signed:
            node.get_logger().warning(UNSIGNED)

    def _receive(self, message: Any) -> None:
        stopped = self.receiver.stopped
        decision = self.receiver.receive(message)
        if self.receiver.stopped and not stopped:
            self.node.get_logger().error(f'stopped: {self.receiver.stopped}; publishers: {self._who()}; {REMEDY}')
        elif stopped and not self.receiver.stopped:
            self.node.get_logger().info('the gate was activated: its commands are obeyed again')
        if decision is not None:
            self.on_command(decision)

    def _who(self) -> str:
        """Nodes that discovery knows as publishers of commands; a stranger may be missing for a moment."""
        found = self.node.get_publishers_info_by_topic(self.topic_name)
        return ', '.join(sorted(f'{each.node_namespace.rstrip("/")}/{each.node_name}' for each in found)) or 'none'

    def report(self, stamp_ns: int, speed_mps: float | None) -> None:
        """Publish the status; speed_mps: as measured at `stamp_ns`, None where this node does not measure it."""
        status = self.receiver.status(stamp_ns, speed_mps, self.sender.next())
        self.output.publish(self.sender.sign(status_to_message(self.factory, status)))

    def describe(self) -> tuple[int, str, dict[str, Any]]:
        """(level, text or '', values) for the diagnostics of the vehicle's node."""
        receiver = self.receiver
        values: dict[str, Any] = {
            'commands_missed': receiver.policy.missed,
            'commands_refused': receiver.refused,
            'commands_signed': self.signed,
        }
        if receiver.stopped:
            values |= {'publishers': self._who(), 'remedy': REMEDY}
            return ERROR, f'stopped: {receiver.stopped}', values
        if not self.signed:
            return WARN, UNSIGNED, values
        return (WARN if receiver.policy.missed or receiver.refused else OK), '', values
