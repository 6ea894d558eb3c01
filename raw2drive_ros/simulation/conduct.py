"""How the ego treats others and whether it stops for nothing: whom it makes brake hard, and where it stands."""

from __future__ import annotations

import math

import numpy as np

from raw2drive_ros.simulation.actors import Actor, PathVehicle, Walker
from raw2drive_ros.simulation.world import World

# A deceleration (m/s2) that nobody may force on others.
HARD_BRAKING_MPS2 = 3.5
# An ego that was in the lane this long before has not cut in: keeping a distance is the business of those behind it.
ENTERED_WITHIN_S = 3.0
# Who has a rule of its own: holding up an emergency vehicle.
OWN_RULE = ('emergency',)

STANDING_MPS = 0.3
MOVING_MPS = 0.5
HAZARD_M = 20.0
# Moving traffic is a reason to stand where it comes within `HAZARD_M` in this time.
APPROACH_S = 5.0
CORRIDOR_M = 2.0
BESIDE_M = 5.0
# At a stop sign, after the stop, a driver may look for traffic for so long.
LOOK_S, SIGN_M = 3.0, 5.0


def forces_braking(world: World, actor: Actor, before_m: tuple[float, float]) -> bool:
    """Whether an actor has to brake harder than `HARD_BRAKING_MPS2` because the ego came into its way.

    before_m: where the ego was `ENTERED_WITHIN_S` ago, or at the start.
    """
    if not isinstance(actor, PathVehicle) or actor.imposed_mps2 <= HARD_BRAKING_MPS2:
        return False
    if actor.kind in OWN_RULE:
        return False
    _, lateral = actor.path.project(*before_m)
    return abs(lateral - actor.lateral_m) > (world.ego.WIDTH + actor.WIDTH) / 2


def has_reason_to_stand(world: World, stood_s: float) -> bool:
    """Whether something asks a standing ego to stand: a light or a sign, an obstacle or a walker in its way, or moving
    traffic within `HAZARD_M`. stood_s: for how long it has stood already."""
    front = world.front_s_m
    for light in world.lights:
        if light.colour != 'green' and -0.5 < light.line_s_m - front < HAZARD_M:
            return True
    for sign in world.stop_signs:
        gap = sign.line_s_m - front
        if (-0.5 < gap < HAZARD_M and not sign.obeyed) or (-0.5 < gap < SIGN_M and stood_s < LOOK_S):
            return True
    near = np.abs(world.positions[:-1] - world.ego.position).max(axis=1, initial=0.0) < 3.0 * HAZARD_M
    rows = np.flatnonzero(near)
    if not len(rows):
        return False
    stations, laterals = world.route.project_many(world.positions[rows], world.route_s_m, 3.0 * HAZARD_M)
    places = zip(rows.tolist(), (stations - front).tolist(), (laterals - world.route_lateral_m).tolist(), strict=True)
    return any(_is_hazard(world, row, ahead, aside) for row, ahead, aside in places)


def _is_hazard(world: World, row: int, ahead_m: float, aside_m: float) -> bool:
    """ahead_m, aside_m: place of the actor's centre in the ego's corridor, from its front bumper."""
    actor = world.actors[row]
    within = -world.ego.LENGTH / 2 < ahead_m < HAZARD_M + world.half_lengths[row]
    if within and abs(aside_m) < CORRIDOR_M:
        return True
    if actor.speed < MOVING_MPS:
        return False
    if isinstance(actor, Walker):
        yaw = world.route.pose(world.front_s_m + ahead_m)[2]
        towards = -aside_m * math.sin(actor.heading - yaw)
        return within and abs(aside_m) < BESIDE_M and towards > 0.0
    if abs(aside_m) < CORRIDOR_M and ahead_m < 0.0:
        # Who follows the ego is no reason to stand.
        return False
    dx, dy = (float(v) for v in world.positions[row] - world.ego.position)
    vx, vy = actor.speed * math.cos(actor.heading), actor.speed * math.sin(actor.heading)
    when = min(max(-(dx * vx + dy * vy) / (vx * vx + vy * vy), 0.0), APPROACH_S)
    return math.hypot(dx + when * vx, dy + when * vy) < HAZARD_M
