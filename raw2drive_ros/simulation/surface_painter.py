"""Paints the surface of a road: which kind of ground its polygons and lanes are."""

from __future__ import annotations

import numpy as np

from raw2drive_ros.simulation.lanes import outline_points
from raw2drive_ros.simulation.road_surface import (
    ARM,
    BACKWARD,
    FORWARD,
    JUNCTION,
    PARKING,
    SHOULDER,
    SIDEWALK,
    RoadSurface,
)
from raw2drive_ros.simulation.roads import Edge, RoadMap


def paint_surface(road: RoadMap) -> RoadSurface:
    """The surface of a road that has all its lanes and polygons."""
    surface = RoadSurface(np.concatenate([*road.sidewalks_m, *road.surfaces_m]))
    for polygon in road.sidewalks_m:
        surface.fill(polygon, SIDEWALK)
    for polygon in road.surfaces_m:
        surface.fill(polygon, SHOULDER)
    for polygon in road.parking_m:
        surface.fill(polygon, PARKING)
    forward = {*road.lanes_along(oncoming=False), *road.ramp, *road.exit}
    backward = set(road.lanes_along(oncoming=True))
    for start, ends in road.network.graph.items():
        for end, lanes in ends.items():
            for lane in lanes:
                if lane.junction < 0:
                    half = lane.width / 2
                    surface.fill(outline_points(lane, half, -half), _kind((start, end), forward, backward))
    for site in road.junctions:
        surface.fill(site.outline_m, JUNCTION)
    for polygon in road.islands_m:
        surface.fill(polygon, SIDEWALK)
    return surface


def _kind(edge: Edge, forward: set[Edge], backward: set[Edge]) -> int:
    return FORWARD if edge in forward else BACKWARD if edge in backward else ARM
