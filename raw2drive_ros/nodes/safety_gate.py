"""Safety gate: the last node before the vehicle, in a process of its own without torch; logic in `driving.gate`."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from std_srvs.srv import Trigger

from msg_adapters.commands import ACTIVATION, decision_to_message
from msg_adapters.diagnostics import ERROR, OK, WARN
from msg_adapters.factory import RclpyFactory
from raw2drive_ros.contracts import topics
from raw2drive_ros.contracts.public import Decision
from raw2drive_ros.driving.gate import Gate
from raw2drive_ros.driving.gate_config import load_gate_config
from raw2drive_ros.driving.gate_inputs import GateInputs
from raw2drive_ros.driving.gate_state import STOPS, GateState, Moment
from raw2drive_ros.driving.single_writer import Sender
from raw2drive_ros.nodes.diagnostics import DiagnosticsPublisher
from raw2drive_ros.nodes.keys import load_key
from raw2drive_ros.nodes.latch_file import LatchFile
from raw2drive_ros.nodes.parameters import declare, wants_best_effort
from raw2drive_ros.nodes.quality import LossCounter, make_publisher, make_subscription
from raw2drive_ros.nodes.runtime import StopRequest, run_node, spin, steady_clock
from raw2drive_ros.tables.rates import DIAGNOSTICS_HZ
from raw2drive_ros.timing import load_timing

STOP_AT_END_S = 8.0
REMIND_S = 10.0
ASKED_TO_END = 'the gate was asked to end'
ENDED_DRIVING = 'the gate before this one ended while it was driving'
# What the publishers of a topic publish, in the plural.
KINDS = {
    topics.STATUS: "the vehicle's status",
    topics.ODOMETRY: 'odometry',
    topics.CLOCK: 'the clock',
    topics.AUTONOMY: 'the autonomy mode',
    topics.PROPOSED: 'proposals',
}


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
                'signed_proposals': (True, 'false: take the proposals of a planner that cannot sign them'),
                'sensor_reliability': ('reliable', 'QoS of odometry: reliable or best_effort'),
            },
        )
        if p['clock'] not in ('steady', 'ros'):
            raise ValueError(f'parameter clock is {p["clock"]!r}; use steady or ros')
        self.steady = p['clock'] == 'steady'
        timing = load_timing()
        config = load_gate_config(Path(p['config']) if p['config'] else None)
        self.simulated = bool(p['simulated'])
        self.gate = Gate(config.gate_limits(timing), config.motion_limits(), self.steady, self.simulated)
        limits = ', '.join(f'{name} {value:g}' for name, value in config.motion.model_dump().items())
        self.get_logger().info(f'{p["config"] or "shipped gate.yaml"}: {limits}')
        key = load_key(self.context.get_domain_id())
        self.sender = Sender(topics.COMMAND, key)
        self.inputs = GateInputs(self.gate, key, signed_proposals=bool(p['signed_proposals']))
        if not p['signed_proposals']:
            self.get_logger().warning(
                'proposals are not authenticated: whoever publishes them steers, within the limits'
            )
        self.factory = RclpyFactory()
        self.losses = LossCounter()
        self.output = make_publisher(self, topics.COMMAND)
        self.logged: tuple[GateState | None, str] = (None, '')
        self.said_s = 0.0
        self.last_stamp_ns = 0
        self._listen(best_effort=wants_best_effort(p['sensor_reliability']))
        activate = self.create_service(Trigger, '~/activate', self._on_activate)
        domain = self.context.get_domain_id()
        call = f'raw2drive call {activate.service_name}' + (f' --domain {domain}' if domain else '')
        self.remedy = f'mend the cause, let the car stand, then: {call}'
        if self.simulated:
            self.create_service(Trigger, '~/start_over', self._on_start_over)
        # A simulation's car is put elsewhere for the next drive; a real one is where it stood when the gate ended.
        self.latch = None if self.simulated else LatchFile(domain, self.get_fully_qualified_name())
        if self.latch is not None and (left := self.latch.read()):
            self.gate.refuse(f'stopped before this gate was started: {left}', self._now())
        self.diagnostics = DiagnosticsPublisher(self, self._describe)
        steady = steady_clock()
        self.create_timer(1.0 / DIAGNOSTICS_HZ, self.diagnostics.publish, clock=steady)
        # On the steady clock: a paused simulation must not silence the gate.
        self.create_timer(1.0 / timing.gate_rate_hz, self._on_timer, clock=steady)

    def _listen(self, *, best_effort: bool) -> None:
        """Subscribe. In this order queued messages are handled: what is known of the car comes before proposals."""
        callbacks = {topics.STATUS: self._on_status, topics.ODOMETRY: self._on_odometry, topics.CLOCK: self._on_clock}
        callbacks |= {topics.AUTONOMY: self._on_autonomy, topics.PROPOSED: self._on_proposal}
        if not self.get_parameter('use_sim_time').value:
            del callbacks[topics.CLOCK]
        # After remapping and namespace: what counts is who publishes what this node hears.
        self.watched = {'commands': self.output.topic_name}
        for name, callback in callbacks.items():
            loose = best_effort and name == topics.ODOMETRY
            made = make_subscription(self, name, callback, self.losses, best_effort=loose)
            self.watched[KINDS[name]] = made.topic_name

    def run(self, executor: SingleThreadedExecutor) -> None:
        spin(self, executor, until=lambda: self.stop.requested)
        if self.simulated or self.gate.state is GateState.WAITING:
            return
        self.gate.refuse(ASKED_TO_END, self._now())
        deadline = time.monotonic() + STOP_AT_END_S
        while time.monotonic() < deadline and self.gate.moves:
            executor.spin_once(timeout_sec=0.05)

    def close(self) -> None:
        """A stop that only the end of this gate has caused ends with it; the car stands. Every other one stays."""
        if self.latch is not None and self.gate.reason == ASKED_TO_END and not self.gate.moves:
            self.latch.clear()

    def _now(self) -> Moment:
        return Moment(time.monotonic(), self.get_clock().now().nanoseconds * 1e-9)

    def _on_proposal(self, message: Any) -> None:
        answer = self.inputs.proposal(message, self._now())
        self.last_stamp_ns = answer.stamp_ns
        self._publish(answer)

    def _on_odometry(self, message: Any) -> None:
        refused = self.inputs.odometry(message, self._now())
        if refused:
            self.get_logger().error(f'odometry refused: {refused}', throttle_duration_sec=1.0)
        self._log_change()

    def _on_status(self, message: Any) -> None:
        stopped = self.gate.state in STOPS
        refused = self.inputs.status(message, self._now())
        if stopped and self.gate.state is GateState.WAITING:
            self.get_logger().info('started over: the stop of the last drive ends with it')
        if refused:
            self.get_logger().error(f'vehicle status refused: {refused}', throttle_duration_sec=1.0)
        self._log_change()

    def _on_clock(self, message: Any) -> None:
        self.gate.clock(message.clock.sec + message.clock.nanosec * 1e-9, self._now())

    def _on_autonomy(self, message: Any) -> None:
        self.gate.override(self._now(), by_driver=not message.data)
        self._log_change()

    def _on_timer(self) -> None:
        now = self._now()
        self.gate.publisher_counts({kind: self.count_publishers(name) for kind, name in self.watched.items()}, now)
        # While driving, proposals are answered as they come. The timer checks for silence and, on a car, repeats.
        control = self.gate.tick(now)
        if self.gate.state is GateState.WAITING and not self.steady:
            # In lock-step the vehicle waits for the answer to its tick; the brake of WAITING must not pass for one.
            self._log_change()
            return
        if self.gate.state is not GateState.DRIVING:
            self._publish(Decision(self.get_clock().now().nanoseconds, control))
        elif self.steady:
            self._publish(Decision(self.last_stamp_ns, control))

    def _publish(self, answer: Decision) -> None:
        extras = {ACTIVATION: float(self.gate.activation)}
        numbered = Decision(answer.stamp_ns, answer.control, answer.action, answer.inference_ms, self.sender.next())
        self.output.publish(self.sender.sign(decision_to_message(self.factory, numbered, extras)))
        self._log_change()

    def _log_change(self) -> None:
        """Log a new state or reason, publish it, and keep it for a gate that may be started after this one."""
        state, reason = self.gate.state, self.gate.reason
        if (state, reason) != self.logged:
            self.logged = (state, reason)
            if state is GateState.DRIVING:
                self.get_logger().info('driving: proposals pass')
            elif state is GateState.WAITING:
                self.get_logger().info(f'waiting: {reason}')
            else:
                self.get_logger().warning(f'{state.value}: {reason}')
            if self.latch is not None and state is not GateState.WAITING:
                self.latch.write(reason or ENDED_DRIVING)
            self.said_s = time.monotonic()
            self.diagnostics.publish()
        elif state in STOPS and time.monotonic() - self.said_s > REMIND_S:
            self.said_s = time.monotonic()
            self.get_logger().warning(f'still in {state.value}: {reason}; {self.remedy}')

    def _on_activate(self, request: Any, response: Any) -> Any:
        refusal = self.gate.activate(self._now())
        if refusal:
            self.get_logger().warning(f'not activated: {refusal}')
        else:
            # Logged here: a waiting gate publishes nothing in lock-step. The next stop is logged again.
            self.logged = (self.gate.state, self.gate.reason)
            self.get_logger().info('re-activated')
            if self.latch is not None:
                self.latch.clear()
        response.success, response.message = not refusal, refusal or self.gate.state.value
        return response

    def _on_start_over(self, request: Any, response: Any) -> Any:
        """For a simulation that puts the car elsewhere and does not say so in its status."""
        refusal = self.gate.start_over(self._now())
        if refusal:
            self.get_logger().warning(f'not started over: {refusal}')
        else:
            self.get_logger().info('started over: the stop of the last drive ends with it')
            self.logged = (None, '')
        response.success, response.message = not refusal, refusal or self.gate.state.value
        return response

    def _describe(self) -> tuple[int, str, dict[str, Any]]:
        level = {GateState.DRIVING: OK, GateState.WAITING: WARN}.get(self.gate.state, ERROR)
        values = {
            'state': self.gate.state.value,
            'speed_mps': 'unknown' if self.gate.speed_mps is None else round(self.gate.speed_mps, 2),
            'activation': self.gate.activation,
            'messages_lost': self.losses.total,
            'proposals_foreign': self.inputs.proposals.foreign,
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
