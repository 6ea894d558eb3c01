"""The vehicle's side of /control/command for bridges: wait for the command of a tick, or replace a missing one."""

from __future__ import annotations

import time
from collections.abc import Callable

from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node

from raw2drive_ros.contracts.public import Control, Decision
from raw2drive_ros.driving.command_policy import CommandPolicy
from raw2drive_ros.nodes.command_port import CommandPort
from raw2drive_ros.nodes.quality import LossCounter
from raw2drive_ros.tables.rates import DECISION_HZ
from raw2drive_ros.timing import load_timing

RESEND_AFTER_S = 1.0


class CommandWait:
    """lock_step: wait for the command with the tick's stamp. Otherwise use the newest one when the period is over.

    signed: see `CommandPort`.
    """

    def __init__(self, node: Node, losses: LossCounter, *, lock_step: bool, signed: bool = True) -> None:
        self.node, self.lock_step = node, lock_step
        self.timing = load_timing()
        self.policy = CommandPolicy(self.timing.command_hold_s, self.timing.command_brake)
        self.port = CommandPort(node, self.policy, losses, self._on_command, signed=signed)
        self.answer: tuple[int, Control] | None = None
        self.due = 0.0

    def begin(self) -> None:
        """Start an episode: no command is held, no stop stays, and the real-time schedule starts now."""
        self.port.receiver.place()
        self.answer = None
        self.due = time.perf_counter()

    def _on_command(self, decision: Decision) -> None:
        self.answer = decision.stamp_ns, decision.control

    def wait(
        self,
        stamp_ns: int,
        executor: SingleThreadedExecutor,
        resend: Callable[[], None],
        interrupted: Callable[[], bool] = lambda: False,
    ) -> Control:
        """The command for the tick of `stamp_ns`, or what `CommandPolicy` puts in its place.

        resend: publishes the tick again, for peers that had not discovered each other yet (lock-step). interrupted:
        True ends the wait early. A vehicle that has stopped by itself brakes; ticks go on at their real rate.
        """
        started = time.perf_counter()
        receiver = self.port.receiver
        receiver.ticks += 1
        # Also in lock-step where the vehicle has stopped: nobody's answer is waited for any more.
        follows = self.lock_step and not receiver.stopped
        if follows:
            deadline = started + self.timing.lock_step_timeout_s
        else:
            # A fixed schedule: the time that a tick takes to simulate is part of its period.
            self.due = max(self.due + 1.0 / DECISION_HZ, started)
            deadline = self.due
            executor.spin_once(timeout_sec=0.0)
        again = started + RESEND_AFTER_S
        while (left := deadline - time.perf_counter()) > 0:
            if receiver.stopped and follows:
                break
            if self.lock_step and self.answer is not None and self.answer[0] == stamp_ns and not receiver.stopped:
                self.policy.accept(self.answer[1], stamp_ns)
                return self.answer[1]
            executor.spin_once(timeout_sec=min(left, 0.05))
            if interrupted():
                break
            if follows and time.perf_counter() > again:
                again = time.perf_counter() + RESEND_AFTER_S
                resend()
        if receiver.stopped:
            return receiver.brake()
        newest = self.answer
        if not self.lock_step and newest is not None:
            age_s = (stamp_ns - newest[0]) * 1e-9
            if 0.0 <= age_s <= self.timing.command_hold_s:
                self.policy.accept(newest[1], newest[0])
                return newest[1]
        control = self.policy.missing(stamp_ns)
        self.node.get_logger().warning(
            f'no command at {stamp_ns * 1e-9:.1f} s: throttle {control.throttle:g}, brake {control.brake:g}, '
            f'steer {control.steer:g} instead',
            throttle_duration_sec=1.0,
        )
        return control
