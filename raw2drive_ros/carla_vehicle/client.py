"""A car with cameras and IMU on a CARLA server in synchronous mode, ticked by this process at 20 Hz."""

from __future__ import annotations

import contextlib
import functools
from dataclasses import dataclass
from typing import Any

import numpy as np

from raw2drive_ros.carla_vehicle.collector import FrameCollector
from raw2drive_ros.carla_vehicle.geometry import (
    camera_placement,
    control_values,
    fov_deg,
    image_from_carla,
    imu_from_carla,
    odometry_from_carla,
)
from raw2drive_ros.carla_vehicle.route import follow_lanes
from raw2drive_ros.contracts.errors import CarlaError
from raw2drive_ros.contracts.public import CameraCalibration, Control, ImuSample, OdometrySample, Route, SensorFrame
from raw2drive_ros.tables.rates import PHYSICS_HZ, SUBSTEPS

ROUTE_SPACING_M = 30.0


@dataclass(frozen=True, slots=True)
class CarlaSettings:
    """town: '' keeps the loaded map. vehicle: blueprint id. spawn_point: index on the map. route_m: the route's length.

    seed: of the choices at junctions. imu_x_m: position of the IMU in `base_link`.
    """

    host: str = 'localhost'
    port: int = 2000
    timeout_s: float = 20.0
    town: str = ''
    vehicle: str = 'vehicle.lincoln.mkz_2020'
    spawn_point: int = 0
    route_m: float = 600.0
    seed: int = 0
    imu_x_m: float = 0.0


@dataclass(frozen=True, slots=True)
class CarlaTick:
    """All data of one decision tick, with the attributes that `evaluation.tick_messages` reads."""

    stamp_ns: int
    sensors: SensorFrame
    imu_samples: tuple[ImuSample, ...]
    odometry_samples: tuple[OdometrySample, ...]
    route: Route


class CarlaVehicle:
    """A context manager: on exit it destroys the actors that it spawned and restores the server's settings."""

    def __init__(self, settings: CarlaSettings, rig: tuple[CameraCalibration, ...]) -> None:
        """Raises CarlaError without the package or a server, or where the car cannot be spawned."""
        self.settings, self.rig = settings, rig
        self.carla = import_carla()
        for camera in rig:
            fov_deg(camera.intrinsics, camera.width, camera.height)
        self.actors: list[Any] = []
        try:
            self.client = self.carla.Client(settings.host, settings.port)
            self.client.set_timeout(settings.timeout_s)
            self.world = self.client.load_world(settings.town) if settings.town else self.client.get_world()
        except RuntimeError as error:
            raise CarlaError(
                f'no CARLA server at {settings.host}:{settings.port}: {str(error).rstrip(".")} '
                '(start CarlaUE4.sh -RenderOffScreen, or give --host and --port)'
            ) from error
        self.versions = (self.client.get_client_version(), self.client.get_server_version())
        self.before = self.world.get_settings()
        self.collector = FrameCollector(('imu', *(camera.name for camera in rig)), settings.timeout_s)
        try:
            self._make()
        except BaseException:
            # Also on Ctrl-C: a server that stays in synchronous mode waits for ever.
            self.close()
            raise

    def __enter__(self) -> CarlaVehicle:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()

    def _make(self) -> None:
        asked = self.world.get_settings()
        asked.synchronous_mode, asked.fixed_delta_seconds = True, 1.0 / PHYSICS_HZ
        self.world.apply_settings(asked)
        plans, places = self.world.get_blueprint_library(), self.world.get_map().get_spawn_points()
        if not 0 <= self.settings.spawn_point < len(places):
            raise CarlaError(f'spawn point {self.settings.spawn_point}: this map has 0 to {len(places) - 1}')
        try:
            car = plans.find(self.settings.vehicle)
        except IndexError as error:
            raise CarlaError(f'this server has no vehicle {self.settings.vehicle!r}') from error
        place = places[self.settings.spawn_point]
        self.car = self.world.try_spawn_actor(car, place)
        if self.car is None:
            raise CarlaError(f'something stands at spawn point {self.settings.spawn_point}: choose another')
        self.actors.append(self.car)
        for camera in self.rig:
            plan = plans.find('sensor.camera.rgb')
            view = fov_deg(camera.intrinsics, camera.width, camera.height)
            for key, value in (('image_size_x', camera.width), ('image_size_y', camera.height), ('fov', view)):
                plan.set_attribute(key, str(value))
            self._mount(camera.name, plan, *camera_placement(camera.base_from_camera))
        at = (self.settings.imu_x_m, 0.0, 0.0)
        self._mount('imu', plans.find('sensor.other.imu'), at, (0.0, 0.0, 0.0))
        # The car appears in the world with the next tick; until then its transform is the origin.
        self._advance()
        waypoint = self.world.get_map().get_waypoint(place.location)
        rng = np.random.default_rng(self.settings.seed)
        self.points = follow_lanes(waypoint, self.settings.route_m, ROUTE_SPACING_M, rng)
        self.route = Route(self.stamp_ns + 1, self.points).validate()

    def _mount(self, name: str, plan: Any, at: tuple[float, ...], turn: tuple[float, ...]) -> None:
        carla = self.carla
        transform = carla.Transform(carla.Location(*at), carla.Rotation(*turn))
        sensor = self.world.spawn_actor(plan, transform, attach_to=self.car)
        self.actors.append(sensor)
        sensor.listen(functools.partial(self._measured, name))

    def _measured(self, name: str, measurement: Any) -> None:
        self.collector.put(name, int(measurement.frame), measurement)

    def _advance(self) -> tuple[dict[str, Any], ImuSample, OdometrySample]:
        """One physics tick: (measurements by sensor, IMU sample, odometry sample)."""
        try:
            frame = self.world.tick(self.settings.timeout_s)
        except RuntimeError as error:
            raise CarlaError(f'the CARLA server no longer answers: {error}') from error
        found = self.collector.take(frame)
        self.stamp_ns = round(self.world.get_snapshot().timestamp.elapsed_seconds * 1e9)
        imu = imu_from_carla(self.stamp_ns, found['imu'].accelerometer, found['imu'].gyroscope)
        car = self.car
        odometry = odometry_from_carla(
            self.stamp_ns, car.get_transform().get_matrix(), car.get_velocity(), car.get_angular_velocity()
        )
        return found, imu, odometry

    def step(self, control: Control) -> CarlaTick:
        """The next decision tick, after `SUBSTEPS` physics ticks. Raises CarlaError, SensorTimeoutError."""
        self.car.apply_control(self.carla.VehicleControl(**control_values(control)))
        samples = []
        for _ in range(SUBSTEPS):
            found, imu, odometry = self._advance()
            samples.append((imu, odometry))
        images = {c.name: image_from_carla(found[c.name].raw_data, c.width, c.height) for c in self.rig}
        frame = SensorFrame(self.stamp_ns, images, imu, odometry).validate()
        imus, odometries = zip(*samples)
        return CarlaTick(self.stamp_ns, frame, imus, odometries, self.route)

    def close(self) -> None:
        """Destroy the actors and restore the server's settings; ignores errors of a server that no longer answers."""
        for actor in reversed(self.actors):
            # An actor that cannot be destroyed must not prevent the rest of the cleanup.
            with contextlib.suppress(RuntimeError):
                if hasattr(actor, 'stop'):
                    actor.stop()
                actor.destroy()
        self.actors.clear()
        with contextlib.suppress(RuntimeError):
            self.world.apply_settings(self.before)


def import_carla() -> Any:
    """The package `carla`, imported when a server is wanted. Raises CarlaError where it is not installed."""
    try:
        import carla
    except ImportError as error:
        raise CarlaError(
            "the package carla is not installed: pip install 'raw2drive_ros[carla]', in the server's version"
        ) from error
    return carla
