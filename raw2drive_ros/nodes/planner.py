"""Raw-sensor planner: cameras, IMU, odometry and route in, proposed commands out. A lifecycle node.

This process cannot import privileged code nor subscribe to a privileged topic (`driving.isolation`).
"""

from __future__ import annotations

import dataclasses
import math
import time
from pathlib import Path
from typing import Any

import numpy as np

from raw2drive_ros.driving.isolation import block_privileged_imports, refuse_privileged_topic

block_privileged_imports()

from rclpy.clock import JumpThreshold
from rclpy.duration import Duration
from rclpy.lifecycle import LifecycleNode, LifecycleState, TransitionCallbackReturn

from msg_adapters.commands import decision_to_message
from msg_adapters.diagnostics import ERROR, OK, WARN
from msg_adapters.factory import RclpyFactory
from raw2drive_ros.contracts import topics
from raw2drive_ros.contracts.errors import BundleError, ConfigError, ContractError, NodeError, PrivilegedImportError
from raw2drive_ros.driving.bundle import load_bundle
from raw2drive_ros.driving.health_report import HealthReport
from raw2drive_ros.driving.monitor_config import load_monitor_config
from raw2drive_ros.driving.planner_inputs import PlannerInputs
from raw2drive_ros.driving.raw_planner import RawPlanner
from raw2drive_ros.driving.sensor_monitor import Health
from raw2drive_ros.driving.single_writer import Sender
from raw2drive_ros.driving.synchronisation import Synchronisation
from raw2drive_ros.nodes.diagnostics import DiagnosticsPublisher
from raw2drive_ros.nodes.keys import load_key
from raw2drive_ros.nodes.parameters import declare, wants_best_effort, wants_compressed
from raw2drive_ros.nodes.quality import LossCounter, make_publisher, make_subscription
from raw2drive_ros.nodes.runtime import run_node, spin, steady_clock
from raw2drive_ros.tables.rates import DECISION_HZ, DIAGNOSTICS_HZ
from raw2drive_ros.timing import load_timing

BACK_S = 0.5


class PlannerNode(LifecycleNode):
    """configure loads the model and warms it up, activate creates the sensor subscriptions."""

    # rclpy subscribes to topics of its own before the parameters are known.
    best_effort = False

    def __init__(self) -> None:
        super().__init__('planner')
        self.p = declare(
            self,
            {
                'bundle': ('', 'folder of the policy bundle'),
                'image_transport': ('raw', 'raw images, or compressed ones (JPEG, PNG)'),
                'sensor_reliability': ('reliable', 'QoS of the sensors: reliable, or best_effort, which hears either'),
                'interpolate_age_s': (0.0, 'interpolate IMU and odometry between samples no further off; 0: never'),
                'camera_skew_s': (0.0, 'pictures whose stamps differ by no more are one frame; 0: one stamp'),
                'monitor': ('', 'what healthy sensors are (default: params/monitor.yaml)'),
                'threads': (1, 'torch threads for inference'),
                'autostart': (True, 'configure and activate at start, without a lifecycle manager'),
                'stats_file': ('', 'write latency and loss figures as JSON here at the end'),
            },
        )
        self.compressed = wants_compressed(self.p['image_transport'])
        self.best_effort = wants_best_effort(self.p['sensor_reliability'])
        self.factory = RclpyFactory()
        self.losses = LossCounter()
        self.sender = Sender(topics.PROPOSED, load_key(self.context.get_domain_id()))
        self.planner: RawPlanner | None = None
        self.inputs: PlannerInputs | None = None
        self.failure = ''
        self.report = HealthReport()
        self.newest_ns = 0
        self.refusal_logged: dict[str, float] = {}
        self.sensor_subscriptions: list[Any] = []
        self.diagnostics = DiagnosticsPublisher(self, self._describe)
        self.watch_clock = steady_clock()
        self.create_timer(1.0 / DIAGNOSTICS_HZ, self.diagnostics.publish, clock=self.watch_clock)
        # A missing message triggers no callback: a timer checks for silence.
        self.create_timer(1.0 / DECISION_HZ, self._watch, clock=self.watch_clock)
        # When a bag loops or a simulation is reset, the samples so far belong to another time.
        backwards = JumpThreshold(min_forward=None, min_backward=Duration(seconds=-BACK_S), on_clock_change=False)
        self.jumps = self.get_clock().create_jump_callback(backwards, post_callback=self._on_jump)

    def create_subscription(self, msg_type: Any, topic: str, *args: Any, **kwargs: Any) -> Any:
        """Raises PrivilegedImportError for a privileged topic, whoever subscribes, and whatever it is remapped from."""
        refuse_privileged_topic(topic)
        refuse_privileged_topic(self.resolve_topic_name(topic))
        return super().create_subscription(msg_type, topic, *args, **kwargs)

    def run(self, executor: Any) -> None:
        if self.p['autostart']:
            for transition in (self.trigger_configure, self.trigger_activate):
                if transition() != TransitionCallbackReturn.SUCCESS:
                    raise NodeError(self.failure or 'the planner could not start')
        spin(self, executor)

    # -- lifecycle --------------------------------------------------------------------------------

    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Load the bundle and warm it up; a failure leaves the node unconfigured and is logged."""
        try:
            if not self.p['bundle']:
                raise BundleError('parameter `bundle` is empty; give the folder of a policy bundle')
            bundle = load_bundle(Path(self.p['bundle']))
            limits = load_monitor_config(Path(self.p['monitor']) if self.p['monitor'] else None).limits(load_timing())
            sync = Synchronisation(float(self.p['interpolate_age_s']), float(self.p['camera_skew_s']))
            self.planner = RawPlanner(bundle, limits, int(self.p['threads']), sync)
        except (BundleError, ConfigError, ContractError) as error:
            self.failure = str(error)
            self.get_logger().error(self.failure)
            return TransitionCallbackReturn.FAILURE
        self.failure = ''
        self.inputs = PlannerInputs(
            self.planner, compressed=self.compressed, on_refused=self._on_refused, on_notice=self.get_logger().info
        )
        self.output = make_publisher(self, topics.PROPOSED)
        self.get_logger().info(f'bundle {bundle.identity} from {bundle.path}')
        return TransitionCallbackReturn.SUCCESS

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        assert self.planner is not None and self.inputs is not None
        self.planner.start(self._now_ns())
        try:
            for topic in self.inputs.topics:
                receiver = self._receiver(topic)
                made = make_subscription(self, topic, receiver, self.losses, best_effort=self.best_effort)
                self.sensor_subscriptions.append(made)
        except PrivilegedImportError as error:
            # rclpy would drop it without a word.
            self._stop_listening()
            self.failure = str(error)
            self.get_logger().error(self.failure)
            return TransitionCallbackReturn.FAILURE
        return super().on_activate(state)

    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Stop proposing; the gate then stops the car."""
        self._stop_listening()
        return super().on_deactivate(state)

    def on_shutdown(self, state: LifecycleState) -> TransitionCallbackReturn:
        """From any state, also the active one: nothing more is proposed."""
        self._stop_listening()
        return super().on_shutdown(state)

    def on_error(self, state: LifecycleState) -> TransitionCallbackReturn:
        self._stop_listening()
        return super().on_error(state)

    def on_cleanup(self, state: LifecycleState) -> TransitionCallbackReturn:
        self._stop_listening()
        self.planner = self.inputs = None
        self.destroy_publisher(self.output)
        return TransitionCallbackReturn.SUCCESS

    def _stop_listening(self) -> None:
        for subscription in self.sensor_subscriptions:
            self.destroy_subscription(subscription)
        self.sensor_subscriptions.clear()

    # -- inputs -----------------------------------------------------------------------------------

    def _now_ns(self) -> int:
        return int(self.get_clock().now().nanoseconds)

    def _receiver(self, topic: str) -> Any:
        def callback(message: Any) -> None:
            if self.inputs is None or self.planner is None:
                return
            decision = self.inputs.receive(topic, message, self._now_ns())
            if decision is not None:
                numbered = dataclasses.replace(decision, sequence=self.sender.next())
                self.output.publish(self.sender.sign(decision_to_message(self.factory, numbered)))
            elif self.planner.failure:
                self.get_logger().error(self.planner.failure, throttle_duration_sec=1.0)

        return callback

    def _on_refused(self, name: str, why: str) -> None:
        # At most once a second per input: the logger's throttle would let one input hide another.
        now_s = time.monotonic()
        if now_s - self.refusal_logged.get(name, -math.inf) >= 1.0:
            self.refusal_logged[name] = now_s
            self.get_logger().error(f'{name} refused: {why}')

    def _on_jump(self, jump: Any) -> None:
        self._start_anew(-jump.delta.nanoseconds * 1e-9)

    def _start_anew(self, back_s: float) -> None:
        self.newest_ns = self._now_ns()
        self.get_logger().warning(f'ROS time went back by {back_s:.1f} s; starting anew')
        if self.planner is not None:
            self.planner.start(self.newest_ns, same_vehicle=True)

    def _watch(self) -> None:
        """Check the sensors; log and publish what has changed."""
        if not self.sensor_subscriptions or self.planner is None:
            return
        # rclpy reports jumps of simulated time only, but the system clock may be set back too.
        back_s = (self.newest_ns - self._now_ns()) * 1e-9
        if back_s > BACK_S:
            self._start_anew(back_s)
        self.newest_ns = self._now_ns()
        self.planner.look(self.newest_ns)
        lines = self.report.lines(self.planner.findings, complete=self.planner.monitor.complete)
        for line in lines:
            # Two calls: rclpy allows one severity per call site.
            if line.alarming:
                self.get_logger().warning(line.text)
            else:
                self.get_logger().info(line.text)
        if lines:
            self.diagnostics.publish()

    # -- reporting --------------------------------------------------------------------------------

    def figures(self) -> dict[str, Any]:
        """Latency from sensor frame to decision in this process (ms), and counts of lost and refused messages."""
        latency_ms = self.planner.latency_ms if self.planner is not None else ()
        p50, p99 = np.percentile(latency_ms, [50, 99]) if latency_ms else (None, None)
        return {
            'planner_ms': {'p50': p50, 'p99': p99},
            'decisions': self.planner.decisions if self.planner is not None else 0,
            'messages_lost': self.losses.total,
            'inputs_refused': self.inputs.refused if self.inputs is not None else 0,
        }

    def _describe(self) -> tuple[int, str, dict[str, Any]]:
        values = self.figures()
        if self.planner is None:
            return (ERROR, self.failure, values) if self.failure else (OK, 'not configured', values)
        if not self.sensor_subscriptions:
            return WARN, 'not active: proposes nothing', values
        health = self.planner.health
        values |= {
            'bundle': self.planner.bundle.identity,
            'sensors': health.name.lower(),
            **self.planner.monitor.counts,
        }
        for number, finding in enumerate(self.planner.findings):
            values[f'cause_{number}'], values[f'remedy_{number}'] = finding.cause, finding.remedy
        if health is not Health.NOMINAL:
            if all(finding.unheard for finding in self.planner.findings):
                return WARN, f'waiting for {", ".join(f.subject for f in self.planner.findings)}', values
            level = ERROR if health is Health.STOP else WARN
            return level, f'{health.name.lower()}: {self.planner.findings[0].cause}', values
        if self.planner.failure:
            return ERROR, self.planner.failure, values
        if self.losses.total:
            return WARN, f'{self.losses.total} messages lost', values
        return OK, 'driving' if self.planner.latency_ms else 'no frame yet', values

    def close(self) -> None:
        if self.p['stats_file']:
            import json

            Path(self.p['stats_file']).write_text(json.dumps(self.figures()))


def main(args: list[str] | None = None) -> int:
    """Run the planner and return the exit code."""
    return run_node(PlannerNode, args)


if __name__ == '__main__':
    raise SystemExit(main())
