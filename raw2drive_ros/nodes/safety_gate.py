"""Safety gate: the last node before the vehicle, in a process of its own without torch; logic in `driving.gate`."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from std_srvs.srv import Trigger

from msg_adapters.commands import decision_to_message
from msg_adapters.diagnostics import ERROR, OK, WARN
from msg_adapters.factory import RclpyFactory
from raw2drive_ros.contracts import topics
from raw2drive_ros.contracts.public import Decision
from raw2drive_ros.driving import gate_inputs
from raw2drive_ros.driving.gate import STOPS, Gate, GateState, Moment
from raw2drive_ros.driving.gate_config import load_gate_config
from raw2drive_ros.nodes.diagnostics import DiagnosticsPublisher
from raw2drive_ros.nodes.parameters import declare
from raw2drive_ros.nodes.quality import LossCounter, make_publisher, make_subscription
from raw2drive_ros.nodes.runtime import StopRequest, run_node, spin, steady_clock
from raw2drive_ros.tables.rates import DIAGNOSTICS_HZ
from raw2drive_ros.timing import load_timing

STOP_AT_END_S = 8.0
REMIND_S = 10.0


class SafetyGateNode(Node):
    """`clock: steady` measures silence on the steady clock (a car), `clock: ros` on /clock (lock-step simulation).

    On Ctrl-C or SIGTERM while a real car moves, it first stops the car, for STOP_AT_END_S at most.
    """

    drains = True
    stop: StopRequest

    def __init__(self) -> None:
        super().__init__('safety_gate')
        p = declare(
            self,
            {
                'clock': ('steady', 'what silence is measured by: steady or ros'),
                'simulated': (False, 'offer ~/start_over to a simulation that puts the car elsewhere'),
                'config': ('', "limits and stops of this vehicle (default: params/gate.yaml, the simulated car's)"),
            },
        )
        if p['clock'] not in ('steady', 'ros'):
            raise ValueError(f'parameter clock is {p["clock"]!r}; use steady or ros')
        self.steady = p['clock'] == 'steady'
        timing = load_timing()
        config = load_gate_config(Path(p['config']) if p['config'] else None)
        self.make_gate = lambda: Gate(config.gate_limits(timing), config.motion_limits(), self.steady)
        self.gate = self.make_gate()
        limits = ', '.join(f'{name} {value:g}' for name, value in config.motion.model_dump().items())
        self.get_logger().info(f'{p["config"] or "shipped gate.yaml"}: {limits}')
        self.simulated = bool(p['simulated'])
        self.factory = RclpyFactory()
        self.losses = LossCounter()
        self.output = make_publisher(self, topics.COMMAND)
        self.logged: tuple[GateState | None, str] = (None, '')
        self.said_s = 0.0
        self.last_stamp_ns = 0
        make_subscription(self, topics.PROPOSED, self._on_proposal, self.losses)
        make_subscription(self, topics.ODOMETRY, self._on_odometry, self.losses)
        activate = self.create_service(Trigger, '~/activate', self._on_activate)
        domain = self.context.get_domain_id()
        call = f'raw2drive call {activate.service_name}' + (f' --domain {domain}' if domain else '')
        self.remedy = f'mend the cause, let the car stand, then: {call}'
        if p['simulated']:
            self.create_service(Trigger, '~/start_over', self._on_start_over)
        self.diagnostics = DiagnosticsPublisher(self, self._describe)
        steady = steady_clock()
        self.create_timer(1.0 / DIAGNOSTICS_HZ, self.diagnostics.publish, clock=steady)
        # On the steady clock: a paused simulation must not silence the gate.
        self.create_timer(1.0 / timing.gate_rate_hz, self._on_timer, clock=steady)

    def run(self, executor: SingleThreadedExecutor) -> None:
        spin(self, executor, until=lambda: self.stop.requested)
        if self.simulated or self.gate.state is GateState.WAITING:
            return
        self.gate.refuse('the gate was asked to end', self._now())
        deadline = time.monotonic() + STOP_AT_END_S
        while time.monotonic() < deadline and self.gate.moves:
            executor.spin_once(timeout_sec=0.05)

    def _now(self) -> Moment:
        return Moment(time.monotonic(), self.get_clock().now().nanoseconds * 1e-9)

    def _on_proposal(self, message: Any) -> None:
        answer = gate_inputs.proposal(self.gate, message, self._now())
        self.last_stamp_ns = answer.stamp_ns
        self._publish(answer)

    def _on_odometry(self, message: Any) -> None:
        refused = gate_inputs.odometry(self.gate, message, self._now())
        if refused:
            self.get_logger().error(f'odometry refused: {refused}', throttle_duration_sec=1.0)

    def _on_timer(self) -> None:
        now = self._now()
        self._look_around(now)
        # While driving, proposals are answered as they come. The timer checks for silence and, on a car, repeats.
        control = self.gate.tick(now)
        if self.gate.state is GateState.WAITING and not self.steady:
            # In lock-step the vehicle waits for the answer to its tick; the brake of WAITING must not pass for one.
            return
        if self.gate.state is not GateState.DRIVING:
            self._publish(Decision(self.get_clock().now().nanoseconds, control))
        elif self.steady:
            self._publish(Decision(self.last_stamp_ns, control))

    def _publish(self, answer: Decision) -> None:
        self.output.publish(decision_to_message(self.factory, answer))
        state, reason = self.gate.state, self.gate.reason
        if (state, reason) != self.logged:
            self.logged = (state, reason)
            if state is GateState.DRIVING:
                self.get_logger().info('driving: proposals pass')
            elif state is GateState.WAITING:
                self.get_logger().info(f'waiting: {reason}')
            else:
                self.get_logger().warning(f'{state.value}: {reason}')
            self.said_s = time.monotonic()
            self.diagnostics.publish()
        elif state in STOPS and time.monotonic() - self.said_s > REMIND_S:
            self.said_s = time.monotonic()
            self.get_logger().warning(f'still in {state.value}: {reason}; {self.remedy}')

    def _on_activate(self, request: Any, response: Any) -> Any:
        refusal = self.gate.activate()
        if not refusal:
            # Logged here: a waiting gate publishes nothing in lock-step. The next stop is logged again.
            self.logged = (self.gate.state, self.gate.reason)
            self.get_logger().info('re-activated')
        response.success, response.message = not refusal, refusal or self.gate.state.value
        return response

    def _on_start_over(self, request: Any, response: Any) -> Any:
        """A new episode, the car is elsewhere: neither the stop nor the speed of the last drive applies any more."""
        if self.gate.state in STOPS:
            self.get_logger().info('started over: the stop of the last drive ends with it')
            self.logged = (None, '')
        counts, self.gate = self.gate.counts, self.make_gate()
        self.gate.counts = counts
        self._look_around(self._now())
        response.success, response.message = True, self.gate.state.value
        return response

    def _look_around(self, now: Moment) -> None:
        self.gate.publisher_counts(self.count_publishers(topics.PROPOSED), self.count_publishers(topics.COMMAND), now)

    def _describe(self) -> tuple[int, str, dict[str, Any]]:
        level = {GateState.DRIVING: OK, GateState.WAITING: WARN}.get(self.gate.state, ERROR)
        values = {
            'state': self.gate.state.value,
            'speed_mps': 'unknown' if self.gate.speed_mps is None else round(self.gate.speed_mps, 2),
            'messages_lost': self.losses.total,
            **self.gate.counts,
        }
        if self.gate.state in STOPS:
            values['remedy'] = self.remedy
        state, reason = self.gate.state.value, self.gate.reason
        return level, f'{state}: {reason}' if reason else state, values


def main(args: list[str] | None = None) -> int:
    """Run the safety gate and return the exit code."""
    return run_node(SafetyGateNode, args)


if __name__ == '__main__':
    raise SystemExit(main())
