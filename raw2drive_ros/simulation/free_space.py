"""Is there room for one more actor?"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from raw2drive_ros.simulation.actors import Actor
    from raw2drive_ros.simulation.world import World

LANE_HALF_WIDTH_M = 1.9
ALIGNED_COS = 0.5
BESIDE_M = 0.3


def is_free(world: World, actor: Actor, room_m: float = 2.0) -> bool:
    """Whether nobody is at the place of an actor that is not in the world yet, nor `room_m` before or behind it."""
    x, y = actor.position.tolist()
    cos, sin = math.cos(actor.heading), math.sin(actor.heading)
    for other in (*world.actors, world.ego):
        dx, dy = float(other.position[0]) - x, float(other.position[1]) - y
        if abs(dx) > 20.0 or abs(dy) > 20.0:
            continue
        turn = other.heading - actor.heading
        along, across = abs(math.cos(turn)), abs(math.sin(turn))
        length = (actor.LENGTH + other.LENGTH * along + other.WIDTH * across) / 2 + room_m
        width = (actor.WIDTH + other.WIDTH * along + other.LENGTH * across) / 2 + BESIDE_M
        if abs(dx * cos + dy * sin) < length and abs(dy * cos - dx * sin) < width:
            return False
    return True


def gap_in_lane(world: World, x_m: float, y_m: float, heading_rad: float) -> tuple[float, float]:
    """(distance m between centres to the nearest vehicle in the same lane and direction, ahead or behind, and the
    speed m/s of the nearest one ahead); inf without one."""
    cos, sin = math.cos(heading_rad), math.sin(heading_rad)
    nearest = ahead = math.inf
    speed = 0.0
    for other in (*world.actors, world.ego):
        if math.cos(other.heading - heading_rad) < ALIGNED_COS:
            continue
        dx, dy = float(other.position[0]) - x_m, float(other.position[1]) - y_m
        along = dx * cos + dy * sin
        if abs(dy * cos - dx * sin) > LANE_HALF_WIDTH_M + 0.05 * abs(along):
            continue
        nearest = min(nearest, abs(along))
        if 0.0 < along < ahead:
            ahead, speed = along, other.speed
    return nearest, speed
