"""Probe: observes a graph that claims to be a vehicle and, if allowed, moves it; `conformance` evaluates the result.

Writes the verdicts as JSON; `raw2drive check-vehicle` prints them.
"""

from __future__ import annotations

import json
import time
from dataclasses import asdict
from pathlib import Path
from typing import Any

import cv2
import rclpy
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy

from msg_adapters.commands import ACTIVATION, decision_to_message
from msg_adapters.factory import RclpyFactory
from msg_adapters.stamps import stamp_ns
from msg_adapters.vehicle_status import status_from_message
from raw2drive_ros.conformance.active import conclude, what_forbids_motion
from raw2drive_ros.conformance.clock import VehicleClock
from raw2drive_ros.conformance.collector import Collector
from raw2drive_ros.conformance.mosaic import mosaic
from raw2drive_ros.conformance.observation import TopicSeen, Verdict
from raw2drive_ros.conformance.passive import expected, judge
from raw2drive_ros.conformance.programme import BRAKE, FOREIGN, Runner, Step
from raw2drive_ros.contracts import topics
from raw2drive_ros.contracts.errors import BundleError, ContractError, NodeError, UnsafeError
from raw2drive_ros.contracts.public import Control, Decision
from raw2drive_ros.driving.bundle import load_bundle
from raw2drive_ros.driving.single_writer import Sender
from raw2drive_ros.nodes.keys import load_key
from raw2drive_ros.nodes.parameters import declare, wants_compressed
from raw2drive_ros.nodes.quality import (
    LossCounter,
    expanded_name,
    make_publisher,
    make_subscription,
    message_class,
    publisher_count,
    resolved_name,
    subscriber_count,
)
from raw2drive_ros.nodes.runtime import StopRequest, run_node
from raw2drive_ros.tables.rates import DECISION_HZ
from raw2drive_ros.timing import load_timing

# Discovery usually takes a fraction of a second; on a busy machine it has taken more than the first of these.
LOOK_S, LOOK_LONGER_S = 2.0, 6.0
BRAKE_AT_END_S = 5.0
# Messages of the second publisher to each of ours.
FOREIGN_TIMES = 5
# A step may take so many times as long as planned, and so much longer, before the clock counts as dead.
SLOWER, LATER_S = 3.0, 5.0


class VehicleProbeNode(Node):
    """Never publishes a command unless `allow_motion` is set. However it ends, it brakes until the car stands."""

    # Ctrl-C must not close the context before the brake is on.
    drains = True
    stop: StopRequest

    def __init__(self) -> None:
        super().__init__('vehicle_probe')
        self.p = declare(
            self,
            {
                'bundle': ('', 'bundle whose cameras the vehicle must have'),
                'image_transport': ('raw', 'raw images, or compressed ones'),
                'seconds': (5.0, 'how long to listen'),
                'allow_motion': (False, 'also drive the car: only where nobody can be hurt'),
                'wants_sim_time': (False, 'a missing /clock is an error; one that is there is used in any case'),
                'report': ('', 'file for the verdicts as JSON'),
                'mosaic': ('', 'PNG file for the labelled pictures of all cameras; empty: none'),
            },
        )
        self.compressed = wants_compressed(self.p['image_transport'])
        try:
            self.rig = load_bundle(Path(self.p['bundle'])).rig
        except BundleError as error:
            raise NodeError(str(error)) from error
        self.collector = Collector(float(self.p['seconds']), compressed=self.compressed)
        self.seen = self.collector.seen
        self.seen.wants_sim_time = bool(self.p['wants_sim_time'])
        self.clock = VehicleClock()
        self.output: Any = None
        self.sender: Any = None
        # Newest that the vehicle has heard, of a gate before us; ours are newer.
        self.activation = 0
        self.stranger: Any = None
        # Step of the programme, and when it began.
        self.began = (-1, 0.0)
        self.activated_at = -1
        self.odometry_at_s = 0.0
        self.odometry_good_s = load_timing().odometry_after_s

    def run(self, executor: SingleThreadedExecutor) -> None:
        cameras = tuple(camera.name for camera in self.rig)
        self.names = expected(cameras, compressed=self.compressed)
        # Discovery needs time: only then can a publisher be reported as missing.
        self._spin(executor, LOOK_S)
        deadline = time.monotonic() + LOOK_LONGER_S
        while time.monotonic() < deadline and self._running and not self._all_discovered():
            self._spin(executor, 0.2)
        self._look_at_graph()
        for name in self.names:
            self._listen(name)
        make_subscription(self, topics.STATUS, self._on_status, LossCounter())
        self._spin(executor, self.seen.seconds)
        if self.stop.requested:
            return
        listened = judge(self.seen, self.rig, compressed=self.compressed)
        verdicts = conclude(self.seen, listened, self._move(executor, listened))
        verdicts += self._draw()
        Path(self.p['report']).write_text(json.dumps([asdict(verdict) for verdict in verdicts]))

    def _draw(self) -> list[Verdict]:
        """Write the mosaic, and say where it is."""
        path = Path(self.p['mosaic'])
        if not self.p['mosaic']:
            return []
        if not self.seen.images:
            return [Verdict('cameras: mosaic', 'skipped', 'no pictures', 'publish some')]
        path.parent.mkdir(parents=True, exist_ok=True)
        if not cv2.imwrite(str(path), mosaic(self.seen, self.rig)[..., ::-1]):
            raise NodeError(f'{path} cannot be written')
        return [Verdict('cameras: mosaic', 'passed', f'{path}: does each picture show what stands below it?')]

    def _all_discovered(self) -> bool:
        """Whether every topic of the vehicle has a publisher, and the commands somebody who takes them."""
        return subscriber_count(self, topics.COMMAND) > 0 and all(publisher_count(self, name) for name in self.names)

    def _look_at_graph(self) -> None:
        types = dict(self.get_topic_names_and_types())
        for name in self.names:
            infos = self.get_publishers_info_by_topic(expanded_name(self, name))
            self.seen.topics[name] = TopicSeen(
                tuple(types.get(resolved_name(self, name), ())),
                len(infos),
                all(i.qos_profile.reliability == ReliabilityPolicy.RELIABLE for i in infos),
                all(i.qos_profile.durability == DurabilityPolicy.TRANSIENT_LOCAL for i in infos),
            )
        self.seen.command_subscribers = subscriber_count(self, topics.COMMAND)
        self.seen.command_publishers = publisher_count(self, topics.COMMAND)
        self.seen.sim_time = publisher_count(self, topics.CLOCK) > 0
        if self.seen.sim_time:
            spec = topics.BY_NAME[topics.CLOCK]
            # Any publisher of a clock offers at least this.
            quality = QoSProfile(depth=spec.qos.depth, reliability=ReliabilityPolicy.BEST_EFFORT)
            self.create_subscription(message_class(spec.msgtype), topics.CLOCK, self._on_clock, quality)

    def _on_clock(self, message: Any) -> None:
        self.clock.clock(stamp_ns(message.clock), time.monotonic())

    def _listen(self, name: str) -> None:
        spec, topic = topics.BY_NAME[name], self.seen.topics[name]
        if topic.msgtypes != (spec.msgtype,):
            return
        # Request what the publishers offer, so that they match; `_look_at_graph` has noted the offer.
        profile = QoSProfile(
            history=HistoryPolicy.KEEP_LAST,
            depth=50,
            reliability=ReliabilityPolicy.RELIABLE if topic.reliable else ReliabilityPolicy.BEST_EFFORT,
            durability=DurabilityPolicy.TRANSIENT_LOCAL if topic.transient_local else DurabilityPolicy.VOLATILE,
        )
        self.create_subscription(message_class(spec.msgtype), expanded_name(self, name), self._noter(name), profile)

    def _noter(self, name: str) -> Any:
        def note(message: Any) -> None:
            wall_s = time.monotonic()
            if name == topics.ODOMETRY:
                self.clock.odometry(stamp_ns(message.header.stamp), wall_s)
                self.odometry_at_s = wall_s
            if not self.seen.sim_time:
                now_ns = self.get_clock().now().nanoseconds
            elif self.clock.simulated:
                now_ns = self.clock.now_ns(wall_s)
            else:
                # Before the first /clock no age can be told.
                now_ns = stamp_ns(message.header.stamp)
            self.collector.note(name, message, now_ns)

        return note

    # -- motion -----------------------------------------------------------------------------------

    def _move(self, executor: SingleThreadedExecutor, verdicts: list[Verdict]) -> list[Verdict]:
        """Drive the programme; returns why it was not driven, or not to its end."""
        if not self.p['allow_motion']:
            return [Verdict('motion', 'skipped', 'brake, throttle, steering, silence, NaN', 'give --allow-motion')]
        if self.seen.command_publishers:
            return [Verdict('motion', 'error', f'somebody publishes {topics.COMMAND}', 'stop the safety gate first')]
        broken = what_forbids_motion(verdicts)
        if broken:
            return [Verdict('motion', 'skipped', f'not without {", ".join(broken)}', 'mend that first')]
        self.sender = Sender(topics.COMMAND, load_key(self.context.get_domain_id()))
        self.output = make_publisher(self, topics.COMMAND)
        found: list[Verdict] = []
        runner = Runner(self.seen)
        try:
            while (step := runner.order(self._now_ns())) is not None:
                if step.foreign is not None and self.stranger is None and not self._let_in(executor, runner):
                    found.append(Verdict(FOREIGN, 'skipped', 'the second publisher found no subscriber', 'try again'))
                    continue
                self._require_running_clock(runner.index, step)
                self._activate(runner)
                self._step(executor, step)
        except UnsafeError as error:
            self.get_logger().error(f'{error}: braking')
            if runner.index >= 0:
                runner.close()
            found.append(Verdict('motion', 'error', f'given up: {error}', 'mend that first'))
        finally:
            self._let_out()
            self._brake(executor)
        return found

    def _step(self, executor: SingleThreadedExecutor, step: Step) -> None:
        """One period of decisions: our command, if any, and those of the second publisher between ours."""
        self._require_safe()
        if step.control is not None:
            self._command(step.control)
        times = FOREIGN_TIMES if step.foreign is not None else 1
        due = time.monotonic()
        for _ in range(times):
            if step.foreign is not None:
                self.stranger.output.publish(self._unsigned(step.foreign))
            due += 1.0 / DECISION_HZ / times
            self._spin(executor, max(0.0, due - time.monotonic()))

    def _let_in(self, executor: SingleThreadedExecutor, runner: Runner) -> bool:
        """Make the second publisher. False, and the step is skipped, where no vehicle has discovered it."""
        self.stranger = Stranger()
        deadline = time.monotonic() + LOOK_S
        while not self.stranger.output.get_subscription_count() and time.monotonic() < deadline:
            self._step(executor, Step('', BRAKE, 0.0))
        if self.stranger.output.get_subscription_count():
            runner.again(self._now_ns())
            return True
        self._let_out()
        runner.skip(self._now_ns())
        return False

    def _let_out(self) -> None:
        if self.stranger is not None:
            self.stranger.destroy_node()
            self.stranger = None

    def _require_safe(self) -> None:
        if not self._running:
            raise UnsafeError('interrupted')
        blind_s = time.monotonic() - self.odometry_at_s
        if blind_s > self.odometry_good_s / min(self.clock.pace, 1.0):
            raise UnsafeError(f'no odometry for {blind_s:.1f} s')
        if publisher_count(self, topics.COMMAND) > 1 + (self.stranger is not None):
            raise UnsafeError(f'somebody else publishes {topics.COMMAND}')

    def _require_running_clock(self, index: int, step: Step) -> None:
        """The programme goes by the vehicle's clock: one that hardly moves must not make a step endless."""
        wall_s = time.monotonic()
        if self.began[0] != index:
            self.began = index, wall_s
        limit_s = SLOWER * step.seconds / min(self.clock.pace, 1.0) + LATER_S
        if wall_s - self.began[1] > limit_s:
            raise UnsafeError(f'a step of {step.seconds:.1f} s has taken {limit_s:.0f} s: does the clock go on?')

    def _brake(self, executor: SingleThreadedExecutor) -> None:
        """Brake until the car stands, for BRAKE_AT_END_S at most; a second signal does not shorten this."""
        runner = Runner(self.seen, (Step('', BRAKE, BRAKE_AT_END_S, until_standing=True),))
        deadline = time.monotonic() + BRAKE_AT_END_S
        try:
            while time.monotonic() < deadline and rclpy.ok() and runner.order(self._now_ns()) is not None:
                self._command(BRAKE)
                executor.spin_once(timeout_sec=0.05)
        except UnsafeError as error:
            self.get_logger().error(str(error))

    def _activate(self, runner: Runner) -> None:
        """A vehicle that has refused a command obeys again when it stands and is activated anew, as by a gate."""
        if self.activated_at != runner.index and (not runner.index or runner.steps[runner.index - 1].until_standing):
            self.activated_at = runner.index
            self.activation += 1

    def _on_status(self, message: Any) -> None:
        try:
            self.activation = max(self.activation, status_from_message(message).activation)
        except ContractError as error:
            self.get_logger().warning(f'{topics.STATUS}: {error}', throttle_duration_sec=5.0)

    def _now_ns(self) -> int:
        """The vehicle's time."""
        return self.clock.now_ns(time.monotonic())

    def _command(self, control: Control) -> None:
        """Every command of the probe itself goes through here: signed, as the gate's."""
        decision = Decision(self.seen.odometry[-1].stamp_ns, control, sequence=self.sender.next())
        message = decision_to_message(RclpyFactory(), decision, {ACTIVATION: float(self.activation)})
        self.output.publish(self.sender.sign(message))

    def _unsigned(self, control: Control) -> Any:
        """A command as anybody can write it."""
        return decision_to_message(RclpyFactory(), Decision(self.seen.odometry[-1].stamp_ns, control))

    @property
    def _running(self) -> bool:
        return rclpy.ok() and not self.stop.requested

    def _spin(self, executor: SingleThreadedExecutor, seconds: float) -> None:
        deadline = time.monotonic() + seconds
        while (left := deadline - time.monotonic()) > 0 and self._running:
            executor.spin_once(timeout_sec=min(left, 0.2))


class Stranger(Node):
    """A second publisher of commands, of a node of its own: nobody that a vehicle may obey."""

    def __init__(self) -> None:
        super().__init__('stranger')
        self.output = make_publisher(self, topics.COMMAND)


def main(args: list[str] | None = None) -> int:
    """Run the vehicle probe and return the exit code."""
    return run_node(VehicleProbeNode, args)


if __name__ == '__main__':
    raise SystemExit(main())
