"""Drives with a class that a user has written, see `driving.driver_class`.

The class runs in a process of its own and is sent the sensors that it declares, and nothing else: no object of the
simulator is reachable from it, and modules that could build one are blocked there. A class that declares `privileged`
runs in this process and gets the world; its results say so.
"""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from raw2drive_ros.artifact import hash_of_file
from raw2drive_ros.contracts.errors import DriverFailedError
from raw2drive_ros.contracts.public import CameraCalibration, Control, Decision, SensorFrame
from raw2drive_ros.driving.driver_class import (
    PRIVILEGED,
    Sensors,
    arguments_of,
    command_of,
    described,
    find_class,
    make_instance,
)
from raw2drive_ros.evaluation.driver_process import DriverProcess
from raw2drive_ros.evaluation.episode_driver import EpisodeDriver
from raw2drive_ros.simulation.environment import DrivingEnv, Tick


def custom_driver(name: str, pairs: Sequence[str] = ()) -> EpisodeDriver:
    """The driver of class `name`, made with the arguments `pairs` ('key=value'). Raises DriverClassError."""
    arguments = arguments_of(pairs)
    process = DriverProcess(name, arguments)
    if PRIVILEGED in process.sensors:
        return PrivilegedClassDriver(name, arguments, process.sensors)
    return HostedDriver(process, arguments)


def custom_label(name: str) -> str:
    """The name of a class, with `(privileged)` after it where it may see the simulator. Raises DriverClassError."""
    return _label(name, DriverProcess(name, None).sensors)


def _label(name: str, sensors: Sequence[str]) -> str:
    return f'{name} (privileged)' if PRIVILEGED in sensors else name


def custom_identity(name: str, pairs: Sequence[str] = ()) -> str:
    """For headers of results: label of the class, a hash of its file, its arguments, files among them as hashes, and
    its sensors. Raises DriverClassError."""
    declared = DriverProcess(name, None)
    sensors = declared.sensors
    arguments = [f'{key}={_hashed(value)}' for key, value in arguments_of(pairs).items()]
    return ' '.join((_label(name, sensors), declared.source[:12], *arguments, f'sensors={"+".join(sensors) or "none"}'))


def _hashed(value: object) -> str:
    path = Path(str(value))
    return f'sha256:{hash_of_file(path)[:16]}' if path.is_file() else str(value)


def opaque_seed(seed: int) -> int:
    """A seed for the class's own random numbers, which does not tell what route is driven."""
    return int.from_bytes(hashlib.sha256(f'driver {seed}'.encode()).digest()[:4], 'big')


class HostedDriver:
    """A class that sees sensors alone, in a process of its own. A process that has ended is started anew for the next
    drive."""

    needs_bev = False

    def __init__(self, process: DriverProcess, arguments: dict[str, Any]) -> None:
        self.process, self.arguments = process, arguments
        self.needs_cameras = 'cameras' in process.sensors

    def reset(self, seed: int) -> None:
        if not self.process.alive:
            self.process = DriverProcess(self.process.name, self.arguments)
        self.begins = True
        self.process.ask({'seed': opaque_seed(seed)})

    def control(self, env: DrivingEnv, frame: SensorFrame, tick: Tick) -> Decision:
        sensors = self.process.sensors
        request: dict[str, Any] = {'stamp_ns': frame.stamp_ns, 'has_route': 'route' in sensors}
        images = None
        if 'cameras' in sensors:
            request['images'] = {camera: image.shape for camera, image in frame.images.items()}
            images = b''.join(image.tobytes() for image in frame.images.values())
        if 'imu' in sensors:
            request['imu'] = [(s.stamp_ns, s.specific_force_mps2, s.angular_velocity_radps) for s in tick.imu_samples]
        if 'odometry' in sensors:
            o = frame.odometry
            request['odometry'] = (o.stamp_ns, o.x_m, o.y_m, o.yaw_rad, o.speed_mps, o.yaw_rate_radps)
        if self.begins:
            if 'cameras' in sensors:
                request['calibration'] = [_record(camera) for camera in env.rig]
            if 'route' in sensors:
                request['route'] = (tick.route.stamp_ns, tick.route.checkpoints_m.tolist())
            self.begins = False
        answer = self.process.ask(request, images)
        throttle, brake, steer, reverse = answer['control']
        return Decision(frame.stamp_ns, Control(throttle, brake, steer, reverse).validate(), answer['action'])


def _record(camera: CameraCalibration) -> dict[str, Any]:
    return {
        'name': camera.name,
        'width': camera.width,
        'height': camera.height,
        'intrinsics': camera.intrinsics.tolist(),
        'base_from_camera': camera.base_from_camera.tolist(),
    }


class PrivilegedClassDriver:
    """A class that declares `privileged`: in this process, with the world and the masks."""

    needs_bev = True

    def __init__(self, name: str, arguments: dict[str, Any], sensors: tuple[str, ...]) -> None:
        self.name, self.sensors = name, sensors
        self.needs_cameras = 'cameras' in sensors
        self.driver = make_instance(find_class(name), name, arguments)

    def reset(self, seed: int) -> None:
        self.begun_ns: int | None = None
        if hasattr(self.driver, 'reset'):
            self.driver.reset(opaque_seed(seed))

    def control(self, env: DrivingEnv, frame: SensorFrame, tick: Tick) -> Decision:
        self.begun_ns = frame.stamp_ns if self.begun_ns is None else self.begun_ns
        given: dict[str, Any] = {'world': env.world, 'privileged': tick.privileged}
        if 'cameras' in self.sensors:
            images = {camera: np.array(image) for camera, image in frame.images.items()}
            given |= {'images': images, 'calibration': {camera.name: camera for camera in env.rig}}
        if 'imu' in self.sensors:
            given |= {'imu': frame.imu, 'imu_samples': tick.imu_samples}
        if 'odometry' in self.sensors:
            given['odometry'] = frame.odometry
        if 'route' in self.sensors:
            given['route'] = tick.route
        try:
            answer = self.driver.drive(Sensors(frame.stamp_ns, (frame.stamp_ns - self.begun_ns) * 1e-9, given))
            control, action = command_of(answer)
        except Exception as error:
            why = str(error) if isinstance(error, DriverFailedError) else described(error)
            raise DriverFailedError(f'driver {self.name}: {why}') from error
        return Decision(frame.stamp_ns, control, action)
