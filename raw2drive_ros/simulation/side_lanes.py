"""Lanes beside the chain: on-ramps with their acceleration lane, lanes that end, and exits."""

from __future__ import annotations

import math

import numpy as np

from raw2drive_ros.simulation.lane_layer import LaneLayer
from raw2drive_ros.simulation.lanes import ArcLane, outline_points
from raw2drive_ros.simulation.layout import DROP_BEFORE_M, LEAD_M
from raw2drive_ros.simulation.roads import SAMPLE_M, Edge, Marking, Pose, advance

BLEND_M = 30.0
# Ramps: radius and angle of their curve, and length of their straight within the route.
RAMP_RADIUS_M, RAMP_RAD, RAMP_M = 120.0, math.radians(14.0), 60.0
EXIT_RADIUS_M, EXIT_RAD, EXIT_M = 110.0, math.radians(16.0), 70.0


def add_ramp(layer: LaneLayer, index: int, end: Pose, length: float, *, straight: bool) -> None:
    """A lane right of the section that ends at `end`, fed by a curved on-ramp, or straight from beside the road."""
    road, layout, width = layer.road, layer.layout, layer.width
    start = advance(end, -length)
    offset = -(layout.forward_lanes + 0.5) * width
    angle, radius = (0.001 if straight else RAMP_RAD), RAMP_RADIUS_M
    join = advance(start, 0.0, offset)
    arc_length = radius * angle
    along, aside = radius * math.sin(angle), radius * (1 - math.cos(angle))
    # The ramp approaches from the right and curves right until it is parallel to the road.
    arc_start = advance(join, -along, -aside, angle)
    # Arc length 0 of the ramp's path is 60 m before the curve; the ramp comes from out of sight.
    before = DROP_BEFORE_M if straight else RAMP_M + LEAD_M
    far = advance(arc_start, -before)
    layer.add((f'r{index}a', f'r{index}b'), far, before, 0.0)
    layer.add((f'r{index}b', f'r{index}c'), arc_start, arc_length, -1 / radius)
    layer.add((f'r{index}c', f'r{index}d'), join, length - BLEND_M, 0.0)
    road.ramp = [(f'r{index}a', f'r{index}b'), (f'r{index}b', f'r{index}c'), (f'r{index}c', f'r{index}d')]
    road.ramp_piece = index
    _pave(layer, road.ramp, beside=road.ramp[-1])
    taper = [
        advance(end, -BLEND_M, -layout.forward_lanes * width)[:2],
        advance(end, -BLEND_M, offset - width / 2)[:2],
        advance(end, 0.0, -layout.forward_lanes * width)[:2],
    ]
    road.surfaces_m.append(np.array(taper))
    road.markings.append(Marking('white', np.array(taper[1:])))
    _dash_edge_line(layer, start)


def add_exit(layer: LaneLayer, index: int, end: Pose, length: float) -> None:
    """A deceleration lane right of the section that ends at `end`, and an off-ramp that curves away."""
    road, layout, width = layer.road, layer.layout, layer.width
    start = advance(end, -length)
    offset = -(layout.forward_lanes + 0.5) * width
    angle, radius = EXIT_RAD, EXIT_RADIUS_M
    lane_start = advance(start, BLEND_M, offset)
    leave = advance(end, 0.0, offset)
    arc = ArcLane(leave[:2], leave[2], radius * angle, -1 / radius, 1, 1)
    layer.add((f'x{index}a', f'x{index}b'), lane_start, length - BLEND_M, 0.0)
    layer.add((f'x{index}b', f'x{index}c'), leave, radius * angle, -1 / radius)
    layer.add((f'x{index}c', f'x{index}d'), arc.pose(arc.length), EXIT_M + LEAD_M, 0.0)
    road.exit = [(f'x{index}a', f'x{index}b'), (f'x{index}b', f'x{index}c'), (f'x{index}c', f'x{index}d')]
    _pave(layer, road.exit, beside=road.exit[0])
    taper = [
        advance(start, BLEND_M, -layout.forward_lanes * width)[:2],
        advance(start, BLEND_M, offset - width / 2)[:2],
        advance(start, 0.0, -layout.forward_lanes * width)[:2],
    ]
    road.surfaces_m.append(np.array(taper))
    road.markings.append(Marking('white', np.array(taper[1:])))
    _dash_edge_line(layer, start)


def _pave(layer: LaneLayer, edges: list[Edge], beside: Edge) -> None:
    """Asphalt and edge lines of a ramp; edge `beside`, which runs along the road, has no line on its left."""
    road, half, shoulder = layer.road, layer.width / 2, layer.layout.shoulder_m
    for edge in edges:
        lane = road.lane(edge, 0)
        road.surfaces_m.append(outline_points(lane, half, -half - shoulder))
        road.sidewalks_m.append(outline_points(lane, half + 1, -half - shoulder - 2))
        road.markings.append(Marking('white', lane.centre_line(SAMPLE_M, -half)))
        if edge != beside:
            road.markings.append(Marking('white', lane.centre_line(SAMPLE_M, half)))


def _dash_edge_line(layer: LaneLayer, start: Pose) -> None:
    """Make the right edge line of the section that starts at `start` dashed, where a lane was added beside it."""
    road, layout, width = layer.road, layer.layout, layer.width
    edge_line = road.markings.pop(
        next(
            i
            for i, marking in enumerate(road.markings)
            if marking.kind == 'white'
            and np.allclose(marking.points_m[0], advance(start, 0, -layout.forward_lanes * width)[:2])
        )
    )
    road.markings.append(Marking('white_dashed', edge_line.points_m))
