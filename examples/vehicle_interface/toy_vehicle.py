"""A complete vehicle interface for a car that is not highway-env's: the file to copy for your own.

The plant is a kinematic bicycle with a limited steering rate; the cameras see a painted ground through pinholes. Stamps
are system time, as on a car. In three terminals:

    python examples/vehicle_interface/toy_vehicle.py
    raw2drive check-vehicle --allow-motion            # with nothing else running
    raw2drive drive                                   # the shipped policy, through the safety gate
"""

from __future__ import annotations

import argparse
import math
import time
from pathlib import Path

import cv2
import numpy as np
import yaml
from rclpy.node import Node

from msg_adapters.factory import RclpyFactory
from msg_adapters.sensors import (
    BASE_FRAME,
    IMU_FRAME,
    camera_info_to_message,
    fill_image,
    imu_to_message,
    new_image,
    odometry_to_message,
    optical_frame,
    route_to_message,
    transform_to_message,
)
from raw2drive_ros.contracts import topics
from raw2drive_ros.contracts.public import CameraCalibration, Control, Decision, ImuSample, OdometrySample, Route
from raw2drive_ros.driving.command_policy import CommandPolicy
from raw2drive_ros.nodes.command_port import CommandPort
from raw2drive_ros.nodes.quality import LossCounter, make_publisher
from raw2drive_ros.nodes.runtime import run_node, steady_clock
from raw2drive_ros.tables.rates import PHYSICS_HZ, ROUTE_HZ, SUBSTEPS
from raw2drive_ros.timing import load_timing

PIXELS_PER_M, GRAVITY_MPS2 = 8, 9.81
GROUND_M = (-40.0, -40.0, 240.0, 40.0)  # x_min, y_min, x_max, y_max in `map`
SKY, GRASS, ROAD, LINE = (150, 190, 230), (70, 110, 60), (90, 90, 95), (230, 230, 230)


def calibrations(settings: dict) -> list[CameraCalibration]:
    """Pinhole cameras from the YAML. Optical axes: z forward, x right, y down (REP-103)."""
    height, width = settings['camera_size']
    cameras = []
    for name, (x, y, z, yaw_deg, fov_deg) in settings['cameras'].items():
        focal = width / 2.0 / math.tan(math.radians(fov_deg) / 2.0)
        yaw = math.radians(yaw_deg)
        forward = np.array([math.cos(yaw), math.sin(yaw), 0.0])
        right, down = np.array([math.sin(yaw), -math.cos(yaw), 0.0]), np.array([0.0, 0.0, -1.0])
        pose = np.eye(4)
        pose[:3, :3], pose[:3, 3] = np.stack([right, down, forward], axis=1), (x, y, z)
        intrinsics = np.array([[focal, 0.0, width / 2.0], [0.0, focal, height / 2.0], [0.0, 0.0, 1.0]])
        cameras.append(CameraCalibration(name, width, height, intrinsics, pose).validate())
    return cameras


def painted_ground() -> np.ndarray:
    """A straight road with two lanes along x, from above: (y, x, 3) uint8 RGB over GROUND_M."""
    x0, y0, x1, y1 = GROUND_M
    ground = np.full((round((y1 - y0) * PIXELS_PER_M), round((x1 - x0) * PIXELS_PER_M), 3), GRASS, np.uint8)
    ground += np.random.default_rng(0).integers(0, 25, ground.shape[:2], np.uint8)[..., None]

    def row(y_m: float) -> int:
        return round((y_m - y0) * PIXELS_PER_M)

    ground[row(-1.9) : row(5.6)] = ROAD
    for y_m in (-1.75, 5.25):
        ground[row(y_m - 0.08) : row(y_m + 0.08)] = LINE
    for start in range(0, ground.shape[1], 6 * PIXELS_PER_M):
        ground[row(1.67) : row(1.83), start : start + 3 * PIXELS_PER_M] = LINE
    return ground


class Plant:
    """A kinematic bicycle in `map`: x, y (m), yaw (rad, left positive), speed (m/s).

    The wheel angle (rad) follows at a limited rate, the pedals act at once.
    """

    def __init__(self, settings: dict) -> None:
        self.s = settings
        self.x = self.y = self.yaw = self.speed = self.wheel = self.yaw_rate = self.acceleration = 0.0

    def step(self, control: Control, dt: float) -> None:
        s = self.s
        change = control.steer * s['max_steer_rad'] - self.wheel
        self.wheel += max(-s['steer_rate_radps'] * dt, min(s['steer_rate_radps'] * dt, change))
        drive = control.throttle * s['throttle_mps2'] * (-1.0 if control.reverse else 1.0)
        before, speed = self.speed, self.speed + drive * dt
        # Brake and friction reduce the speed and never reverse it.
        drag = (control.brake * s['brake_mps2'] + s['rolling_mps2']) * dt
        self.speed = math.copysign(max(0.0, abs(speed) - drag), speed)
        self.acceleration = (self.speed - before) / dt
        self.yaw_rate = self.speed * math.tan(self.wheel) / s['wheelbase_m']
        self.x += self.speed * math.cos(self.yaw) * dt
        self.y += self.speed * math.sin(self.yaw) * dt
        self.yaw = math.remainder(self.yaw + self.yaw_rate * dt, math.tau)

    def look(self, camera: CameraCalibration, ground: np.ndarray) -> np.ndarray:
        """(H, W, 3) RGB: the ground plane through the pinhole, sky above the horizon."""
        map_from_base = np.eye(4)
        c, s = math.cos(self.yaw), math.sin(self.yaw)
        map_from_base[:2, :2], map_from_base[:2, 3] = ((c, -s), (s, c)), (self.x, self.y)
        camera_from_map = np.linalg.inv(map_from_base @ camera.base_from_camera)
        # A point (x, y, 0) of the ground: its pixel is K [r1 r2 t] (x, y, 1).
        pixel_from_map = camera.intrinsics @ camera_from_map[:3, [0, 1, 3]]
        x0, y0 = GROUND_M[:2]
        map_from_texture = np.array([[1 / PIXELS_PER_M, 0.0, x0], [0.0, 1 / PIXELS_PER_M, y0], [0.0, 0.0, 1.0]])
        size = (camera.width, camera.height)
        image = cv2.warpPerspective(ground, pixel_from_map @ map_from_texture, size, borderValue=GRASS)
        image[: camera.height // 2 + 1] = SKY
        return image


class ToyVehicle(Node):
    """Publishes what docs/vehicle_interface.md asks for, obeys commands, and brakes when none comes."""

    def __init__(self, settings: dict) -> None:
        super().__init__('toy_vehicle')
        self.settings, self.plant, self.ground = settings, Plant(settings['vehicle']), painted_ground()
        self.cameras, self.factory = calibrations(settings), RclpyFactory()
        self.images = {c.name: new_image(self.factory, c.name, c.height, c.width) for c in self.cameras}
        timing = load_timing()
        self.commands = CommandPolicy(timing.command_hold_s, timing.command_brake)
        names = [topics.IMU, topics.ODOMETRY, topics.ROUTE, topics.IMU_EXTRINSICS]
        for camera in self.cameras:
            name = camera.name
            names += [topics.image_topic(name), topics.camera_info_topic(name), topics.extrinsics_topic(name)]
        self.outputs = {name: make_publisher(self, name) for name in names}
        self.port = CommandPort(self, self.commands, LossCounter(), self.on_command)
        self.ticks = 0
        self.started_ns = self.get_clock().now().nanoseconds
        self.publish_extrinsics()
        self.create_timer(1.0 / PHYSICS_HZ, self.tick, clock=steady_clock())

    def publish_extrinsics(self) -> None:
        """Mounting poses of cameras and IMU, latched."""
        stamp_ns = self.started_ns
        mounts = {topics.extrinsics_topic(c.name): (c.base_from_camera, optical_frame(c.name)) for c in self.cameras}
        imu = np.eye(4)
        imu[0, 3] = self.settings['vehicle']['imu_x_m']
        for topic, (pose, frame) in (mounts | {topics.IMU_EXTRINSICS: (imu, IMU_FRAME)}).items():
            self.outputs[topic].publish(transform_to_message(self.factory, pose, BASE_FRAME, frame, stamp_ns))

    def on_command(self, decision: Decision) -> None:
        """A command of the one gate; whatever else arrives, the port has refused, and `receiver.stopped` says why."""
        self.commands.accept(decision.control, time.monotonic_ns())

    def tick(self) -> None:
        now_ns = time.monotonic_ns()
        if self.port.receiver.stopped:
            control = self.port.receiver.brake()
        elif self.commands.last is not None and not self.commands.expired(now_ns):
            control = self.commands.last
        else:
            control = self.commands.missing(now_ns)
        self.plant.step(control, 1.0 / PHYSICS_HZ)
        stamp_ns = self.get_clock().now().nanoseconds
        self.publish_motion(stamp_ns)
        if self.ticks % SUBSTEPS == 0:
            self.port.report(stamp_ns, self.plant.speed)
            self.publish_cameras(stamp_ns)
        if self.ticks % (PHYSICS_HZ // ROUTE_HZ) == 0:
            route = Route(self.started_ns, np.array(self.settings['route_m']))
            self.outputs[topics.ROUTE].publish(route_to_message(self.factory, route))
        self.ticks += 1

    def publish_motion(self, stamp_ns: int) -> None:
        p = self.plant
        force = (p.acceleration, p.speed * p.yaw_rate, GRAVITY_MPS2)
        imu = ImuSample(stamp_ns, force, (0.0, 0.0, p.yaw_rate))
        odometry = OdometrySample(stamp_ns, p.x, p.y, p.yaw, p.speed, p.yaw_rate)
        self.outputs[topics.IMU].publish(imu_to_message(self.factory, imu))
        self.outputs[topics.ODOMETRY].publish(odometry_to_message(self.factory, odometry))

    def publish_cameras(self, stamp_ns: int) -> None:
        for camera in self.cameras:
            message = self.images[camera.name]
            fill_image(message, self.plant.look(camera, self.ground), stamp_ns)
            info = camera_info_to_message(self.factory, camera, stamp_ns)
            self.outputs[topics.camera_info_topic(camera.name)].publish(info)
            self.outputs[topics.image_topic(camera.name)].publish(message)


def main() -> int:
    """Run the vehicle and return the exit code."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    default = Path(__file__).with_suffix('.yaml')
    parser.add_argument('--settings', type=Path, default=default, help='YAML of car, cameras and route')
    options, rest = parser.parse_known_args()
    settings = yaml.safe_load(options.settings.read_text())
    return run_node(lambda: ToyVehicle(settings), rest or None)


if __name__ == '__main__':
    raise SystemExit(main())
