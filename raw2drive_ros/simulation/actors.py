"""All actors but the ego: vehicles on paths, pedestrians, obstacles. Built on highway-env's vehicle classes."""

from __future__ import annotations

import copy
import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from highway_env.vehicle.behavior import IDMVehicle
from highway_env.vehicle.kinematics import Vehicle
from highway_env.vehicle.objects import Obstacle

from raw2drive_ros.contracts.public import Float64
from raw2drive_ros.simulation.draws import TRAINING
from raw2drive_ros.simulation.leaders import LOOK_AHEAD_M
from raw2drive_ros.simulation.looks import look_fields, size_m
from raw2drive_ros.simulation.path import Path, smooth_step
from raw2drive_ros.simulation.scripts import Meeting, Pacing, Script, ego_is_due

if TYPE_CHECKING:
    from raw2drive_ros.simulation.world import World

DOOR_OPENS_IN_S = 0.6
# A target speed below this means: stand still until a script sets a higher one.
CREEP_MPS = 0.05
EGO_HALF_WIDTH_M = 1.0
SIZE_SPREAD = 0.06


@dataclass(frozen=True, slots=True)
class Look:
    """Appearance of one actor. colour: index into `looks.PAINTS`. scale: factor on length and width."""

    body: str
    colour: int = 0
    scale: float = 1.0

    @staticmethod
    def draw(kind: str, rng: np.random.Generator, split: str = TRAINING) -> Look:
        """A look for an actor of `kind`, of the bodies and paints that `split` owns."""
        return Look(*look_fields(kind, split, rng, SIZE_SPREAD))

    def apply_to(self, actor: Vehicle | Obstacle) -> None:
        length, width, height = size_m(self.body)
        actor.body, actor.colour = self.body, self.colour
        actor.LENGTH, actor.WIDTH, actor.HEIGHT = length * self.scale, width * self.scale, height


class PathVehicle(Vehicle):
    """A vehicle on a fixed path: IDM behind the leading vehicle or obstacle on it, and before closed stop lines.

    ignores_traffic: reacts to nobody (a driver who violates the right of way). waits_at_m: (arc length, is it closed?)
    of its stop lines. steered: controls the speed instead of IDM, as long as it applies. gap_m, closing_mps: free gap
    to the leading actor on the path and closing speed; set by `leaders.find_leaders`.
    """

    def __init__(
        self,
        path: Path,
        s_m: float,
        speed_mps: float,
        target_speed_mps: float,
        kind: str = 'car',
        look: Look | None = None,
        scripts: tuple[Script, ...] = (),
        *,
        ignores_traffic: bool = False,
        waits_at_m: tuple[tuple[float, Callable[[World], bool]], ...] = (),
        lateral_m: float = 0.0,
        steered: Meeting | Pacing | None = None,
        has_priority: bool = False,
        time_gap_s: float = 1.2,
        ends_at_s_m: float = math.inf,
    ) -> None:
        x, y, yaw = path.pose(s_m, lateral_m)
        super().__init__(None, (x, y), yaw, speed_mps)
        self.path = path
        self.s_m = s_m
        self.target_speed = target_speed_mps
        self.kind = kind
        (look or Look(kind)).apply_to(self)
        # A script stores whether it has fired, so every vehicle needs copies of its own.
        self.scripts = [copy.copy(script) for script in scripts]
        self.ignores_traffic = ignores_traffic
        self.waits_at_m = waits_at_m
        self.base_lateral_m = self.lateral_m = lateral_m
        self.steered = steered
        self.has_priority = has_priority
        self.time_gap_s = time_gap_s
        self.ends_at_s_m = min(ends_at_s_m, path.length_m + 2.0)
        self.gap_m, self.closing_mps = math.inf, 0.0
        self.command_acceleration = 0.0
        self.gone = False

    def think(self, world: World) -> None:
        """Choose an acceleration from the state of the world before any actor moves in this step."""
        forced = None
        for script in self.scripts:
            if script.fired_at_s_m is None and script.fires(world, self):
                script.fired_at_s_m = self.s_m
            if script.fired_at_s_m is None:
                continue
            if script.target_speed_mps is not None:
                self.target_speed = script.target_speed_mps
            if (acceleration := script.acceleration(world, self.speed)) is not None:
                forced = acceleration
        if self.steered is not None and self.target_speed > CREEP_MPS:
            steered = self.steered.acceleration(world, self)
            forced = forced if steered is None else steered
        self.command_acceleration = self._idm(world) if forced is None else forced

    def _idm(self, world: World) -> float:
        v, wanted = self.speed, max(self.target_speed, 0.1)
        free = IDMVehicle.COMFORT_ACC_MAX * (1.0 - (v / wanted) ** 4)
        gap, closing = self.gap_m, self.closing_mps
        for stop_s, is_closed in self.waits_at_m:
            distance = stop_s - self.s_m - self.LENGTH / 2
            if 0.0 < distance < LOOK_AHEAD_M and is_closed(world) and distance < gap:
                gap, closing = distance + 2.0, v
        if gap >= LOOK_AHEAD_M:
            return max(free, IDMVehicle.COMFORT_ACC_MIN)
        comfort = math.sqrt(-IDMVehicle.COMFORT_ACC_MAX * IDMVehicle.COMFORT_ACC_MIN)
        wanted_gap = 3.0 + max(0.0, v * self.time_gap_s + v * closing / (2.0 * comfort))
        return max(free - IDMVehicle.COMFORT_ACC_MAX * (wanted_gap / max(gap, 0.1)) ** 2, -8.0)

    def step(self, dt: float) -> None:
        self.speed = max(0.0, self.speed + self.command_acceleration * dt)
        self.s_m += self.speed * dt
        self.lateral_m = self.base_lateral_m + sum(
            script.drift_m * smooth_step(self.s_m, script.fired_at_s_m, script.drift_over_m)
            for script in self.scripts
            if script.drift_m and script.fired_at_s_m is not None
        )
        ahead = self.path.pose(self.s_m, self.lateral_m)
        moved_x, moved_y = ahead[0] - self.position[0], ahead[1] - self.position[1]
        self.heading = ahead[2]
        drifting = self.lateral_m != self.base_lateral_m
        if drifting and math.hypot(moved_x, moved_y) > 0.05:
            self.heading = math.atan2(moved_y, moved_x)
        self.position[:] = ahead[:2]
        self.gone = self.s_m > self.ends_at_s_m


class Walker(Vehicle):
    """A pedestrian (or cyclist) who crosses the route from one lateral offset to another.

    Timed for a conflict with an ego that keeps its speed: `delay_s` before the ego's front bumper gets there, the
    pedestrian is `EGO_HALF_WIDTH_M` away from the route.
    """

    def __init__(
        self,
        route: Path,
        s_m: float,
        from_m: float,
        to_m: float,
        speed_mps: float,
        delay_s: float,
        kind: str = 'walker',
        look: Look | None = None,
    ) -> None:
        x, y, yaw = route.pose(s_m, from_m)
        heading = yaw + math.copysign(math.pi / 2, to_m - from_m)
        super().__init__(None, (x, y), heading, 0.0)
        self.kind = kind
        (look or Look(kind)).apply_to(self)
        self.route_s_m = s_m
        self.left_to_walk_m = abs(to_m - from_m)
        self.walk_speed = speed_mps
        self.lead_s = (abs(from_m) - EGO_HALF_WIDTH_M) / speed_mps + delay_s
        self.command_acceleration = 0.0
        self.gone = False

    def think(self, world: World) -> None:
        if self.speed == 0.0 and self.left_to_walk_m > 0 and ego_is_due(world, self.route_s_m, self.lead_s):
            self.speed = self.walk_speed

    def step(self, dt: float) -> None:
        step = min(self.speed * dt, self.left_to_walk_m)
        self.position[0] += step * math.cos(self.heading)
        self.position[1] += step * math.sin(self.heading)
        self.left_to_walk_m -= step
        if self.left_to_walk_m <= 0:
            self.speed = 0.0


class StandingObject(Obstacle):
    """A solid object that never moves: parked car, barrier or cone."""

    def __init__(self, x_m: float, y_m: float, yaw_rad: float, kind: str, look: Look | None = None) -> None:
        super().__init__(None, (x_m, y_m), yaw_rad, 0.0)
        self.kind = kind
        (look or Look(kind)).apply_to(self)
        self.command_acceleration = 0.0
        self.gone = False

    def think(self, world: World) -> None:
        """Does nothing: the object stands still."""

    def step(self, dt: float) -> None:
        """Does nothing: the object stands still."""


class CarDoor(StandingObject):
    """The door of a parked car: closed (inside the car's outline) until the ego is `trigger_m` away, then it opens."""

    def __init__(self, route: Path, s_m: float, hinge_m: float, trigger_m: float, look: Look | None = None) -> None:
        self.side = math.copysign(1.0, -hinge_m)
        self.shut_m, self.open_m = hinge_m - self.side * 0.5, hinge_m + self.side * 0.45
        x, y, yaw = route.pose(s_m, self.shut_m)
        super().__init__(x, y, yaw, 'door', look)
        self.route, self.route_s_m, self.trigger_m = route, s_m, trigger_m
        self.opening = False
        self.part = 0.0

    def think(self, world: World) -> None:
        ahead = self.route_s_m - world.route_s_m
        self.opening = self.opening or 0.0 < ahead < self.trigger_m

    def step(self, dt: float) -> None:
        if not self.opening or self.part >= 1.0:
            return
        self.part = min(1.0, self.part + dt / DOOR_OPENS_IN_S)
        lateral = self.shut_m + self.part * (self.open_m - self.shut_m)
        x, y, _ = self.route.pose(self.route_s_m, lateral)
        self.position[:] = (x, y)


Actor = PathVehicle | Walker | StandingObject


def fork_of(actor: Actor) -> Actor:
    """An independent copy of an actor for `World.fork`; immutable parts (paths, sizes) are shared."""
    if type(actor) is StandingObject:
        return actor
    fork = copy.copy(actor)
    fork.position = actor.position.copy()
    if isinstance(fork, PathVehicle):
        fork.scripts = [copy.copy(script) for script in fork.scripts]
    return fork


def corners_m(x: float, y: float, yaw: float, length: float, width: float) -> Float64:
    """(4, 2) corners of an oriented box, counter-clockwise from front left."""
    cos, sin = math.cos(yaw), math.sin(yaw)
    ax, ay = cos * length / 2, sin * length / 2
    bx, by = -sin * width / 2, cos * width / 2
    return np.array(
        [
            (x + ax + bx, y + ay + by),
            (x - ax + bx, y - ay + by),
            (x - ax - bx, y - ay - by),
            (x + ax - bx, y + ay - by),
        ]
    )


def boxes_overlap(a: Float64, b: Float64) -> bool:
    """Whether two oriented boxes, (4, 2) corners in order, intersect (separating axis theorem)."""
    for box in (a, b):
        for edge in (box[1] - box[0], box[2] - box[1]):
            axis = np.array((-edge[1], edge[0]))
            pa, pb = a @ axis, b @ axis
            if pa.max() < pb.min() or pb.max() < pa.min():
                return False
    return True
