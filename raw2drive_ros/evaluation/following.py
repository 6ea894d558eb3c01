"""What every driver that reads the simulator shares: steering along the route, and pedals for an acceleration."""

from __future__ import annotations

import math

from raw2drive_ros.contract import Control
from raw2drive_ros.simulation.world import World

LOOK_AHEAD_MIN_M = 4.0


def pursuit_steer(world: World, look_ahead_s: float, offset_m: float = 0.0) -> float:
    """Pure pursuit: steering in [-1, 1], left positive, towards the route's point `look_ahead_s` of travel (4 m
    at least) ahead, `offset_m` to its left."""
    ego = world.ego
    ahead = max(LOOK_AHEAD_MIN_M, look_ahead_s * max(ego.speed, 0.0))
    x, y, _ = world.route.pose(world.route_s_m + ahead, offset_m)
    dx, dy = x - float(ego.position[0]), y - float(ego.position[1])
    cos, sin = math.cos(ego.heading), math.sin(ego.heading)
    local_x, local_y = dx * cos + dy * sin, -dx * sin + dy * cos
    curvature = 2.0 * local_y / max(local_x * local_x + local_y * local_y, 1e-6)
    wheel = math.atan(curvature * ego.parameters.wheelbase_m)
    return min(max(wheel / ego.parameters.max_steer_rad, -1.0), 1.0)


def pedals(world: World, acceleration_mps2: float, steer: float) -> Control:
    """Throttle or brake that give the ego's vehicle model about this acceleration; at rest it is held by the brake."""
    p, speed = world.ego.parameters, max(world.ego.speed, 0.0)
    if acceleration_mps2 < -0.8 or (acceleration_mps2 <= 0.0 and speed < 0.3):
        return Control(0.0, min(1.0, max(0.3, -acceleration_mps2 / p.brake_deceleration_mps2)), steer)
    drag = p.drag_constant_mps2 + p.drag_linear_1ps * speed + p.drag_quadratic_1pm * speed**2
    strength = min(p.drive_acceleration_mps2, p.drive_power_mps3 / max(speed, 1e-6))
    return Control(min(max((acceleration_mps2 + drag) / strength, 0.0), 1.0), 0.0, steer)
