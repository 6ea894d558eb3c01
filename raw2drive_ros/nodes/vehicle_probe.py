"""Probe: observes a graph that claims to be a vehicle and, if allowed, moves it; `conformance` evaluates the result.

Writes the verdicts as JSON; `raw2drive check-vehicle` prints them.
"""

from __future__ import annotations

import json
import time
from dataclasses import asdict
from pathlib import Path
from typing import Any

import rclpy
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy

from msg_adapters.commands import decision_to_message
from msg_adapters.compressed import image_from_compressed_message
from msg_adapters.factory import RclpyFactory
from msg_adapters.sensors import (
    calibration_from_messages,
    image_from_message,
    imu_from_message,
    odometry_from_message,
    route_from_message,
)
from msg_adapters.stamps import stamp_ns
from raw2drive_ros.conformance.active import BRAKE, PROGRAMME, Step, ends_standing, judge_trials, stands
from raw2drive_ros.conformance.observation import Observation, TopicSeen, Trial, Verdict
from raw2drive_ros.conformance.passive import expected, judge
from raw2drive_ros.contracts import topics
from raw2drive_ros.contracts.errors import BundleError, ContractError, NodeError, UnsafeError
from raw2drive_ros.contracts.public import Control, Decision
from raw2drive_ros.driving.bundle import load_bundle
from raw2drive_ros.nodes.parameters import declare, wants_compressed
from raw2drive_ros.nodes.quality import make_publisher, message_class
from raw2drive_ros.nodes.runtime import StopRequest, run_node
from raw2drive_ros.tables.rates import DECISION_HZ
from raw2drive_ros.timing import load_timing

# Discovery usually takes a fraction of a second; on a busy machine it has taken more than the first of these.
LOOK_S, LOOK_LONGER_S = 2.0, 6.0
BRAKE_AT_END_S = 5.0


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
                'report': ('', 'file for the verdicts as JSON'),
            },
        )
        self.compressed = wants_compressed(self.p['image_transport'])
        try:
            self.rig = load_bundle(Path(self.p['bundle'])).rig
        except BundleError as error:
            raise NodeError(str(error)) from error
        self.seen = Observation(float(self.p['seconds']))
        self.infos: dict[str, Any] = {}
        self.extrinsics: dict[str, Any] = {}
        self.trial: Trial | None = None
        self.trial_started = 0.0
        self.newest_ns = 0
        self.odometry_at_s = 0.0
        self.odometry_good_s = load_timing().odometry_after_s

    def run(self, executor: SingleThreadedExecutor) -> None:
        cameras = tuple(camera.name for camera in self.rig)
        self.names = expected(cameras, compressed=self.compressed)
        # Discovery needs time: only then can a publisher be reported as missing.
        self._spin(executor, LOOK_S)
        deadline = time.monotonic() + LOOK_LONGER_S
        while time.monotonic() < deadline and not all(map(self.count_publishers, self.names)) and self._running:
            self._spin(executor, 0.2)
        self._look_at_graph()
        for name in self.names:
            self._listen(name)
        self._spin(executor, self.seen.seconds)
        if self.stop.requested:
            return
        verdicts = judge(self.seen, self.rig, compressed=self.compressed)
        verdicts += self._move(executor, verdicts)
        Path(self.p['report']).write_text(json.dumps([asdict(verdict) for verdict in verdicts]))

    def _look_at_graph(self) -> None:
        types = dict(self.get_topic_names_and_types())
        for name in self.names:
            infos = self.get_publishers_info_by_topic(name)
            self.seen.topics[name] = TopicSeen(
                tuple(types.get(name, ())),
                len(infos),
                all(i.qos_profile.reliability == ReliabilityPolicy.RELIABLE for i in infos),
                all(i.qos_profile.durability == DurabilityPolicy.TRANSIENT_LOCAL for i in infos),
            )
        self.seen.command_subscribers = self.count_subscribers(topics.COMMAND)
        self.seen.command_publishers = self.count_publishers(topics.COMMAND)

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
        self.create_subscription(message_class(spec.msgtype), name, self._noter(name), profile)

    def _noter(self, name: str) -> Any:
        topic = self.seen.topics[name]

        def note(message: Any) -> None:
            stamp = stamp_ns(message.header.stamp)
            topic.stamps_ns.append(stamp)
            topic.ages_s.append((self.get_clock().now().nanoseconds - stamp) * 1e-9)
            topic.frames.add(str(message.header.frame_id))
            try:
                self._keep(name, message)
            except ContractError as error:
                topic.refused.append(str(error))

        return note

    def _keep(self, name: str, message: Any) -> None:
        if name == topics.IMU:
            self.seen.imu.append(imu_from_message(message))
        elif name == topics.ODOMETRY:
            found = odometry_from_message(message)
            self.seen.odometry.append(found)
            self.newest_ns = found.stamp_ns
            self.odometry_at_s = time.monotonic()
            if self.trial is not None:
                self.trial.times_s.append(time.monotonic() - self.trial_started)
                self.trial.speeds_mps.append(found.speed_mps)
                self.trial.yaw_rates_radps.append(found.yaw_rate_radps)
        elif name == topics.ROUTE:
            self.seen.route = route_from_message(message)
        else:
            camera = name.split('/')[3]
            if name == topics.camera_info_topic(camera):
                self.infos[camera] = message
            elif name == topics.extrinsics_topic(camera):
                self.extrinsics[camera] = message
            else:
                convert = image_from_compressed_message if self.compressed else image_from_message
                self.seen.images[camera] = convert(message).copy()
            if camera in self.infos and camera in self.extrinsics:
                found_camera = calibration_from_messages(camera, self.infos[camera], self.extrinsics[camera])
                self.seen.calibrations[camera] = found_camera

    # -- motion -----------------------------------------------------------------------------------

    def _move(self, executor: SingleThreadedExecutor, verdicts: list[Verdict]) -> list[Verdict]:
        if not self.p['allow_motion']:
            return [Verdict('motion', 'skipped', 'brake, throttle, steering, silence, NaN', 'give --allow-motion')]
        if self.seen.command_publishers:
            return [Verdict('motion', 'error', f'somebody publishes {topics.COMMAND}', 'stop the safety gate first')]
        broken = [
            v.check for v in verdicts if v.severity == 'error' and v.check.startswith((topics.ODOMETRY, '/control'))
        ]
        if broken:
            return [Verdict('motion', 'skipped', f'not without {", ".join(broken)}', 'mend that first')]
        output = make_publisher(self, topics.COMMAND)
        trials: list[Trial] = []
        unsafe = []
        try:
            for step in PROGRAMME:
                trial = self._try(executor, output, step)
                trials += [trial] if step.name else []
                if step.until_standing and not ends_standing(trial):
                    raise UnsafeError(f'the car does not stand after {step.name or "the brake"}')
        except UnsafeError as error:
            self.get_logger().error(f'{error}: braking')
            unsafe = [Verdict('motion', 'error', f'given up: {error}', 'mend that first')]
        finally:
            self._brake(executor, output)
        return judge_trials(trials) + unsafe

    def _try(self, executor: SingleThreadedExecutor, output: Any, step: Step) -> Trial:
        """Drive one step of the programme. Raises UnsafeError when the car must not be moved any further."""
        self.trial, self.trial_started = Trial(step.name, step.control), time.monotonic()
        period_s = 1.0 / DECISION_HZ
        due = self.trial_started
        while time.monotonic() < self.trial_started + step.seconds:
            self._require_safe()
            if step.control is not None:
                self._ask(output, step.control)
            due += period_s
            self._spin(executor, max(0.0, due - time.monotonic()))
            if step.until_standing and self.trial.times_s and stands(self.trial):
                break
        trial, self.trial = self.trial, None
        return trial

    def _require_safe(self) -> None:
        if not self._running:
            raise UnsafeError('interrupted')
        blind_s = time.monotonic() - self.odometry_at_s
        if blind_s > self.odometry_good_s:
            raise UnsafeError(f'no odometry for {blind_s:.1f} s')
        if self.count_publishers(topics.COMMAND) > 1:
            raise UnsafeError(f'somebody else publishes {topics.COMMAND}')

    def _brake(self, executor: SingleThreadedExecutor, output: Any) -> None:
        """Brake until the car stands, for BRAKE_AT_END_S at most; a second signal does not shorten this."""
        self.trial, self.trial_started = Trial('', BRAKE), time.monotonic()
        while time.monotonic() < self.trial_started + BRAKE_AT_END_S and rclpy.ok():
            self._ask(output, BRAKE)
            executor.spin_once(timeout_sec=0.05)
            if self.trial.times_s and stands(self.trial):
                break
        self.trial = None

    @property
    def _running(self) -> bool:
        return rclpy.ok() and not self.stop.requested

    def _spin(self, executor: SingleThreadedExecutor, seconds: float) -> None:
        deadline = time.monotonic() + seconds
        while (left := deadline - time.monotonic()) > 0 and self._running:
            executor.spin_once(timeout_sec=min(left, 0.2))

    def _ask(self, output: Any, control: Control) -> None:
        output.publish(decision_to_message(RclpyFactory(), Decision(self.newest_ns, control)))


def main(args: list[str] | None = None) -> int:
    """Run the vehicle probe and return the exit code."""
    return run_node(VehicleProbeNode, args)


if __name__ == '__main__':
    raise SystemExit(main())
