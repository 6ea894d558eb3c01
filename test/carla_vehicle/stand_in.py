"""A stand-in for a CARLA server: answers the calls of our client, with CARLA's own types where they can be made.

Its car drives straight on, and it delivers images in a thread as a server does. Its measurements are not realistic.
"""

import threading
from types import SimpleNamespace

import carla
import numpy as np


class Actor:
    def __init__(self, world, name, transform) -> None:
        self.world, self.name, self.transform = world, name, transform
        self.callback, self.controls, self.alive = None, [], True

    def listen(self, callback) -> None:
        self.callback = callback

    def stop(self) -> None:
        self.callback = None

    def destroy(self) -> bool:
        if self.world.sticky == self.name:
            raise RuntimeError('time-out while waiting for the simulator')
        self.alive = False
        return True

    def apply_control(self, control) -> None:
        assert isinstance(control, carla.VehicleControl)
        self.controls.append(control)

    def get_transform(self):
        return self.transform

    def get_velocity(self):
        return carla.Vector3D(self.world.speed, 0.0, 0.0)

    def get_angular_velocity(self):
        return carla.Vector3D(0.0, 0.0, 0.0)


class Blueprint:
    def __init__(self, name) -> None:
        self.name, self.attributes = name, {}

    def set_attribute(self, key, value) -> None:
        assert isinstance(value, str)
        self.attributes[key] = value


class World:
    """silent: a sensor that delivers nothing. sticky: an actor that cannot be destroyed."""

    def __init__(self) -> None:
        self.settings, self.actors = carla.WorldSettings(), []
        self.frame, self.speed, self.silent, self.sticky = 100, 5.0, '', ''

    def get_settings(self):
        now = self.settings
        return carla.WorldSettings(now.synchronous_mode, now.no_rendering_mode, now.fixed_delta_seconds or 0.0)

    def apply_settings(self, settings) -> None:
        self.settings = settings

    def get_blueprint_library(self):
        def find(name):
            if name == 'vehicle.none':
                raise IndexError(name)
            return Blueprint(name)

        return SimpleNamespace(find=find)

    def get_map(self):
        place = carla.Transform(carla.Location(10.0, 20.0, 0.0), carla.Rotation(0.0, 0.0, 0.0))
        return SimpleNamespace(get_spawn_points=lambda: [place], get_waypoint=lambda at: Waypoint(at.x, at.y))

    def try_spawn_actor(self, blueprint, transform):
        return self.spawn_actor(blueprint, transform)

    def spawn_actor(self, blueprint, transform, attach_to=None):
        actor = Actor(self, blueprint.name, transform)
        actor.blueprint = blueprint
        self.actors.append(actor)
        return actor

    def tick(self, seconds) -> int:
        assert self.settings.synchronous_mode
        self.frame += 1
        car = self.actors[0]
        place = car.transform.location
        car.transform = carla.Transform(
            carla.Location(place.x + self.speed * 0.05, place.y, 0.0), car.transform.rotation
        )
        threading.Thread(target=self._report, args=(self.frame,)).start()
        return self.frame

    def _report(self, frame) -> None:
        for actor in self.actors[1:]:
            if actor.name == self.silent:
                continue
            if actor.name == 'sensor.other.imu':
                data = {'accelerometer': carla.Vector3D(0.0, 0.0, 9.81), 'gyroscope': carla.Vector3D(0.0, 0.0, 0.0)}
            else:
                width, height = (int(actor.blueprint.attributes[f'image_size_{axis}']) for axis in 'xy')
                pixels = np.random.default_rng(frame).integers(0, 255, (height, width, 4), np.uint8)
                data = {'raw_data': pixels.tobytes()}
            if actor.callback is not None:
                actor.callback(SimpleNamespace(frame=frame, **data))

    def get_snapshot(self):
        return SimpleNamespace(timestamp=SimpleNamespace(elapsed_seconds=self.frame * 0.05))


class Waypoint:
    road_id, lane_id = 1, -1

    def __init__(self, x, y) -> None:
        self.x, self.y = x, y
        self.transform = carla.Transform(carla.Location(x, y, 0.0), carla.Rotation(0.0, 0.0, 0.0))

    def next(self, distance):
        return [Waypoint(self.x + distance, self.y)] if self.x < 300.0 else []


class Client:
    world = None

    def __init__(self, host, port) -> None:
        Client.world = self.world or World()

    def set_timeout(self, seconds) -> None:
        pass

    def get_world(self):
        return self.world

    def get_client_version(self) -> str:
        return '0.9.16'

    def get_server_version(self) -> str:
        return '0.9.15'
