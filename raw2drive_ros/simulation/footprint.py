"""Where the ego may be, by the corners of the car: in the lanes of its direction, along its route, past an obstacle.

Outside is who has a corner over the kerb, or further than `LANE_TOLERANCE_M` in a lane of oncoming traffic, on a
shoulder or among parked cars, unless the route or the way past an obstacle runs there. On roads with several lanes
per direction, who keeps the line between two of them under the car for longer than a lane change takes is outside too.
"""

from __future__ import annotations

import math

import numpy as np

from raw2drive_ros.contracts.public import Float64
from raw2drive_ros.simulation.actors import corners_m
from raw2drive_ros.simulation.road_surface import FORWARD, JUNCTION, OFF, SIDEWALK
from raw2drive_ros.simulation.world import World

LANE_TOLERANCE_M = 0.5
# Further than this into both lanes, the car has a lane line under it.
LINE_TOLERANCE_M = 0.3
# Way of a lane change: a lane line may stay under the car for so long.
LANE_CHANGE_M = 40.0
SEARCH_M = 8.0
BEYOND_KERB, ALLOWED = np.zeros((2, 256), bool)
BEYOND_KERB[[OFF, SIDEWALK]] = ALLOWED[[FORWARD, JUNCTION]] = True


def ego_corners_m(world: World) -> Float64:
    """(4, 2) corners of the ego in `map`."""
    ego = world.ego
    return corners_m(float(ego.position[0]), float(ego.position[1]), ego.heading, ego.LENGTH, ego.WIDTH)


def on_road(world: World) -> bool:
    """Whether every corner of the ego is where it may be; see the module."""
    return bool(allowed(world, ego_corners_m(world)).all())


def allowed(world: World, points_m: Float64) -> np.ndarray:
    """(N,) whether a car of the ego's route may cover each of the (N, 2) points near the ego."""
    assert world.road.surface is not None
    kinds = world.road.surface.kind_at(points_m)
    inside = ALLOWED[kinds]
    if inside.all():
        return inside
    inside |= _along_route(world, points_m)
    if not inside.all():
        inside |= _in_forward_lanes(world, points_m)
    return inside & ~BEYOND_KERB[kinds]


def straddles(world: World) -> bool:
    """Whether the ego has a line between two lanes of its direction under it, away from junctions and where
    the way past an obstacle runs there."""
    lanes, width = world.scene.layout.forward_lanes, world.scene.layout.lane_width_m
    if lanes < 2 or _way_is_between_lanes(world, width):
        return False
    reference, ego = world.road.forward_path_cached(), world.ego
    s_m, lateral = reference.project(float(ego.position[0]), float(ego.position[1]))
    if any(site.entry_s_m <= s_m <= site.exit_s_m for site in world.road.junctions):
        return False
    turned = ego.heading - reference.pose(s_m)[2]
    reach = (ego.LENGTH * abs(math.sin(turned)) + ego.WIDTH * abs(math.cos(turned))) / 2 - LINE_TOLERANCE_M
    return any(abs(lateral - (0.5 - i) * width) < reach for i in range(1, lanes))


def _way_is_between_lanes(world: World, width_m: float) -> bool:
    """Whether the way past an obstacle keeps between two lanes here."""
    return any(
        abs(math.remainder(offset, width_m)) > LINE_TOLERANCE_M for offset in world.lateral_range_m(world.route_s_m)
    )


def _along_route(world: World, points_m: Float64) -> np.ndarray:
    """(N,) whether points are within a lane, plus tolerance, along the route or between it and the way past an
    obstacle."""
    stations, laterals = world.route.project_many(points_m, world.route_s_m, SEARCH_M)
    band = world.scene.layout.lane_width_m / 2 + LANE_TOLERANCE_M
    ranges = np.array([world.lateral_range_m(float(s)) for s in stations])
    return (laterals > ranges[:, 0] - band) & (laterals < ranges[:, 1] + band)


def _in_forward_lanes(world: World, points_m: Float64) -> np.ndarray:
    """(N,) whether points are in a lane of the ego's direction, plus tolerance."""
    reference = world.road.forward_path_cached()
    s_m, _ = reference.project(float(world.ego.position[0]), float(world.ego.position[1]))
    _, laterals = reference.project_many(points_m, s_m, SEARCH_M)
    width, lanes = world.scene.layout.lane_width_m, world.scene.layout.forward_lanes
    to_right = -(lanes - 0.5) * width - LANE_TOLERANCE_M
    return (laterals > to_right) & (laterals < width / 2 + LANE_TOLERANCE_M)
