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
from raw2drive_ros.simulation.car_following import COMFORT_MPS2, drift_length_m, follow, needed_mps2
from raw2drive_ros.simulation.draws import TRAINING
from raw2drive_ros.simulation.leaders import LOOK_AHEAD_M
from raw2drive_ros.simulation.looks import look_fields, size_m
from raw2drive_ros.simulation.path import SPACING_M, Path, smooth_step
from raw2drive_ros.simulation.scripts import Meeting, Pacing, Script, ego_is_due

if TYPE_CHECKING:
    from raw2drive_ros.simulation.courses import Course
    from raw2drive_ros.simulation.world import World

DOOR_OPENS_IN_S = 0.6
# A target speed below this means: stand still until a script sets a higher one.
CREEP_MPS = 0.05
EGO_HALF_WIDTH_M = 1.0
BRAKE_LAMP_MPS2 = -0.7
# Nobody walks into a vehicle: the step that is looked at.
STEP_AHEAD_M = 0.6
# A vehicle indicates a turn from here on.
INDICATE_M = 40.0
SIZE_SPREAD = 0.06


@dataclass(frozen=True, slots=True)
class Look:
    """Appearance of one actor. colour: index into `looks.PAINTS`. scale: factor on length and width."""

    body: str
    colour: int = 0
    scale: float = 1.0

    @property
    def length_m(self) -> float:
        """Length of the body, scaled."""
        return size_m(self.body)[0] * self.scale

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

    It chooses an acceleration at the decision rate. ignores_traffic: reacts to nobody (a driver who violates the right
    of way). ignores_ego: reacts to everybody but a moving ego. waits_at_m: (arc length, is it closed?) of its stop
    lines. steered: controls the speed instead of IDM, as long as it applies. course: the lanes that it follows, with
    the junctions on the way, where `right_of_way` sets `stop_at_m`. yields: it keeps to the rules of right of way;
    otherwise all others wait for it. number: unique in its world.

    Set by `leaders.find_leaders`: gap_m, closing_mps, leader_row: free gap to the leading actor on the path, closing
    speed, and its row in the world's arrays; others_gap_m, others_closing_mps: the same without the ego.
    indicator: left, right or ''. imposed_mps2: deceleration that only the ego makes it need (m/s2, 0 without).
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
        ignores_ego: bool = False,
        waits_at_m: tuple[tuple[float, Callable[[World], bool]], ...] = (),
        lateral_m: float = 0.0,
        steered: Meeting | Pacing | None = None,
        has_priority: bool = False,
        time_gap_s: float = 1.2,
        ends_at_s_m: float = math.inf,
        course: Course | None = None,
        yields: bool = True,
        obeys_lights: bool = True,
    ) -> None:
        x, y, yaw = path.pose(s_m, lateral_m)
        super().__init__(None, (x, y), yaw, speed_mps)
        self.number = -1
        self.path, self.course = path, course
        self.s_m = s_m
        self.target_speed = target_speed_mps
        self.kind = kind
        (look or Look(kind)).apply_to(self)
        # A script stores whether it has fired, so every vehicle needs copies of its own.
        self.scripts = [copy.copy(script) for script in scripts]
        self.ignores_traffic, self.ignores_ego = ignores_traffic, ignores_ego
        self.waits_at_m = waits_at_m
        self.base_lateral_m = self.lateral_m = lateral_m
        self.steered = steered
        self.has_priority, self.yields, self.obeys_lights = has_priority, yields, obeys_lights
        self.time_gap_s = time_gap_s
        self.ends_at_s_m = min(ends_at_s_m, path.length_m + 2.0)
        self.gap_m, self.closing_mps, self.leader_row = math.inf, 0.0, -1
        self.others_gap_m, self.others_closing_mps = math.inf, 0.0
        self.stop_at_m, self.next_crossing, self.has_leave, self.waited_s = math.inf, 0, False, 0.0
        self.command_acceleration = 0.0
        self.imposed_mps2 = 0.0
        self.indicator = ''
        self.leaves_in_sight = course is None
        self.gone = False

    @property
    def braking(self) -> bool:
        """Whether its brake lamps are lit."""
        return self.command_acceleration < BRAKE_LAMP_MPS2 or self.speed < CREEP_MPS

    def think(self, world: World) -> None:
        """Choose an acceleration from the state of the world before any actor moves in this step."""
        forced = None
        signalled = ''
        for script in self.scripts:
            if script.fired_at_s_m is None and script.fires(world, self):
                script.fired_at_s_m = self.s_m
                script.reach_m = max(script.drift_over_m, drift_length_m(script.drift_m, self.speed))
            if script.due_s is not None and (script.indicator or script.drift_m):
                signalled = self._signal_of(script) or signalled
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
        self.imposed_mps2 = self._imposed(len(world.actors)) if forced is None else 0.0
        self.indicator = signalled or self._turning()

    def _signal_of(self, script: Script) -> str:
        """What a script shows from its trigger until its drift is over."""
        done = script.fired_at_s_m is not None and self.s_m > script.fired_at_s_m + script.reach_m
        if script.drift_m and done:
            return ''
        return script.indicator or ('left' if script.drift_m > 0.0 else 'right')

    def _turning(self) -> str:
        """The side that it turns to at a junction within `INDICATE_M`."""
        if self.course is None:
            return ''
        for crossing in self.course.crossings[self.next_crossing : self.next_crossing + 2]:
            if crossing.enter_s_m - self.s_m > INDICATE_M:
                break
            if self.s_m < crossing.leave_s_m and crossing.turn != 'ahead':
                return crossing.turn
        return ''

    def _idm(self, world: World) -> float:
        v, wanted = self.speed, max(self.target_speed, 0.1)
        if self.course is not None:
            allowed = self.course.speeds_mps
            wanted = min(wanted, allowed[min(max(int((self.s_m + 0.3 * v) / SPACING_M), 0), len(allowed) - 1)])
        free = IDMVehicle.COMFORT_ACC_MAX * (1.0 - (v / wanted) ** 4)
        gap, closing = self.gap_m, self.closing_mps
        for stop_s, is_closed in self.waits_at_m:
            distance = stop_s - self.s_m - self.LENGTH / 2
            if 0.0 < distance < LOOK_AHEAD_M and is_closed(world) and distance < gap:
                gap, closing = distance + 2.0, v
        distance = self.stop_at_m - self.s_m - self.LENGTH / 2
        if distance + 2.0 < gap:
            gap, closing = max(distance, 0.0) + 2.0, v
        return follow(v, free, gap, closing, self.time_gap_s)

    def _imposed(self, ego_row: int) -> float:
        """The deceleration that it takes to stay behind the ego, where nobody else asks for it."""
        if self.leader_row != ego_row or self.command_acceleration > -COMFORT_MPS2 or self.closing_mps <= 0.0:
            return 0.0
        own = needed_mps2(self.gap_m, self.closing_mps)
        if self.stop_at_m < math.inf:
            own -= needed_mps2(self.stop_at_m - self.s_m - self.LENGTH / 2 + 1.0, self.speed)
        if self.others_closing_mps > 0.0:
            own -= needed_mps2(self.others_gap_m, self.others_closing_mps)
        return max(0.0, own)

    def step(self, dt: float) -> None:
        self.speed = max(0.0, self.speed + self.command_acceleration * dt)
        self.s_m += self.speed * dt
        drifting = False
        if self.scripts:
            self.lateral_m = self.base_lateral_m + sum(
                script.drift_m * smooth_step(self.s_m, script.fired_at_s_m, script.reach_m)
                for script in self.scripts
                if script.drift_m and script.fired_at_s_m is not None
            )
            drifting = self.lateral_m != self.base_lateral_m
        x, y, yaw = self.path.pose(self.s_m, self.lateral_m)
        if drifting:
            moved_x, moved_y = x - self.position[0], y - self.position[1]
            if math.hypot(moved_x, moved_y) > 0.05:
                yaw = math.atan2(moved_y, moved_x)
        self.heading = yaw
        self.position[0], self.position[1] = x, y
        self.gone = self.s_m > self.ends_at_s_m and self.leaves_in_sight


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
        self.started = False
        self.lead_s = (abs(from_m) - EGO_HALF_WIDTH_M) / speed_mps + delay_s
        self.number = -1
        self.command_acceleration = 0.0
        self.gone = False

    def think(self, world: World) -> None:
        self.started = self.started or ego_is_due(world, self.route_s_m, self.lead_s)
        walks = self.started and self.left_to_walk_m > 0.0 and not self._is_barred(world)
        self.speed = self.walk_speed if walks else 0.0

    def _is_barred(self, world: World) -> bool:
        """Whether a vehicle that is not the ego's is right in front."""
        x = float(self.position[0]) + STEP_AHEAD_M * math.cos(self.heading)
        y = float(self.position[1]) + STEP_AHEAD_M * math.sin(self.heading)
        for other in world.actors:
            dx, dy = float(other.position[0]) - x, float(other.position[1]) - y
            if abs(dx) < 4.0 and abs(dy) < 4.0 and isinstance(other, PathVehicle):
                cos, sin = math.cos(other.heading), math.sin(other.heading)
                along, across = abs(dx * cos + dy * sin), abs(dy * cos - dx * sin)
                if along < (other.LENGTH + self.WIDTH) / 2 and across < (other.WIDTH + self.WIDTH) / 2:
                    return True
        return False

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
        self.number = -1
        self.kind = kind
        (look or Look(kind)).apply_to(self)
        self.command_acceleration = 0.0
        self.gone = False

    def think(self, world: World) -> None:
        """Does nothing: the object stands still."""

    def step(self, dt: float) -> None:
        """Does nothing: the object stands still."""


class CarDoor(StandingObject):
    """The door of a parked car: closed (inside the car's outline) until the ego is due within `due_s`, then it opens;
    never with 0."""

    def __init__(self, route: Path, s_m: float, hinge_m: float, due_s: float, look: Look | None = None) -> None:
        self.side = math.copysign(1.0, -hinge_m)
        self.shut_m, self.open_m = hinge_m - self.side * 0.5, hinge_m + self.side * 0.45
        x, y, yaw = route.pose(s_m, self.shut_m)
        super().__init__(x, y, yaw, 'door', look)
        self.route, self.route_s_m, self.due_s = route, s_m, due_s
        self.opening = False
        self.part = 0.0

    def think(self, world: World) -> None:
        self.opening = self.opening or (self.due_s > 0.0 and ego_is_due(world, self.route_s_m, self.due_s))

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
