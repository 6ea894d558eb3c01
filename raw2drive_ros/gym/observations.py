"""What an agent observes, as arrays in the spaces of gymnasium.

cameras: what a driver in a car may have. bev, vector: the simulator's own knowledge, for training and comparison.
bev_visible: of that only what the cameras have shown lately.
"""

from __future__ import annotations

import math
from typing import Any, Protocol

import gymnasium
import numpy as np
from gymnasium.spaces import Box, Dict, Space
from numpy.typing import NDArray

from raw2drive_ros.contracts.privileged import BEV_SHAPE
from raw2drive_ros.contracts.public import CameraCalibration
from raw2drive_ros.driving.preprocessing import RouteProgress, raw_vector
from raw2drive_ros.simulation.actors import Actor
from raw2drive_ros.simulation.bev import CLASS_OF
from raw2drive_ros.simulation.environment import DrivingEnv, Tick
from raw2drive_ros.simulation.privileged_view import ego_vector
from raw2drive_ros.simulation.world import World
from raw2drive_ros.tables.vector_layout import EGO_FIELDS, SIGNAL_FIELDS, SIGNAL_RANGE_M, VECTOR_FIELDS

Observation = Any
FloatArray = NDArray[np.float32]
# Largest absolute value of each field of `EGO_FIELDS`.
EGO_SCALES = (30.0, 1.0, 1.0, 1.0, 2.0, 10.0, math.pi)
# Points of the route ahead, and the nearest actors.
AHEAD_M = (2.5, 5.0, 10.0, 15.0, 20.0, 30.0, 40.0, 60.0)
ACTORS, RANGE_M = 12, 60.0
SIGNALS = ('light_green', 'light_yellow', 'light_red', 'light_distance', 'stop_sign', 'stop_sign_distance', 'limit')
ACTOR_FIELDS = ('present', 'x', 'y', 'cos', 'sin', 'vx', 'vy', 'length', 'width', 'person', 'cyclist', 'standing')
SPEED_MPS, LENGTH_M, WIDTH_M = 30.0, 15.0, 4.0
SIGNAL_SCALES = np.array(
    [SIGNAL_RANGE_M if n.endswith('distance_m') else SPEED_MPS if n.endswith('mps') else 1.0 for n in SIGNAL_FIELDS]
)
# Fields of the observation `vector`, in order; every value is divided by the field's scale and within [-1, 1].
VECTOR_NAMES = (
    *EGO_FIELDS,
    *SIGNALS,
    *(f'route_{ahead:g}m_{axis}' for ahead in AHEAD_M for axis in ('x', 'y')),
    *(f'actor_{i}_{name}' for i in range(ACTORS) for name in ACTOR_FIELDS),
)
# No sensor of a car measures more.
LARGEST = 1e3


class Observer(Protocol):
    """Makes the observations of one environment. cameras, bev, visibility: what the simulator has to make for it."""

    cameras: bool
    bev: bool
    visibility: bool
    space: Space[Any]

    def reset(self) -> None:
        """A new episode begins."""

    def see(self, env: DrivingEnv, tick: Tick) -> Observation:
        """The observation of a tick, in arrays that are not used again."""


class CameraObserver:
    """cameras: (6, H, W, 3) uint8 RGB in the order of the rig. vector: (10,) float32, the planner's own input: motion,
    then the next checkpoints in `base_link` / 25 m, see `VECTOR_FIELDS`."""

    cameras, bev, visibility = True, False, False

    def __init__(self, image_size: tuple[int, int], rig: tuple[CameraCalibration, ...]) -> None:
        self.names = [camera.name for camera in rig]
        self.space = Dict(
            cameras=Box(0, 255, (len(rig), *image_size, 3), np.uint8),
            vector=Box(-LARGEST, LARGEST, (len(VECTOR_FIELDS),), np.float32),
        )

    def reset(self) -> None:
        self.progress = RouteProgress()

    def see(self, env: DrivingEnv, tick: Tick) -> Observation:
        sensors = tick.sensors
        self.progress.update(tick.route, sensors.odometry)
        vector = raw_vector(sensors.imu, sensors.odometry, self.progress)
        images = np.stack([sensors.images[name] for name in self.names])
        return {'cameras': images, 'vector': np.clip(vector, -LARGEST, LARGEST)}


class BevObserver:
    """bev: (43, 128, 128) uint8 of 0 and 1, see `tables.bev_channels`. vector: the beginning of the observation
    `vector`, the ego's state and the signals ahead.

    seen: the masks hold of all that moves, lights and signs only what the cameras have shown within the last 2 s, and
    vector is the ego's state and `SIGNAL_FIELDS`, distances / 100 m and speeds / 30 m/s.
    """

    cameras, bev = False, True

    def __init__(self, *, seen: bool) -> None:
        self.visibility = seen
        self.size = len(EGO_FIELDS) + (len(SIGNAL_FIELDS) if seen else len(SIGNALS))
        self.space = Dict(
            bev=Box(0, 1, BEV_SHAPE, np.uint8),
            vector=Box(-1.0, 1.0, (self.size,), np.float32),
        )

    def reset(self) -> None:
        """There is no state to reset."""

    def see(self, env: DrivingEnv, tick: Tick) -> Observation:
        assert env.world is not None and tick.privileged is not None
        masks, signals = tick.privileged.bev, _signals(env.world)
        if self.visibility:
            assert tick.privileged.bev_visible is not None and tick.privileged.signals is not None
            masks, signals = tick.privileged.bev_visible, tick.privileged.signals / SIGNAL_SCALES
        vector = np.concatenate([_ego(env.world), signals])
        return {'bev': masks.astype(np.uint8), 'vector': _bounded(vector)}


class VectorObserver:
    """(174,) float32 in [-1, 1], in the order of `VECTOR_NAMES`: ego, signals, route ahead, nearest actors, the last
    two in `base_link`. Complete: it holds also what no camera shows."""

    cameras = bev = visibility = False

    def __init__(self) -> None:
        self.space = Box(-1.0, 1.0, (len(VECTOR_NAMES),), np.float32)

    def reset(self) -> None:
        """There is no state to reset."""

    def see(self, env: DrivingEnv, tick: Tick) -> Observation:
        assert env.world is not None
        world = env.world
        return _bounded(np.concatenate([_ego(world), _signals(world), _route(world), _actors(world)]))


OBSERVATIONS = ('cameras', 'bev', 'bev_visible', 'vector')


def observer_of(name: str, image_size: tuple[int, int], rig: tuple[CameraCalibration, ...]) -> Observer:
    """Raises gymnasium.error.Error for an unknown name."""
    if name == 'cameras':
        return CameraObserver(image_size, rig)
    if name in ('bev', 'bev_visible'):
        return BevObserver(seen=name == 'bev_visible')
    if name == 'vector':
        return VectorObserver()
    raise gymnasium.error.Error(f'observation {name!r} is none of {", ".join(OBSERVATIONS)}')


def _bounded(values: NDArray[np.float64]) -> FloatArray:
    return np.clip(values, -1.0, 1.0).astype(np.float32)


def _ego(world: World) -> NDArray[np.float64]:
    return ego_vector(world) / np.array(EGO_SCALES)


def _signals(world: World) -> NDArray[np.float64]:
    """(7,) in the order of `SIGNALS`: the next light and stop sign ahead on the route; distances / 60 m, 1 without."""
    values = np.zeros(len(SIGNALS))
    values[[3, 5]] = 1.0
    front = world.front_s_m
    lights = [(light.line_s_m - front, light.colour) for light in world.lights if light.line_s_m > front]
    if lights:
        distance, colour = min(lights)
        values[SIGNALS.index(f'light_{colour}')], values[3] = 1.0, distance / RANGE_M
    signs = [s.line_s_m - front for s in world.stop_signs if s.line_s_m > front and not s.obeyed]
    if signs:
        values[[4, 5]] = 1.0, min(signs) / RANGE_M
    values[6] = world.speed_limit_at(world.route_s_m) / SPEED_MPS
    return values


def _route(world: World) -> NDArray[np.float64]:
    """Points of the route ahead, in `base_link` / 60 m. Beyond the goal it is the goal's."""
    stations = [min(world.route_s_m + ahead, world.goal_s_m) for ahead in AHEAD_M]
    points = np.array([world.route.pose(s)[:2] for s in stations]) - world.ego.position
    return (_turned(points, world.ego.heading) / RANGE_M).ravel()


def _actors(world: World) -> NDArray[np.float64]:
    """The nearest actors within 60 m, nearest first; zeros where there are fewer."""
    rows = np.zeros((ACTORS, len(ACTOR_FIELDS)))
    offsets = world.positions[:-1] - world.ego.position
    distances = np.hypot(offsets[:, 0], offsets[:, 1])
    order = np.argsort(distances, kind='stable')[:ACTORS]
    order = order[distances[order] < RANGE_M]
    if not len(order):
        return rows.ravel()
    yaw = world.headings[order] - world.ego.heading
    speed = world.speeds[order] / SPEED_MPS
    rows[: len(order)] = np.column_stack(
        [
            np.ones(len(order)),
            _turned(offsets[order], world.ego.heading) / RANGE_M,
            np.cos(yaw),
            np.sin(yaw),
            speed * np.cos(yaw),
            speed * np.sin(yaw),
            world.half_lengths[order] * 2.0 / LENGTH_M,
            world.half_widths[order] * 2.0 / WIDTH_M,
            [_kind_of(world.actors[i]) for i in order.tolist()],
        ]
    )
    return rows.ravel()


def _kind_of(actor: Actor) -> tuple[float, float, float]:
    """person, cyclist, standing object; none of them for a vehicle."""
    group = CLASS_OF[actor.kind]
    return float(group == 'walker'), float(group == 'cyclist'), float(group == 'obstacle')


def _turned(points_m: NDArray[np.float64], yaw_rad: float) -> NDArray[np.float64]:
    """(N, 2) offsets in `map` -> in `base_link`."""
    cos, sin = math.cos(yaw_rad), math.sin(yaw_rad)
    return points_m @ np.array([[cos, -sin], [sin, cos]])
