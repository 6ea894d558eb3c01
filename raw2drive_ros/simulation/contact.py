"""Contacts of the ego with other actors: inelastic impacts, after which the drive goes on.

Who touches loses the closing speed along the contact's normal, shared by mass; no overlap is left. What stands (parked
cars, barriers, doors) does not move, cones do, and debris lies flat: a car drives over it. The ego is a kinematic
bicycle, so tyres take whatever speed it would get sideways. Actors have no contacts among themselves.
"""

from __future__ import annotations

import copy
import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from raw2drive_ros.simulation.actors import Actor, PathVehicle, StandingObject
from raw2drive_ros.simulation.ego import EgoVehicle

if TYPE_CHECKING:
    from raw2drive_ros.simulation.world import World

EGO_KG = 1600.0
# Kinds that are not in the table stand fast if they are standing objects, and else weigh as much as a car.
MASSES_KG = {'car': 1500.0, 'van': 2500.0, 'emergency': 3000.0, 'cyclist': 90.0, 'walker': 75.0, 'cone': 5.0}
CAR_KG = 1500.0
# Lighter than this, they are pushed along after the impact without slowing the ego any more.
LIGHT_KG = 200.0
# Kinds that are driven over.
FLAT = ('debris',)
# From centre to centre: half the length of the ego and of the longest actor, and how far they move in one step.
NEAR_M = 10.0
# Boxes end this far apart, so that touching is not overlapping.
SLOP_M = 1e-3
# Passes over all actors near, until none overlaps.
PASSES = 4
# Contacts with one actor that follow this closely are one.
SAME_S = 0.15
SLOWEST_MPS = 1e-3
Vector = tuple[float, float]


@dataclass(frozen=True, slots=True)
class Contact:
    """The ego touches an actor. place_m: of the ego. ego_speed_mps: of the ego, right before. impact_mps: closing speed
    along the normal; 0 where they only rest against each other."""

    actor: Actor
    time_s: float
    place_m: Vector
    ego_speed_mps: float
    impact_mps: float


def resolve_contacts(world: World, dt: float) -> tuple[Contact, ...]:
    """Separate the ego from all actors that it overlaps after a physics step of `dt` seconds; the contacts, if any.

    Call it before `World.refresh`, whose last arrays hold the poses before this step.
    """
    rows = _near(world)
    if not rows:
        return ()
    found: dict[int, Contact] = {}
    for _ in range(PASSES):
        touched = False
        for row in rows:
            hit = penetration(world, world.actors[row])
            if hit is not None:
                touched = True
                found.setdefault(row, _impact(world, row, *hit, dt))
        if not touched:
            break
    else:
        _back_off(world, rows)
    return tuple(found.values())


def key_of(actor: Actor) -> int:
    """The actor's number in its world, or what stands for it where it has none."""
    return int(actor.number) if actor.number >= 0 else id(getattr(actor, 'root', actor))


def has_contact(world: World, since_s: float = -math.inf) -> bool:
    """Whether the ego has touched an actor after time `since_s`."""
    return bool(world.contacts) and world.contacts[-1].time_s > since_s


def penetration(world: World, actor: Actor) -> tuple[Vector, float] | None:
    """(unit normal from the ego to the actor, depth in metres) where they overlap, else None.

    The normal is the axis on which the boxes were apart until this moment, at their present speeds; where no axis was,
    that of the least overlap.
    """
    ego = world.ego
    dx, dy = float(actor.position[0] - ego.position[0]), float(actor.position[1] - ego.position[1])
    if math.hypot(dx, dy) > math.hypot(ego.LENGTH, ego.WIDTH) / 2 + math.hypot(actor.LENGTH, actor.WIDTH) / 2:
        return None
    ego_v, actor_v = _ego_velocity(world), _velocity(actor)
    best, best_key = None, (math.inf, math.inf)
    for turn in (ego.heading, ego.heading + math.pi / 2, actor.heading, actor.heading + math.pi / 2):
        x, y = math.cos(turn), math.sin(turn)
        apart = dx * x + dy * y
        depth = _reach_m(ego, turn) + _reach_m(actor, turn) - abs(apart)
        if depth < 0.0:
            return None
        normal = (x, y) if apart >= 0.0 else (-x, -y)
        closing = _dot(ego_v, normal) - _dot(actor_v, normal)
        # How long ago they met on this axis.
        since_s = depth / closing if closing > SLOWEST_MPS else math.inf
        key = (since_s if since_s < SAME_S else math.inf, depth)
        if key < best_key:
            best, best_key = (normal, depth), key
    return best


def _near(world: World) -> list[int]:
    """Rows of the actors that may touch the ego, by where they were before this step; a new one comes in far away."""
    between = world.positions[:-1] - world.positions[-1]
    near = np.flatnonzero(np.einsum('ij,ij->i', between, between) < NEAR_M**2)
    if not len(near):
        return []
    before = world.history[0][0]
    wanted = {id(before[i]) for i in near.tolist()}
    return [i for i, actor in enumerate(world.actors) if id(actor) in wanted and actor.kind not in FLAT]


def _reach_m(box: Actor | EgoVehicle, turn: float) -> float:
    """Half the extent of a box along an axis."""
    part = box.heading - turn
    return float(abs(box.LENGTH * math.cos(part)) + abs(box.WIDTH * math.sin(part))) / 2


def _impact(world: World, row: int, normal: Vector, depth_m: float, dt: float) -> Contact:
    """Exchange speed along `normal`, then move both apart by `depth_m`."""
    ego, actor = world.ego, world.actors[row]
    mass = _mass_kg(actor)
    before, its = _ego_velocity(world), _velocity(actor)
    closing = _dot(before, normal) - _dot(its, normal)
    place = (float(ego.position[0]), float(ego.position[1]))
    contact = Contact(actor, world.time_s, place, abs(ego.speed), max(0.0, closing))
    if closing > 0.0 and not (mass < LIGHT_KG and _touched_just_now(world, actor)):
        common = (
            0.0 if math.isinf(mass) else (EGO_KG * _dot(before, normal) + mass * _dot(its, normal)) / (EGO_KG + mass)
        )
        _set_ego_speed(world, before, normal, common, dt)
        if isinstance(actor, PathVehicle):
            change = common - _dot(its, normal)
            along = change * (normal[0] * math.cos(actor.heading) + normal[1] * math.sin(actor.heading))
            actor.speed = max(0.0, actor.speed + along)
    own_share = 1.0 if math.isinf(mass) else mass / (EGO_KG + mass)
    gap = depth_m + SLOP_M
    ego.position[0] -= own_share * gap * normal[0]
    ego.position[1] -= own_share * gap * normal[1]
    if own_share < 1.0:
        _push(world, row, ((1.0 - own_share) * gap * normal[0], (1.0 - own_share) * gap * normal[1]))
    return contact


def _set_ego_speed(world: World, before: Vector, normal: Vector, common_mps: float, dt: float) -> None:
    """The ego gets speed `common_mps` along `normal`, as far as its wheels let it."""
    ego = world.ego
    course = ego.heading + ego.beta_rad
    change = common_mps - _dot(before, normal)
    after = ego.speed + change * (normal[0] * math.cos(course) + normal[1] * math.sin(course))
    lost = (after - ego.speed) / dt
    beta = ego.beta_rad
    ahead, left = ego.acceleration_body
    ego.acceleration_body = (ahead + lost * math.cos(beta), left + lost * math.sin(beta))
    ego.yaw_rate *= after / ego.speed if abs(ego.speed) > SLOWEST_MPS else 0.0
    ego.speed = after


def _push(world: World, row: int, by: Vector) -> None:
    """Move an actor. Standing objects are shared with forks of the world, so it is a copy that moves."""
    actor = world.actors[row]
    if isinstance(actor, StandingObject):
        root = getattr(actor, 'root', actor)
        actor = world.actors[row] = copy.copy(actor)
        actor.root, actor.position = root, np.array(actor.position, float)
        if actor.number in world.by_number:
            world.by_number[actor.number] = actor
    actor.position[0] += by[0]
    actor.position[1] += by[1]
    if isinstance(actor, PathVehicle):
        yaw = actor.path.pose(actor.s_m)[2]
        aside = -by[0] * math.sin(yaw) + by[1] * math.cos(yaw)
        actor.s_m += by[0] * math.cos(yaw) + by[1] * math.sin(yaw)
        actor.base_lateral_m += aside
        actor.lateral_m += aside


def _back_off(world: World, rows: list[int]) -> None:
    """The ego is squeezed between others: it stays where it was before this step, and those that move give way."""
    ego = world.ego
    ego.position[:] = world.positions[-1]
    ego.heading, ego.speed, ego.yaw_rate = float(world.headings[-1]), 0.0, 0.0
    for row in rows:
        hit = None if math.isinf(_mass_kg(world.actors[row])) else penetration(world, world.actors[row])
        if hit is not None:
            normal, depth = hit
            _push(world, row, ((depth + SLOP_M) * normal[0], (depth + SLOP_M) * normal[1]))
            if isinstance(world.actors[row], PathVehicle):
                world.actors[row].speed = 0.0


def _touched_just_now(world: World, actor: Actor) -> bool:
    for contact in reversed(world.contacts):
        if contact.time_s < world.time_s - SAME_S:
            return False
        if key_of(contact.actor) == key_of(actor):
            return True
    return False


def _mass_kg(actor: Actor) -> float:
    fixed = math.inf if isinstance(actor, StandingObject) else CAR_KG
    return MASSES_KG.get(actor.kind, fixed)


def _ego_velocity(world: World) -> Vector:
    ego = world.ego
    course = ego.heading + ego.beta_rad
    return ego.speed * math.cos(course), ego.speed * math.sin(course)


def _velocity(actor: Actor) -> Vector:
    return actor.speed * math.cos(actor.heading), actor.speed * math.sin(actor.heading)


def _dot(a: Vector, b: Vector) -> float:
    return a[0] * b[0] + a[1] * b[1]
