"""Command adapter: converts /control/command to the message of another kind of vehicle.

It fulfils the vehicle's side of the contract: a command is held for `command_hold_s`, then braking is requested until
the next one; an invalid command is ignored. Times are measured on the steady clock.
"""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

from rclpy.node import Node

from msg_adapters.diagnostics import ERROR
from msg_adapters.factory import RclpyFactory
from msg_adapters.motion import CarFigures, motion_of, standstill
from msg_adapters.sensors import odometry_from_message
from msg_adapters.vehicle_commands import ADAPTERS
from raw2drive_ros.contracts import topics
from raw2drive_ros.contracts.errors import ContractError, NodeError
from raw2drive_ros.contracts.public import Decision
from raw2drive_ros.driving.command_policy import CommandPolicy
from raw2drive_ros.driving.gate_config import load_gate_config
from raw2drive_ros.nodes.command_port import CommandPort
from raw2drive_ros.nodes.diagnostics import DiagnosticsPublisher
from raw2drive_ros.nodes.parameters import declare
from raw2drive_ros.nodes.quality import LossCounter, expanded_name, make_subscription
from raw2drive_ros.nodes.runtime import run_node, steady_clock
from raw2drive_ros.tables.rates import DECISION_HZ, DIAGNOSTICS_HZ
from raw2drive_ros.timing import load_timing


class CommandAdapterNode(Node):
    """Publishes at the gate's rate whether or not commands arrive, and at once when one does."""

    def __init__(self) -> None:
        super().__init__('command_adapter')
        p = declare(
            self,
            {
                'output': ('twist', f'what the vehicle takes: {", ".join(ADAPTERS)}'),
                'topic': ('', 'where it listens (default: the usual topic of such vehicles)'),
                'config': ('', "the car's figures, as for the safety gate (default: params/gate.yaml)"),
                'signed_commands': (True, 'false: obey a gate that cannot sign its commands'),
                'horizon_s': (0.5, 'how far ahead a speed is asked for: about the time its speed controller takes'),
            },
        )
        if p['output'] not in ADAPTERS:
            raise NodeError(f'parameter output is {p["output"]!r}; use one of {", ".join(ADAPTERS)}')
        if not 0.0 < p['horizon_s'] <= 5.0:
            raise NodeError(f'parameter horizon_s is {p["horizon_s"]}; use 0 to 5 s')
        self.adapter, self.horizon_s = ADAPTERS[p['output']], float(p['horizon_s'])
        self.factory = RclpyFactory()
        try:
            message = self.factory.new(self.adapter.msgtype)
        except ImportError as error:
            package = self.adapter.msgtype.split('/')[0]
            raise NodeError(f'output {p["output"]} needs the ROS package {package}: install and source it') from error
        motion = load_gate_config(Path(p['config']) if p['config'] else None).motion
        self.car = CarFigures(
            motion.wheelbase_m, motion.max_steer_rad, motion.full_throttle_mps2, motion.full_brake_mps2
        )
        timing = load_timing()
        self.speed_good_ns = round(timing.odometry_after_s * 1e9)
        self.policy = CommandPolicy(timing.command_hold_s, timing.command_brake)
        self.speed_mps, self.speed_ns = 0.0, -self.speed_good_ns - 1
        self.trouble = ''
        self.losses = LossCounter()
        topic = p['topic'] or expanded_name(self, self.adapter.topic)
        self.output = self.create_publisher(type(message), topic, 1)
        self.port = CommandPort(self, self.policy, self.losses, self._on_command, signed=bool(p['signed_commands']))
        make_subscription(self, topics.ODOMETRY, self._on_odometry, self.losses)
        self.diagnostics = DiagnosticsPublisher(self, self._describe)
        steady = steady_clock()
        self.create_timer(1.0 / DIAGNOSTICS_HZ, self.diagnostics.publish, clock=steady)
        self.create_timer(1.0 / timing.gate_rate_hz, self._publish, clock=steady)
        # The speed is the odometry's, which is another node's to tell.
        self.create_timer(1.0 / DECISION_HZ, self._report, clock=steady)
        self.get_logger().info(f'{topics.COMMAND} as {self.adapter.msgtype} on {topic}')

    def _on_command(self, decision: Decision) -> None:
        self.policy.accept(decision.control, time.monotonic_ns())
        self._publish()

    def _on_odometry(self, message: Any) -> None:
        try:
            self.speed_mps = odometry_from_message(message).speed_mps
        except ContractError as error:
            self.get_logger().error(f'odometry refused: {error}', throttle_duration_sec=1.0)
            return
        self.speed_ns = time.monotonic_ns()

    def _publish(self) -> None:
        now_ns = time.monotonic_ns()
        stopped = bool(self.port.receiver.stopped)
        fresh = self.policy.last is not None and not self.policy.expired(now_ns) and not stopped
        if stopped:
            control = self.port.receiver.brake()
        else:
            control = self.policy.last if fresh and self.policy.last is not None else self.policy.missing(now_ns)
        known = now_ns - self.speed_ns <= self.speed_good_ns
        if known:
            motion = motion_of(control, self.speed_mps, self.car, self.horizon_s)
        else:
            motion = standstill(control, self.car, self.speed_mps)
        trouble = 'stopped: braking' if stopped else 'no command: braking' if not fresh else ''
        self._say(trouble or ('' if known else 'no odometry: asking for a standstill'))
        stamp_ns = self.get_clock().now().nanoseconds
        self.output.publish(self.adapter.make(self.factory, control, motion, stamp_ns))

    def _report(self) -> None:
        self.port.report(self.get_clock().now().nanoseconds, None)

    def _say(self, trouble: str) -> None:
        if trouble != self.trouble:
            self.trouble = trouble
            self.get_logger().warning(trouble or 'passing commands on')

    def _describe(self) -> tuple[int, str, dict[str, Any]]:
        level, text, values = self.port.describe()
        if self.trouble:
            level = ERROR
        values = {'output': self.adapter.msgtype, **values, 'messages_lost': self.losses.total}
        return level, text or self.trouble or 'passing commands on', values


def main(args: list[str] | None = None) -> int:
    """Run the command adapter and return the exit code."""
    return run_node(CommandAdapterNode, args)


if __name__ == '__main__':
    raise SystemExit(main())
