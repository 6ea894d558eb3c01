"""The example's car with one fault, driven by check-vehicle's programme in this process: no ROS, no wall clock."""

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from examples.vehicle_interface.toy_vehicle import GRAVITY_MPS2, Plant, calibrations, painted_ground
from msg_adapters.factory import RosbagsFactory
from msg_adapters.sensors import (
    BASE_FRAME,
    camera_info_to_message,
    fill_image,
    imu_to_message,
    new_image,
    odometry_to_message,
    optical_frame,
    route_to_message,
    transform_to_message,
)
from msg_adapters.stamps import set_stamp, stamp_ns
from raw2drive_ros.conformance.active import conclude, what_forbids_motion
from raw2drive_ros.conformance.collector import Collector
from raw2drive_ros.conformance.observation import Observation, TopicSeen, Verdict
from raw2drive_ros.conformance.passive import expected, judge
from raw2drive_ros.conformance.programme import Runner
from raw2drive_ros.contracts import topics
from raw2drive_ros.contracts.errors import ContractError, UnsafeError
from raw2drive_ros.contracts.public import CameraCalibration, Control, ImuSample, OdometrySample, Route
from raw2drive_ros.driving.command_policy import CommandPolicy
from raw2drive_ros.tables.rates import DECISION_HZ, PHYSICS_HZ
from raw2drive_ros.timing import load_timing

EXAMPLE = Path(__file__).resolve().parents[2] / 'examples' / 'vehicle_interface'
SETTINGS = yaml.safe_load((EXAMPLE / 'toy_vehicle.yaml').read_text())
# Divisible by every rate that a camera may have here.
TICK_HZ = 60
LISTEN_S = 2.0
Look = Callable[[CameraCalibration], np.ndarray]


@dataclass(frozen=True)
class Fault:
    """One thing that a stranger gets wrong, and what check-vehicle must call it.

    check, words: of the verdict that names it; severity: of that verdict. message: changes a message in place before it
    is published, given its topic. look: the picture that camera `name` sends, given a function that looks through any
    camera. control: what the car does of a command. topic: changes what the graph says of a topic.
    """

    name: str
    check: str
    words: str
    severity: str = 'error'
    message: Callable[[str, Any], None] | None = None
    look: Callable[[str, Look, dict[str, CameraCalibration]], np.ndarray] | None = None
    control: Callable[[Control], Control] | None = None
    delay_s: float = 0.0
    age_s: float = 0.0
    camera_hz: int = 10
    reliable: bool = True
    obeys_strangers: bool = False
    yaw_rad: float = 0.0


HEALTHY = Fault('healthy', '', '')


class PlantedPlant(Plant):
    """The example's plant and cameras with a fault."""

    def __init__(self, settings: dict, fault: Fault, cameras: list[CameraCalibration], hz: int) -> None:
        super().__init__(settings)
        self.fault, self.cameras = fault, {camera.name: camera for camera in cameras}
        self.yaw = fault.yaw_rad
        self.queue = deque([Control(0.0, 0.6, 0.0)] * round(fault.delay_s * hz))

    def step(self, control: Control, dt: float) -> None:
        self.queue.append(control)
        control = self.queue.popleft()
        super().step(self.fault.control(control) if self.fault.control else control, dt)

    def look(self, camera: CameraCalibration, ground: np.ndarray) -> np.ndarray:
        def through(any_camera: CameraCalibration) -> np.ndarray:
            return Plant.look(self, any_camera, ground)

        return self.fault.look(camera.name, through, self.cameras) if self.fault.look else through(camera)


class PlantedVehicle:
    """The example's car without ROS: `tick` publishes into `sink` (topic, message, time of arrival in ns)."""

    def __init__(self, fault: Fault, sink: Callable[[str, Any, int], None]) -> None:
        self.fault, self.sink, self.factory = fault, sink, RosbagsFactory()
        self.cameras = calibrations(SETTINGS)
        self.plant, self.ground = PlantedPlant(SETTINGS['vehicle'], fault, self.cameras, TICK_HZ), painted_ground()
        timing = load_timing()
        self.commands = CommandPolicy(timing.command_hold_s, timing.command_brake)
        self.ticks, self.now_ns = 0, 1_000_000_000
        self.images = {c.name: new_image(self.factory, c.name, c.height, c.width) for c in self.cameras}
        # Reused: making messages takes longer than anything else here.
        self.infos = {c.name: camera_info_to_message(self.factory, c, 1) for c in self.cameras}
        for camera in self.cameras:
            pose = transform_to_message(
                self.factory, camera.base_from_camera, BASE_FRAME, optical_frame(camera.name), 1
            )
            self._send(topics.extrinsics_topic(camera.name), pose)

    def command(self, control: Control, *, foreign: bool = False) -> None:
        if foreign and not self.fault.obeys_strangers:
            return
        try:
            self.commands.accept(control.validate(), self.now_ns)
        except ContractError:
            return

    def decide(self) -> None:
        for _ in range(TICK_HZ // DECISION_HZ):
            self.tick()

    def tick(self) -> None:
        expired = self.commands.last is None or self.commands.expired(self.now_ns)
        control = self.commands.missing(self.now_ns) if expired else self.commands.last
        self.plant.step(control, 1.0 / TICK_HZ)
        self.now_ns += round(1e9 / TICK_HZ)
        self.ticks += 1
        if self.ticks % (TICK_HZ // PHYSICS_HZ) == 0:
            self._publish_motion()
        if self.ticks % (TICK_HZ // self.fault.camera_hz) == 0:
            self._publish_cameras()
        if self.ticks % TICK_HZ == 0:
            self._send(topics.ROUTE, route_to_message(self.factory, Route(1, np.array(SETTINGS['route_m']))))

    def _publish_motion(self) -> None:
        p, now = self.plant, self.now_ns
        force = (p.acceleration, p.speed * p.yaw_rate, GRAVITY_MPS2)
        self._send(topics.IMU, imu_to_message(self.factory, ImuSample(now, force, (0.0, 0.0, p.yaw_rate))))
        sample = OdometrySample(now, p.x, p.y, p.yaw, p.speed, p.yaw_rate)
        self._send(topics.ODOMETRY, odometry_to_message(self.factory, sample))

    def _publish_cameras(self) -> None:
        for camera in self.cameras:
            set_stamp(self.infos[camera.name].header.stamp, self.now_ns)
            self._send(topics.camera_info_topic(camera.name), self.infos[camera.name])
            # A car that stands sees what it saw: rendering it again only costs time.
            if abs(self.plant.speed) > 0.05 or self.ticks < TICK_HZ:
                fill_image(self.images[camera.name], self.plant.look(camera, self.ground), self.now_ns)
            set_stamp(self.images[camera.name].header.stamp, self.now_ns)
            self._send(topics.image_topic(camera.name), self.images[camera.name])

    def _send(self, topic: str, message: Any) -> None:
        stamp = stamp_ns(message.header.stamp)
        if topics.BY_NAME[topic].rate_hz and not topics.BY_NAME[topic].qos.latched:
            set_stamp(message.header.stamp, stamp - round(self.fault.age_s * 1e9))
        if self.fault.message is not None:
            self.fault.message(topic, message)
        self.sink(topic, message, self.now_ns)


def check(fault: Fault, *, motion: bool = True) -> list[Verdict]:
    """All verdicts of check-vehicle on a car with this fault."""
    collector = Collector(LISTEN_S)
    graph_says(collector.seen, fault)
    vehicle = PlantedVehicle(fault, collector.note)
    for _ in range(round(LISTEN_S * TICK_HZ)):
        vehicle.tick()
    rig = tuple(vehicle.cameras)
    listened = judge(collector.seen, rig)
    given_up = []
    if motion and not what_forbids_motion(listened):
        given_up = drive_with(vehicle, collector)
    return conclude(collector.seen, listened, given_up)


def graph_says(seen: Observation, fault: Fault) -> None:
    """What the graph would tell of the car's topics."""
    seen.command_subscribers = 1
    for name in expected(topics.CAMERAS, compressed=False):
        spec = topics.BY_NAME[name]
        seen.topics[name] = TopicSeen((spec.msgtype,), 1, fault.reliable or spec.qos.latched, spec.qos.latched)


def drive_with(vehicle: Any, collector: Collector) -> list[Verdict]:
    """The programme of --allow-motion, as the probe sends it; `vehicle.decide` lets a decision's time pass. Returns
    why it was given up, if it was."""
    runner = Runner(collector.seen)
    try:
        while (step := runner.order(collector.seen.odometry[-1].stamp_ns)) is not None:
            if step.control is not None:
                vehicle.command(step.control)
            if step.foreign is not None:
                vehicle.command(step.foreign, foreign=True)
            vehicle.decide()
    except UnsafeError as error:
        return [Verdict('motion', 'error', f'given up: {error}', 'mend that first')]
    return []
