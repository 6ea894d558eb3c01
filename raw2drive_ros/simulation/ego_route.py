"""The ego's route: its path through the road map, and how fast it may be driven."""

from __future__ import annotations

import math

import numpy as np

from raw2drive_ros.contracts.public import Float64
from raw2drive_ros.simulation.path import Path, smooth_step
from raw2drive_ros.simulation.roads import RoadMap
from raw2drive_ros.simulation.scenario import LaneChange, Scene

CURVE_LATERAL_MPS2 = 3.0
CURVE_BRAKING_MPS2 = 2.0
STRAIGHT_1PM = 1e-3


def route_path(scene: Scene, road: RoadMap) -> Path:
    """The ego's route. Raises ValueError for a lane change in a curve."""
    spec = scene.route
    if spec.from_ramp:
        return road.ramp_path()
    base = min(round(spec.lane), scene.layout.forward_lanes - 1)
    path = road.forward_path(base)
    for change in (*spec.changes, *spec.detour):
        if path.curvature(change.s_m, change.over_m) > STRAIGHT_1PM:
            raise ValueError(f'RouteSpec: lane changes need straight road, here at {change.s_m:.0f} m')
    if not spec.changes:
        return path
    shifted = path.shifted(lambda s_m: offset_m(spec.lane, base, spec.changes, s_m, scene.layout.lane_width_m))
    if not spec.to_exit:
        return shifted
    away = road.exit_path()
    end_s_m, _ = shifted.project(float(away.points_m[0, 0]), float(away.points_m[0, 1]))
    points = np.concatenate([shifted.points_m[: shifted.index_at(end_s_m)], away.points_m])
    whole = Path(points, shifted.start_s_m)
    whole.end_s_m = whole.length_m - (away.length_m - away.end_s_m)
    return whole


def offset_m(
    start_lane: float, base_lane: float, changes: tuple[LaneChange, ...], s_m: float, lane_width_m: float
) -> float:
    """Lateral offset (left positive) from lane `base_lane` after starting in `start_lane` and making `changes`."""
    lane, offset = start_lane, -(start_lane - base_lane) * lane_width_m
    for change in changes:
        offset -= (change.to_lane - lane) * lane_width_m * smooth_step(s_m, change.s_m, change.over_m)
        lane = change.to_lane
    return offset


def speed_profile(route: Path, limit_mps: float) -> Float64:
    """Advised speed (m/s) every 0.5 m: the limit, reduced in curves and on the braking distance before them."""
    headings = route.headings_rad
    curvature = np.abs(np.gradient(headings, 0.5))
    kernel = np.ones(9) / 9
    curvature = np.convolve(np.pad(curvature, 4, mode='edge'), kernel, mode='valid')
    speed = np.minimum(limit_mps, np.sqrt(CURVE_LATERAL_MPS2 / np.maximum(curvature, 1e-3)))
    for i in range(len(speed) - 2, -1, -1):
        speed[i] = min(speed[i], math.sqrt(speed[i + 1] ** 2 + 2 * CURVE_BRAKING_MPS2 * 0.5))
    return speed
