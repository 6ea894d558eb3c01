"""Whether a drawn scene may become a route: its actors must not crash before the ego is involved, and a twin has to
look like the event until something happens. And the weather of a route."""

from __future__ import annotations

import itertools
import zlib
from dataclasses import dataclass

import numpy as np

from raw2drive_ros.contracts.public import Control
from raw2drive_ros.evaluation.following import (
    SIGHT_M,
    idm_acceleration,
    leader,
    pedals,
    pursuit_steer,
    stop_line_m,
    stopping,
)
from raw2drive_ros.simulation.actors import Actor, StandingObject, boxes_overlap, corners_m
from raw2drive_ros.simulation.draws import Draw
from raw2drive_ros.simulation.scenario import get_scenario
from raw2drive_ros.simulation.weather import WEATHER_NAMES
from raw2drive_ros.simulation.world import World
from raw2drive_ros.tables.rates import DECISION_HZ, SUBSTEPS

ROLLOUT_S = 20.0
CHECK_EVERY_TICKS = 3
SPEED_SHARE = 0.8
START_MARGIN_M = 0.5
NEAR_M = 7.0
# As far as the cameras draw.
SEEN_M = 80.0


def weather_of(kind: str, seed: int) -> str:
    """Name of a route's weather: a hash of type and seed, so that it tells nothing about either."""
    number = zlib.crc32(f'weather/{seed}/{kind}'.encode())
    return WEATHER_NAMES[int(np.random.default_rng(number).integers(len(WEATHER_NAMES)))]


def is_fair(kind: str, seed: int, *, twin: bool = False) -> bool:
    """Whether no actor overlaps the ego at the start, and no actors collide with each other before the ego does."""
    world = World(get_scenario(kind), Draw(kind, seed, event=not twin))
    if _touches_ego(world, START_MARGIN_M):
        return False
    for tick in range(round(ROLLOUT_S * DECISION_HZ)):
        if tick % CHECK_EVERY_TICKS == 0 and _actors_touch(world):
            return False
        control = _follow(world)
        for _ in range(SUBSTEPS):
            world.step(control)
        if world.contacts or world.goal_s_m - world.route_s_m < 10.0:
            return True
    return True


@dataclass(frozen=True, slots=True)
class Difference:
    """Where a twin first differs from its event for an ego that follows the route. what: in which respect."""

    time_s: float
    way_m: float
    what: str


def first_difference(kind: str, seed: int) -> Difference | None:
    """The first difference of event and twin within `SEEN_M` of the ego; None within `ROLLOUT_S`.

    Both worlds get the commands of one driver, that of the event. A difference at the start tells a driver which of the
    two it is in, before anything has happened.
    """
    event, twin = (World(get_scenario(kind), Draw(kind, seed, event=happens)) for happens in (True, False))
    for _ in range(round(ROLLOUT_S * DECISION_HZ)):
        if what := _different(event, twin):
            return Difference(event.time_s, event.route_s_m - event.scene.route.start_s_m, what)
        if event.goal_s_m - event.route_s_m < 10.0:
            break
        control = _follow(event)
        for _ in range(SUBSTEPS):
            event.step(control)
            twin.step(control)
    return None


def _different(event: World, twin: World) -> str:
    if [light.colour for light in event.lights] != [light.colour for light in twin.lights]:
        return 'light'
    if [lamp.colour for lamp in event.lamps] != [lamp.colour for lamp in twin.lamps]:
        return 'lamp'
    if [sign.pole_pose for sign in event.signs] != [sign.pole_pose for sign in twin.signs]:
        return 'sign'
    if getattr(event, 'scenery', ()) != getattr(twin, 'scenery', ()):
        return 'scenery'
    if not np.array_equal(event.route.points_m, twin.route.points_m):
        return 'route'
    seen, also = (_seen(world) for world in (event, twin))
    for one, other in itertools.zip_longest(seen, also):
        if one != other:
            return str((one or other)[0])
    return ''


def _seen(world: World) -> list[tuple[str, ...]]:
    """What shows of every actor near the ego, rounded, in an order that does not depend on that of the actors."""
    found = []
    for actor in world.actors:
        if float(np.abs(actor.position - world.ego.position).max()) < SEEN_M:
            x, y = actor.position
            numbers = (x, y, actor.heading, actor.LENGTH, actor.WIDTH)
            colour = getattr(actor, 'colour', '')
            found.append((actor.kind, *(f'{float(number):.2f}' for number in numbers), str(colour)))
    return sorted(found)


def _follow(world: World) -> Control:
    """Along the reference path at `SPEED_SHARE` of the limit, with a distance to others, stops at lights and signs."""
    speed = max(world.ego.speed, 0.0)
    gap, closing = leader(world, world.detour_window(world.route_s_m + 1.0, SIGHT_M))
    wanted = SPEED_SHARE * world.speed_limit_at(world.route_s_m)
    acceleration = min(idm_acceleration(speed, wanted, gap, closing), stopping(speed, stop_line_m(world)))
    return pedals(world, acceleration, pursuit_steer(world, along_detour=True))


def _box(actor: Actor) -> np.ndarray:
    x, y = float(actor.position[0]), float(actor.position[1])
    return corners_m(x, y, actor.heading, actor.LENGTH, actor.WIDTH)


def _touches_ego(world: World, margin_m: float = 0.0) -> bool:
    ego = world.ego
    x, y = float(ego.position[0]), float(ego.position[1])
    own = corners_m(x, y, ego.heading, ego.LENGTH + margin_m, ego.WIDTH + margin_m)
    near = np.abs(world.positions[:-1] - ego.position).max(axis=1, initial=0.0) < NEAR_M
    return any(boxes_overlap(own, _box(world.actors[int(i)])) for i in np.flatnonzero(near))


def _actors_touch(world: World) -> bool:
    """Whether two actors overlap, of which at least one is not a standing object."""
    count = len(world.actors)
    if count < 2:
        return False
    reach = np.hypot(world.half_lengths[:-1], world.half_widths[:-1])
    place = world.positions[:-1]
    apart = np.hypot(*(place[:, None] - place[None]).transpose(2, 0, 1)) - reach[:, None] - reach[None]
    for i, j in zip(*np.nonzero(np.triu(apart < 0.0, 1)), strict=True):
        a, b = world.actors[i], world.actors[j]
        if isinstance(a, StandingObject) and isinstance(b, StandingObject):
            continue
        if boxes_overlap(_box(a), _box(b)):
            return True
    return False
