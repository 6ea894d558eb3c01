"""Shared by all drivers that read the simulator's state: steering along the route, IDM, stop lines, pedals."""

from __future__ import annotations

import math

import numpy as np

from raw2drive_ros.contracts.public import Control, Float64
from raw2drive_ros.simulation.leaders import first_on_path
from raw2drive_ros.simulation.path import SPACING_M
from raw2drive_ros.simulation.world import World

LOOK_AHEAD_MIN_M = 4.0
LOOK_AHEAD_S = 0.8
SIGHT_M = 45.0
STOP_BEFORE_M = 1.0
IDM_TIME_GAP_S = 1.0
IDM_GAP_M = 3.0


def pursuit_steer(
    world: World, look_ahead_s: float = LOOK_AHEAD_S, offset_m: float = 0.0, *, along_detour: bool = False
) -> float:
    """Pure pursuit: steering in [-1, 1], left positive.

    The target is the point of the route `look_ahead_s` of travel ahead, at least `LOOK_AHEAD_MIN_M`, and `offset_m` to
    its left. along_detour: follow the reference detour around obstacles.
    """
    ego = world.ego
    ahead = max(LOOK_AHEAD_MIN_M, look_ahead_s * max(ego.speed, 0.0))
    there = world.route_s_m + ahead
    if along_detour:
        offset_m += world.detour_offset_m(there)
    x, y, _ = world.route.pose(there, offset_m)
    return steer_to(world, x, y)


def steer_to(world: World, x: float, y: float) -> float:
    """Steering in [-1, 1] of the arc that leads from the ego's centre to the point (x, y) of `map`."""
    ego = world.ego
    dx, dy = x - float(ego.position[0]), y - float(ego.position[1])
    cos, sin = math.cos(ego.heading), math.sin(ego.heading)
    local_x, local_y = dx * cos + dy * sin, -dx * sin + dy * cos
    curvature = 2.0 * local_y / max(local_x * local_x + local_y * local_y, 1e-6)
    wheel = math.atan(curvature * ego.parameters.wheelbase_m)
    return min(max(wheel / ego.parameters.max_steer_rad, -1.0), 1.0)


def route_window(world: World, offset_m: float = 0.0) -> Float64:
    """(M, 2) points of the route, 1 m apart, `offset_m` to its left, from 1 m ahead of the ego's centre on (an actor
    beside it is not ahead)."""
    first = world.route.index_at(world.route_s_m + 1.0)
    part = slice(first, first + int(SIGHT_M / SPACING_M), 2)
    points = world.route.points_m[part]
    if offset_m == 0.0:
        return points
    yaw = world.route.headings_rad[part]
    return points + offset_m * np.stack([-np.sin(yaw), np.cos(yaw)], 1)


def leader(world: World, window_m: Float64) -> tuple[float, float]:
    """(free gap m, closing speed m/s) to the leading actor in the ego's corridor along `window_m`, or (inf, 0).

    window_m: (M, 2) points, 1 m apart.
    """
    gap, closing = first_on_path(world, len(world.actors), window_m, 0.2, SIGHT_M)
    return gap + 1.0, closing


def idm_acceleration(speed: float, wanted: float, gap: float, closing: float) -> float:
    """Acceleration (m/s2) of IDM with target speed `wanted` (m/s), `gap` (m) behind a leading vehicle."""
    free = 3.0 * (1.0 - speed / wanted) if wanted > 0.1 else -4.0 if speed > 0.1 else 0.0
    free = max(free, -5.0)
    if gap > SIGHT_M:
        return min(free, 3.0)
    desired = IDM_GAP_M + max(0.0, speed * IDM_TIME_GAP_S + speed * closing / (2.0 * math.sqrt(3.0 * 4.0)))
    return max(min(free, 3.0 * (1.0 - (desired / max(gap, 0.1)) ** 2)), -8.0)


def stop_line_m(world: World) -> float:
    """Distance (m) from the front bumper to the next line that the ego has to stop at, or inf."""
    front, best = world.front_s_m, math.inf
    for light in world.lights:
        gap = light.line_s_m - front
        if light.colour != 'green' and gap > -0.3 and gap > world.ego.speed**2 / 14.0 - 1.0:
            best = min(best, gap)
    for sign in world.stop_signs:
        if not sign.obeyed and sign.line_s_m > front - 0.3:
            best = min(best, sign.line_s_m - front)
    return best


def stopping(speed: float, gap_m: float) -> float:
    """Acceleration (m/s2) that stops the front bumper `STOP_BEFORE_M` before a line `gap_m` ahead; inf without a line.

    It brakes once that takes more than a slight deceleration.
    """
    if gap_m == math.inf:
        return gap_m
    room = gap_m - STOP_BEFORE_M
    if room < 0.3:
        return -3.0 if speed > 0.05 else 0.0
    needed = speed * speed / (2.0 * room)
    if needed > 1.2:
        return -1.15 * needed
    # Slow enough: roll on, at most at the speed that still allows to stop.
    return 2.0 * (math.sqrt(2.0 * 1.2 * room) - speed)


def pedals(world: World, acceleration_mps2: float, steer: float) -> Control:
    """Throttle or brake for about this acceleration of the ego's vehicle model; the brake holds it at rest."""
    p, speed = world.ego.parameters, max(world.ego.speed, 0.0)
    if acceleration_mps2 < -0.8 or (acceleration_mps2 <= 0.0 and speed < 0.3):
        return Control(0.0, min(1.0, max(0.3, -acceleration_mps2 / p.brake_deceleration_mps2)), steer)
    drag = p.drag_constant_mps2 + p.drag_linear_1ps * speed + p.drag_quadratic_1pm * speed**2
    strength = min(p.drive_acceleration_mps2, p.drive_power_mps3 / max(speed, 1e-6))
    return Control(min(max((acceleration_mps2 + drag) / strength, 0.0), 1.0), 0.0, steer)


def smooth_pedals(world: World, acceleration_mps2: float, steer: float) -> Control:
    """Throttle or brake for exactly this acceleration of the ego's vehicle model; the brake holds it at rest."""
    p, speed = world.ego.parameters, max(world.ego.speed, 0.0)
    if acceleration_mps2 <= 0.0 and speed < 0.15:
        return Control(0.0, 0.3, steer)
    drag = p.drag_constant_mps2 + p.drag_linear_1ps * speed + p.drag_quadratic_1pm * speed**2
    push = acceleration_mps2 + drag
    if push < 0.0:
        return Control(0.0, min(1.0, -push / p.brake_deceleration_mps2), steer)
    strength = min(p.drive_acceleration_mps2, p.drive_power_mps3 / max(speed, 1e-6))
    return Control(min(push / strength, 1.0), 0.0, steer)
