"""Where the ego may be, by the corners of the car: in the lanes of its direction, along its route, past an obstacle.

Outside is who has a corner over the kerb, or further than `LANE_TOLERANCE_M` in a lane of oncoming traffic, on a
shoulder or among parked cars, unless the route or the way past an obstacle runs there. On roads with several lanes
per direction, who keeps the line between two of them under the car for longer than a lane change takes is outside too.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from raw2drive_ros.contracts.public import Float64
from raw2drive_ros.simulation.actors import corners_m
from raw2drive_ros.simulation.path import project_groups
from raw2drive_ros.simulation.road_surface import FORWARD, JUNCTION, OFF, SIDEWALK
from raw2drive_ros.simulation.world import World

LANE_TOLERANCE_M = 0.5
# Further than this into both lanes, the car has a lane line under it.
LINE_TOLERANCE_M = 0.3
# Way of a lane change: a lane line may stay under the car for so long.
LANE_CHANGE_M = 40.0
SEARCH_M = 8.0
BEYOND_KERB, ALLOWED = {OFF, SIDEWALK}, {FORWARD, JUNCTION}
ALLOWED_KINDS = np.isin(np.arange(256), [*ALLOWED])


class Way(NamedTuple):
    """straddles: the ego has a line between two lanes of its direction under it, away from junctions and where the way
    past an obstacle runs there. on_road: every corner of it is where it may be; see the module."""

    straddles: bool
    on_road: bool


def ego_corners_m(world: World) -> Float64:
    """(4, 2) corners of the ego in `map`."""
    ego = world.ego
    return corners_m(float(ego.position[0]), float(ego.position[1]), ego.heading, ego.LENGTH, ego.WIDTH)


def on_road(world: World) -> bool:
    """Whether every corner of the ego is where it may be; see the module."""
    return ways_of([world])[0].on_road


def ways_of(worlds: Sequence[World]) -> list[Way]:
    """Where the ego of each world is: the same as one after the other, in less time."""
    corners = [ego_corners_m(world) for world in worlds]
    kinds = [_kinds_at(world, points) for world, points in zip(worlds, corners, strict=True)]
    # Their place along the roads decides only where the surface does not.
    unclear = [i for i, found in enumerate(kinds) if not found & BEYOND_KERB and found - ALLOWED]
    between = [i for i, world in enumerate(worlds) if _may_straddle(world)]
    stations = {i: _reference_s_m(worlds[i]) for i in {*unclear, *between}}
    between = [i for i in between if not _at_junction(worlds[i], stations[i])]
    asked = sorted({*unclear, *between})
    queries = [(worlds[i].road.forward_path_cached(), corners[i], stations[i]) for i in asked]
    across = {i: laterals for i, (_, laterals) in zip(asked, project_groups(queries, SEARCH_M))}
    queries = [(worlds[i].route, corners[i], worlds[i].route_s_m) for i in unclear]
    along = dict(zip(unclear, project_groups(queries, SEARCH_M)))
    inside = {i: _in_forward_lanes(worlds[i], across[i]) | _along_route(worlds[i], *along[i]) for i in unclear}
    return [
        Way(
            i in between and _over_line(worlds[i], across[i]),
            bool(_allowed(worlds[i], corners[i], inside[i]).all()) if i in inside else not found & BEYOND_KERB,
        )
        for i, found in enumerate(kinds)
    ]


def _kinds_at(world: World, points_m: Float64) -> set[int]:
    assert world.road.surface is not None
    return set(world.road.surface.kind_at(points_m).tolist())


def _allowed(world: World, points_m: Float64, inside: np.ndarray) -> np.ndarray:
    """(N,) whether a car may cover each of the points, none of which is beyond the kerb. inside: where its place along
    the roads says so."""
    assert world.road.surface is not None
    return inside | ALLOWED_KINDS[world.road.surface.kind_at(points_m)]


def _may_straddle(world: World) -> bool:
    """Whether there is a line between two lanes that the ego must not keep under it."""
    layout = world.scene.layout
    return layout.forward_lanes >= 2 and not _way_is_between_lanes(world, layout.lane_width_m)


def _reference_s_m(world: World) -> float:
    """Station of the ego on the reference line of its direction."""
    x, y = world.ego.position
    return world.road.forward_path_cached().project(float(x), float(y))[0]


def _at_junction(world: World, s_m: float) -> bool:
    return any(site.entry_s_m <= s_m <= site.exit_s_m for site in world.road.junctions)


def _over_line(world: World, laterals_m: Float64) -> bool:
    """Whether corners with these offsets from the reference line have a line between two lanes well between them."""
    lanes, width = world.scene.layout.forward_lanes, world.scene.layout.lane_width_m
    lines = width / 2 - width * np.arange(1, lanes)
    right, left = laterals_m.min() + LINE_TOLERANCE_M, laterals_m.max() - LINE_TOLERANCE_M
    return bool(((lines > right) & (lines < left)).any())


def _way_is_between_lanes(world: World, width_m: float) -> bool:
    """Whether the way past an obstacle keeps between two lanes here."""
    return any(
        abs(math.remainder(offset, width_m)) > LINE_TOLERANCE_M for offset in world.lateral_range_m(world.route_s_m)
    )


def _along_route(world: World, stations_m: Float64, laterals_m: Float64) -> np.ndarray:
    """(N,) whether points are within a lane, plus tolerance, along the route or between it and the way past an
    obstacle."""
    band = world.scene.layout.lane_width_m / 2 + LANE_TOLERANCE_M
    ranges = np.array([world.lateral_range_m(float(s)) for s in stations_m])
    return (laterals_m > ranges[:, 0] - band) & (laterals_m < ranges[:, 1] + band)


def _in_forward_lanes(world: World, laterals_m: Float64) -> np.ndarray:
    """(N,) whether points with these offsets from the reference line are in a lane of the ego's direction, plus
    tolerance."""
    width, lanes = world.scene.layout.lane_width_m, world.scene.layout.forward_lanes
    to_right = -(lanes - 0.5) * width - LANE_TOLERANCE_M
    return (laterals_m > to_right) & (laterals_m < width / 2 + LANE_TOLERANCE_M)
