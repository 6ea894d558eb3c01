"""Worlds for tests of traffic, and what must never happen in them."""

import numpy as np

from raw2drive_ros.contracts.public import Control
from raw2drive_ros.evaluation.following import (
    idm_acceleration,
    leader,
    pedals,
    pursuit_steer,
    route_window,
    stop_line_m,
    stopping,
)
from raw2drive_ros.simulation.actors import PathVehicle, StandingObject, boxes_overlap, corners_m
from raw2drive_ros.simulation.draws import Draw
from raw2drive_ros.simulation.layout import Junction, RoadLayout, Straight
from raw2drive_ros.simulation.scenario import (
    ActorSpec,
    BackgroundSpec,
    LightSpec,
    RouteSpec,
    Scenario,
    Scene,
)
from raw2drive_ros.simulation.world import World

SIGHT_M = 80.0
# A whole cycle of the light that follows; half of it is green, amber or clearance for either road.
CYCLE = (('red', 20.0), ('green', 10.0))


def world_of(scene: Scene, seed: int = 0) -> World:
    return World(Scenario('Traffic', (), lambda draw: scene), Draw('Traffic', seed))


def junction_world(
    control: str = 'none',
    seed: int = 0,
    actors: tuple[ActorSpec, ...] = (),
    *,
    turn: str = 'ahead',
    lanes: int = 1,
    background: BackgroundSpec | None = None,
    phases: tuple[tuple[str, float], ...] = CYCLE,
    start_s_m: float = 40.0,
    start_speed_mps: float = 0.0,
) -> World:
    """A four-arm junction 130 m after the start of the road, with a speed limit of 11 m/s."""
    lights = (LightSpec(0, phases, 400.0, repeats=True),) if control == 'light' else ()
    layout = RoadLayout((Straight(130), Junction(turn, control=control), Straight(120)), lanes, lanes, 11.0)
    route = RouteSpec(start_s_m=start_s_m, start_speed_mps=start_speed_mps)
    return world_of(Scene(layout, route, actors, lights, background=background), seed)


def car_of(world: World) -> PathVehicle:
    """The first vehicle."""
    return next(actor for actor in world.actors if isinstance(actor, PathVehicle))


def stand_aside(world: World) -> None:
    """Put the ego beside the road, where it is in nobody's way."""
    world.ego.position[:] = world.route.pose(world.route_s_m, -9.0)[:2]
    world.refresh()


def brake(world: World) -> Control:
    return Control(0.0, 1.0)


def drive_on(world: World, share: float = 0.9) -> Control:
    """Along the route at a share of the limit, behind others, with lights and signs, to a stop before the goal."""
    speed = max(world.ego.speed, 0.0)
    gap, closing = leader(world, route_window(world))
    wanted = share * world.speed_limit_at(world.route_s_m)
    acceleration = min(idm_acceleration(speed, wanted, gap, closing), stopping(speed, stop_line_m(world)))
    if world.route_s_m > world.goal_s_m - 8.0:
        acceleration = -3.0
    return pedals(world, acceleration, pursuit_steer(world))


class Watch:
    """Looks at a world after each step. overlaps: pairs of numbers of actors, not the ego, that touched. popped:
    (time, number, distance) of what appeared or vanished in sight. longest_wait_s: of a vehicle that stood still."""

    def __init__(self, world: World) -> None:
        self.world = world
        self.overlaps: dict[tuple[int, int], float] = {}
        self.popped: list[tuple[float, int, float]] = []
        self.longest_wait_s = 0.0
        self.since: dict[int, float] = {}
        self.numbers: set[int] = set()
        self._look()

    def step(self, control: Control) -> None:
        before = dict(self.distances)
        self.world.step(control)
        self._look()
        time_s = self.world.time_s
        for number in self.distances.keys() - before.keys():
            if self.distances[number] < SIGHT_M:
                self.popped.append((time_s, number, self.distances[number]))
        for number in before.keys() - self.distances.keys():
            if before[number] < SIGHT_M:
                self.popped.append((time_s, number, before[number]))
        if self.world.physics_ticks % 2 == 0:
            self._find_overlaps()

    def _look(self) -> None:
        world = self.world
        self.distances = {actor.number: world.ego_distance_m(actor.position) for actor in world.actors}
        self.numbers |= self.distances.keys()
        for actor in world.actors:
            if isinstance(actor, PathVehicle) and actor.speed < 0.3:
                begin = self.since.setdefault(actor.number, world.time_s)
                self.longest_wait_s = max(self.longest_wait_s, world.time_s - begin)
            else:
                self.since.pop(actor.number, None)

    def _find_overlaps(self) -> None:
        actors, places = self.world.actors, self.world.positions[:-1]
        gaps = np.hypot(*(places[:, None] - places[None]).transpose(2, 0, 1))
        for i, j in zip(*np.nonzero(np.triu(gaps < 7.0, 1)), strict=True):
            one, other = actors[i], actors[j]
            if not (isinstance(one, StandingObject) and isinstance(other, StandingObject)) and touch(one, other):
                self.overlaps.setdefault((one.number, other.number), self.world.time_s)


def touch(one, other) -> bool:
    """Whether the boxes of two actors overlap."""
    return boxes_overlap(box(one), box(other))


def box(actor):
    return corners_m(float(actor.position[0]), float(actor.position[1]), actor.heading, actor.LENGTH, actor.WIDTH)
