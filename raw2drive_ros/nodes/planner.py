"""Raw-sensor planner: cameras, IMU, odometry and route in, proposed commands out. A lifecycle node.

This process cannot import privileged code nor subscribe to a privileged topic (`driving.isolation`).
"""

from __future__ import annotations

from collections import deque
from pathlib import Path
from typing import Any

import numpy as np

from raw2drive_ros.driving.isolation import block_privileged_imports, refuse_privileged_topic

block_privileged_imports()

from rclpy.clock import JumpThreshold
from rclpy.duration import Duration
from rclpy.lifecycle import LifecycleNode, LifecycleState, TransitionCallbackReturn

from msg_adapters.commands import decision_to_message
from msg_adapters.compressed import image_from_compressed_message
from msg_adapters.diagnostics import ERROR, OK, WARN
from msg_adapters.factory import RclpyFactory
from msg_adapters.sensors import (
    calibration_from_messages,
    image_from_message,
    imu_from_message,
    odometry_from_message,
    route_from_message,
)
from msg_adapters.stamps import stamp_ns
from raw2drive_ros import topics
from raw2drive_ros.contract import (
    CameraCalibration,
    ContractError,
    Decision,
    ImuSample,
    OdometrySample,
    Route,
    SensorFrame,
)
from raw2drive_ros.driving.bundle import Bundle, BundleError, check_rig, load_bundle
from raw2drive_ros.driving.driver import RawDriver
from raw2drive_ros.driving.frame_assembler import FrameAssembler
from raw2drive_ros.driving.monitor_config import load_monitor_config
from raw2drive_ros.driving.sensor_monitor import Finding, Health, SensorMonitor
from raw2drive_ros.nodes.diagnostics import DiagnosticsPublisher
from raw2drive_ros.nodes.parameters import declare, wants_compressed
from raw2drive_ros.nodes.quality import LossCounter, make_publisher, make_subscription
from raw2drive_ros.nodes.runtime import NodeError, run_node, spin, steady_clock
from raw2drive_ros.timing import load_timing
from raw2drive_ros.world_model.config import ConfigError

BACK_S = 0.5


class PlannerNode(LifecycleNode):
    """configure loads and warms the model, activate starts listening and publishing."""

    def __init__(self) -> None:
        super().__init__('planner')
        self.p = declare(
            self,
            {
                'bundle': ('', 'folder of the policy bundle'),
                'image_transport': ('raw', 'raw images, or compressed ones (JPEG, PNG)'),
                'monitor': ('', 'what healthy sensors are (default: params/monitor.yaml)'),
                'threads': (1, 'torch threads for inference'),
                'autostart': (True, 'configure and activate at start, without a lifecycle manager'),
                'stats_file': ('', 'write latency and loss figures as JSON here at the end'),
            },
        )
        self.compressed = wants_compressed(self.p['image_transport'])
        self.factory = RclpyFactory()
        self.losses = LossCounter()
        self.bundle: Bundle | None = None
        self.driver: RawDriver | None = None
        self.failure = ''
        self._inputs: list[Any] = []
        self.latency_ms: deque[float] = deque(maxlen=100_000)
        self._forget()
        self.diagnostics = DiagnosticsPublisher(self, self._describe)
        self.watch_clock = steady_clock()
        self.create_timer(1.0, self.diagnostics.publish, clock=self.watch_clock)
        self.create_timer(0.1, self._watch, clock=self.watch_clock)
        # A bag that starts over, a simulation that is set back: what was seen belongs to another time.
        backwards = JumpThreshold(min_forward=None, min_backward=Duration(seconds=-BACK_S), on_clock_change=False)
        self.jumps = self.get_clock().create_jump_callback(backwards, post_callback=self._on_jump)

    def create_subscription(self, msg_type: Any, topic: str, *args: Any, **kwargs: Any) -> Any:
        """Refuses privileged topics, whoever asks."""
        refuse_privileged_topic(topic)
        return super().create_subscription(msg_type, topic, *args, **kwargs)

    def run(self, executor: Any) -> None:
        if self.p['autostart']:
            for transition in (self.trigger_configure, self.trigger_activate):
                if transition() != TransitionCallbackReturn.SUCCESS:
                    raise NodeError(self.failure or 'the planner could not start')
        spin(self, executor)

    # -- lifecycle --------------------------------------------------------------------------------

    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Load the bundle and decide once on an empty frame, so that the first real one is fast."""
        try:
            if not self.p['bundle']:
                raise BundleError('parameter `bundle` is empty; give the folder of a policy bundle')
            self.bundle = load_bundle(Path(self.p['bundle']))
            limits = load_monitor_config(Path(self.p['monitor']) if self.p['monitor'] else None).limits(load_timing())
            self.monitor = SensorMonitor(tuple(c.name for c in self.bundle.rig), limits)
            self.driver = RawDriver(self.bundle, int(self.p['threads']))
            self._warm_up()
        except (BundleError, ConfigError, ContractError) as error:
            self.failure = str(error)
            self.get_logger().error(self.failure)
            return TransitionCallbackReturn.FAILURE
        self.output = make_publisher(self, topics.PROPOSED)
        self.get_logger().info(f'bundle {self.bundle.identity} from {self.bundle.path}')
        return TransitionCallbackReturn.SUCCESS

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        assert self.bundle is not None
        self._forget()
        self.assembler = FrameAssembler(tuple(c.name for c in self.bundle.rig))
        self.monitor.reset()
        self.monitor.start(self.get_clock().now().nanoseconds)
        # The route first: when route and images wait together, the route is handled first.
        self._listen(topics.ROUTE, self._on_route)
        for camera in self.assembler.cameras:
            self._listen(topics.extrinsics_topic(camera), self._keep(self.extrinsics, camera))
            self._listen(topics.camera_info_topic(camera), self._keep(self.infos, camera))
        self._listen(topics.IMU, self._on_imu)
        self._listen(topics.ODOMETRY, self._on_odometry)
        image_topic = topics.compressed_topic if self.compressed else topics.image_topic
        for camera in self.assembler.cameras:
            self._listen(image_topic(camera), self._image_callback(camera))
        return super().on_activate(state)

    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Falls silent; the gate then stops the car."""
        self._stop_listening()
        return super().on_deactivate(state)

    def on_cleanup(self, state: LifecycleState) -> TransitionCallbackReturn:
        self._stop_listening()
        self.bundle = self.driver = None
        self.destroy_publisher(self.output)
        return TransitionCallbackReturn.SUCCESS

    def _forget(self) -> None:
        self.route: Route | None = None
        self.extrinsics: dict[str, Any] = {}
        self.infos: dict[str, Any] = {}
        self.rig_checked = False
        self.refused = 0
        self.answered: Decision | None = None
        self.found: list[Finding] = []

    def _listen(self, topic: str, callback: Any) -> None:
        self._inputs.append(make_subscription(self, topic, callback, self.losses))

    def _stop_listening(self) -> None:
        for subscription in self._inputs:
            self.destroy_subscription(subscription)
        self._inputs.clear()

    def _warm_up(self) -> None:
        assert self.bundle is not None and self.driver is not None
        height, width = self.bundle.config.image_size
        blank = np.zeros((height, width, 3), np.uint8)
        imu, odometry = ImuSample(0, (0.0, 0.0, 9.81), (0.0,) * 3), OdometrySample(0, 0, 0, 0, 0, 0)
        frame = SensorFrame(0, {c.name: blank for c in self.bundle.rig}, imu, odometry)
        for _ in range(3):
            self.driver.drive(frame, Route(0, np.array([[0.0, 0.0], [25.0, 0.0]])))
        self.driver.reset()

    # -- inputs -----------------------------------------------------------------------------------

    def _keep(self, store: dict[str, Any], camera: str) -> Any:
        def callback(message: Any) -> None:
            store[camera] = message

        return callback

    def _on_route(self, message: Any) -> None:
        self.route = self._checked(route_from_message, message, 'route') or self.route

    def _on_imu(self, message: Any) -> None:
        sample = self._checked(imu_from_message, message, 'imu')
        if sample is not None and self.monitor.heard('imu', sample.stamp_ns):
            self.monitor.imu(sample)
            self._decide(self.assembler.add_imu(sample))

    def _on_odometry(self, message: Any) -> None:
        sample = self._checked(odometry_from_message, message, 'odometry')
        if sample is not None and self.monitor.heard('odometry', sample.stamp_ns):
            self._decide(self.assembler.add_odometry(sample))

    def _image_callback(self, camera: str) -> Any:
        convert = image_from_compressed_message if self.compressed else image_from_message

        def callback(message: Any) -> None:
            image = self._checked(convert, message, camera)
            stamp = stamp_ns(message.header.stamp)
            if image is not None and self.monitor.heard(camera, stamp):
                self._decide(self.assembler.add_image(camera, stamp, image))

        return callback

    def _checked(self, convert: Any, message: Any, name: str) -> Any:
        """A converted message, or None for one that breaks its contract: logged, counted, not used."""
        try:
            return convert(message)
        except ContractError as error:
            self._refuse(name, str(error))
            return None

    def _refuse(self, name: str, why: str) -> None:
        self.refused += 1
        self.monitor.refused(name, why, self.get_clock().now().nanoseconds)
        self.get_logger().error(f'{name} refused: {why}', throttle_duration_sec=1.0)

    def _on_jump(self, jump: Any) -> None:
        """ROS time went back: start anew, as after activation."""
        self.get_logger().warning(f'ROS time went back by {-jump.delta.nanoseconds * 1e-9:.1f} s; starting anew')
        if self.bundle is None or not self._inputs:
            return
        self.assembler.reset()
        self.monitor.reset()
        self.monitor.start(self.get_clock().now().nanoseconds)
        self.answered = None

    def _watch(self) -> None:
        """Silence has no callback of its own. What is wrong is logged when it changes."""
        if not self._inputs:
            return
        found = self.monitor.findings(self.get_clock().now().nanoseconds)
        if [f.cause.split(':')[0] for f in found] != [f.cause.split(':')[0] for f in self.found]:
            for finding in found:
                self.get_logger().warning(f'{finding.health.name.lower()}: {finding.cause}; {finding.remedy}')
            self.found = found
            self.diagnostics.publish()
        self.found = found

    def _decide(self, frame: SensorFrame | None) -> None:
        if frame is None or self.driver is None or self.route is None:
            return
        if self.answered is not None and self.answered.stamp_ns == frame.stamp_ns:
            # The same tick again: its answer was lost. Deciding twice would move the recurrent state twice.
            self.output.publish(decision_to_message(self.factory, self.answered))
            return
        self.monitor.frame(frame)
        self._watch()
        if self.found and self.found[0].health is Health.STOP:
            # Silence is the safe answer: the gate stops the car.
            return
        try:
            if not self.rig_checked:
                self._check_cameras()
            decision = self.driver.drive(frame, self.route)
        except (ContractError, BundleError) as error:
            self.failure = str(error)
            self.get_logger().error(self.failure, throttle_duration_sec=1.0)
            return
        self.answered = decision
        self.latency_ms.append(decision.inference_ms)
        self.output.publish(decision_to_message(self.factory, decision))

    def _check_cameras(self) -> None:
        """Raises BundleError until every camera's calibration is known and equals the bundle's."""
        assert self.bundle is not None
        missing = [c for c in self.assembler.cameras if c not in self.infos or c not in self.extrinsics]
        if missing:
            raise BundleError(f'no calibration yet for {", ".join(missing)}')
        rig: tuple[CameraCalibration, ...] = tuple(
            calibration_from_messages(c, self.infos[c], self.extrinsics[c]) for c in self.assembler.cameras
        )
        check_rig(self.bundle, rig)
        self.rig_checked, self.failure = True, ''

    # -- reporting --------------------------------------------------------------------------------

    def figures(self) -> dict[str, Any]:
        """Latency of sensor frame to decision in this process, and what was lost."""
        p50, p99 = np.percentile(self.latency_ms, [50, 99]) if self.latency_ms else (None, None)
        return {
            'planner_ms': {'p50': p50, 'p99': p99},
            'decisions': len(self.latency_ms),
            'messages_lost': self.losses.total,
            'inputs_refused': self.refused,
        }

    def _describe(self) -> tuple[int, str, dict[str, Any]]:
        worst = self.found[0].health if self.found else Health.NOMINAL
        values = self.figures() | {'bundle': self.bundle.identity if self.bundle else 'none'}
        values |= {'sensors': worst.name.lower(), **self.monitor_counts()}
        for number, finding in enumerate(self.found):
            values[f'cause_{number}'], values[f'remedy_{number}'] = finding.cause, finding.remedy
        if worst is not Health.NOMINAL:
            level = ERROR if worst is Health.STOP else WARN
            return level, f'{worst.name.lower()}: {self.found[0].cause}', values
        if self.failure:
            return ERROR, self.failure, values
        if self.losses.total:
            return WARN, f'{self.losses.total} messages lost', values
        return OK, 'driving' if self.latency_ms else 'no frame yet', values

    def monitor_counts(self) -> dict[str, int]:
        return self.monitor.counts if self.bundle is not None else {}

    def close(self) -> None:
        if self.p['stats_file']:
            import json

            Path(self.p['stats_file']).write_text(json.dumps(self.figures()))


def main(args: list[str] | None = None) -> int:
    return run_node(PlannerNode, args)


if __name__ == '__main__':
    raise SystemExit(main())
