"""Command adapter: converts /control/command to the message of another kind of vehicle.

It fulfils the vehicle's side of the contract: a command is held for `command_hold_s`, then braking is requested until
the next one; an invalid command is ignored. Times are measured on the steady clock.
"""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

from rclpy.node import Node

from msg_adapters.commands import decision_from_message
from msg_adapters.diagnostics import ERROR, OK, WARN
from msg_adapters.factory import RclpyFactory
from msg_adapters.motion import CarFigures, motion_of, standstill
from msg_adapters.sensors import odometry_from_message
from msg_adapters.vehicle_commands import ADAPTERS
from raw2drive_ros.contracts import topics
from raw2drive_ros.contracts.errors import ContractError, NodeError
from raw2drive_ros.driving.command_policy import CommandPolicy
from raw2drive_ros.driving.gate_config import load_gate_config
from raw2drive_ros.nodes.diagnostics import DiagnosticsPublisher
from raw2drive_ros.nodes.parameters import declare
from raw2drive_ros.nodes.quality import LossCounter, make_subscription
from raw2drive_ros.nodes.runtime import run_node, steady_clock
from raw2drive_ros.tables.rates import DIAGNOSTICS_HZ
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
        self.refused, self.trouble = 0, ''
        self.losses = LossCounter()
        topic = p['topic'] or self.adapter.topic
        self.output = self.create_publisher(type(message), topic, 1)
        make_subscription(self, topics.COMMAND, self._on_command, self.losses)
        make_subscription(self, topics.ODOMETRY, self._on_odometry, self.losses)
        self.diagnostics = DiagnosticsPublisher(self, self._describe)
        steady = steady_clock()
        self.create_timer(1.0 / DIAGNOSTICS_HZ, self.diagnostics.publish, clock=steady)
        self.create_timer(1.0 / timing.gate_rate_hz, self._publish, clock=steady)
        self.get_logger().info(f'{topics.COMMAND} as {self.adapter.msgtype} on {topic}')

    def _on_command(self, message: Any) -> None:
        try:
            control = decision_from_message(message).control.validate()
        except ContractError as error:
            self.refused += 1
            self.get_logger().error(f'command refused: {error}', throttle_duration_sec=1.0)
            return
        self.policy.accept(control, time.monotonic_ns())
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
        fresh = self.policy.last is not None and not self.policy.expired(now_ns)
        control = self.policy.last if fresh and self.policy.last is not None else self.policy.missing(now_ns)
        known = now_ns - self.speed_ns <= self.speed_good_ns
        if known:
            motion = motion_of(control, self.speed_mps, self.car, self.horizon_s)
        else:
            motion = standstill(control, self.car, self.speed_mps)
        self._say('' if fresh and known else 'no odometry: asking for a standstill' if fresh else 'no command: braking')
        stamp_ns = self.get_clock().now().nanoseconds
        self.output.publish(self.adapter.make(self.factory, control, motion, stamp_ns))

    def _say(self, trouble: str) -> None:
        if trouble != self.trouble:
            self.trouble = trouble
            self.get_logger().warning(trouble or 'passing commands on')

    def _describe(self) -> tuple[int, str, dict[str, Any]]:
        level = ERROR if self.trouble else WARN if self.refused else OK
        values = {
            'output': self.adapter.msgtype,
            'commands_missed': self.policy.missed,
            'commands_refused': self.refused,
            'messages_lost': self.losses.total,
        }
        return level, self.trouble or 'passing commands on', values


def main(args: list[str] | None = None) -> int:
    """Run the command adapter and return the exit code."""
    return run_node(CommandAdapterNode, args)


if __name__ == '__main__':
    raise SystemExit(main())
