"""Finds the leading actor on each vehicle's path.

For all vehicles on one path at once, because this takes most of the time of a physics step.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from raw2drive_ros.contracts.public import Float64
from raw2drive_ros.simulation.path import SPACING_M

if TYPE_CHECKING:
    from raw2drive_ros.simulation.actors import PathVehicle
    from raw2drive_ros.simulation.world import World

LOOK_AHEAD_M = 50.0
MARGIN_M = 0.3
ALIGNED_COS = 0.75
STANDING_MPS = 0.5
# Traffic reacts to an ego that changes lanes once the ego's centre is in its lane, as CARLA's agents do.
IN_LANE_M = 1.4
# A vehicle with a larger lateral offset is not on its path.
ON_PATH_M = 1.0
# Upper bound of the half-widths of an actor and a follower plus margin.
REACH_M = 2.8
STRIDE = round(1.0 / SPACING_M)
STEPS = int(LOOK_AHEAD_M)
NO_HIT = 10_000

Ints = NDArray[Any]


def find_leaders(world: World, vehicles: Sequence[PathVehicle]) -> None:
    """Set `gap_m` and `closing_mps` of each vehicle, to the leading actor on its path; (inf, 0) without one.

    Vehicles that ignore traffic are left out.
    """
    groups: dict[int, list[PathVehicle]] = {}
    for vehicle in vehicles:
        groups.setdefault(id(vehicle.path), []).append(vehicle)
    for group in groups.values():
        followers = [vehicle for vehicle in group if not vehicle.ignores_traffic]
        if followers:
            _follow_on_own_path(group, followers)
            _follow_others(world, group, followers)


def _follow_on_own_path(group: Sequence[PathVehicle], followers: Sequence[PathVehicle]) -> None:
    """Set the gaps to the leading vehicles that follow the same path."""
    line = sorted((v for v in group if abs(v.lateral_m) < ON_PATH_M), key=lambda v: v.s_m)
    ahead = {id(v): leader for v, leader in itertools.pairwise(line)}
    for vehicle in followers:
        leader = ahead.get(id(vehicle))
        if leader is None or leader.s_m - vehicle.s_m > LOOK_AHEAD_M:
            vehicle.gap_m, vehicle.closing_mps = math.inf, 0.0
            continue
        gap = leader.s_m - vehicle.s_m - (leader.LENGTH + vehicle.LENGTH) / 2
        vehicle.gap_m, vehicle.closing_mps = max(gap, 0.05), vehicle.speed - leader.speed


def _follow_others(world: World, group: Sequence[PathVehicle], followers: Sequence[PathVehicle]) -> None:
    """Set the gaps to other actors that reach into the path and are nearer than the leading vehicle on it."""
    stations = np.array([max(0, int(vehicle.s_m / SPACING_M)) for vehicle in followers])
    first = int(stations.min())
    points = followers[0].path.points_m[first : int(stations.max()) + STRIDE * STEPS : STRIDE]
    if not len(points):
        return
    low, high = points.min(axis=0) - REACH_M, points.max(axis=0) + REACH_M
    others = ((world.positions > low) & (world.positions < high)).all(axis=1)
    others[[world.index_of(v) for v in group if abs(v.lateral_m) < ON_PATH_M]] = False
    columns = np.flatnonzero(others)
    if not len(columns):
        return
    rows = np.array([world.index_of(vehicle) for vehicle in followers])
    distance2 = _distance2(world.positions[columns], points)
    reach = world.half_widths[columns] + max(v.WIDTH for v in followers) / 2 + MARGIN_M
    at = np.minimum((stations - first) // STRIDE, len(points) - 1)
    steps = _steps_to(distance2 < (reach**2)[:, None], at)
    if columns[-1] == len(world.actors):
        steps[-1, _ignores_ego(world, followers, rows, distance2[-1:], at)] = NO_HIT
    # No vehicle follows itself; this concerns vehicles beside their path, as those on it are no columns.
    steps[columns[:, None] == rows[None]] = NO_HIT
    gaps, closings = _gaps(world, rows, columns, steps, reach)
    for vehicle, gap, closing in zip(followers, gaps.tolist(), closings.tolist(), strict=True):
        if gap < vehicle.gap_m:
            vehicle.gap_m, vehicle.closing_mps = gap, closing


def _distance2(positions_m: Float64, points_m: Float64) -> Float64:
    """(C, P) squared distances."""
    dx = positions_m[:, 0, None] - points_m[None, :, 0]
    dy = positions_m[:, 1, None] - points_m[None, :, 1]
    return dx * dx + dy * dy


def _steps_to(hits: Ints, at: Ints) -> Ints:
    """(C, V) number of points from each vehicle's point `at` on the path to the next one in `hits`, or NO_HIT."""
    index = np.where(hits, np.arange(hits.shape[1]), NO_HIT)
    following = np.minimum.accumulate(index[:, ::-1], axis=1)[:, ::-1]
    steps = following[:, at] - at
    steps[steps >= STEPS] = NO_HIT
    return steps


def _ignores_ego(world: World, followers: Sequence[PathVehicle], rows: Ints, ego_distance2: Float64, at: Ints) -> Ints:
    """(V,) bool: vehicles with priority ignore an ego that crosses, and all ignore an ego that is beside the lane."""
    if world.ego.speed < STANDING_MPS:
        return np.zeros(len(rows), bool)
    priority = np.array([vehicle.has_priority for vehicle in followers])
    crossing = np.cos(world.headings[rows] - world.ego.heading) < ALIGNED_COS
    return (priority & crossing) | (_steps_to(ego_distance2 < IN_LANE_M**2, at)[0] == NO_HIT)


def _gaps(world: World, rows: Ints, columns: Ints, steps: Ints, reach: Float64) -> tuple[Float64, Float64]:
    """(free gaps, closing speeds) of followers `rows` to the nearest of the actors `columns`."""
    best = steps.argmin(axis=0)
    nearest = steps[best, np.arange(len(rows))]
    other = columns[best]
    cos = np.cos(world.headings[rows] - world.headings[other])
    gap = nearest + reach[best] * 0.5 - world.half_lengths[rows] - world.half_lengths[other] * np.abs(cos)
    nobody = nearest == NO_HIT
    closing = world.speeds[rows] - world.speeds[other] * cos
    return np.where(nobody, math.inf, np.maximum(gap, 0.05)), np.where(nobody, 0.0, closing)


def first_on_path(world: World, row: int, window_m: Float64, margin_m: float, reach_m: float) -> tuple[float, float]:
    """(free gap m, closing speed m/s) of the actor in row `row` of the world's arrays to the first actor that reaches
    into its corridor, or (inf, 0).

    window_m: (M, 2) points of its path ahead, 1 m apart. margin_m: clearance on either side. reach_m: only actors
    within this distance along either axis of `map` count.
    """
    near = (np.abs(world.positions - world.positions[row]) < reach_m).all(axis=1)
    near[row] = False
    columns = np.flatnonzero(near)
    if not len(columns) or not len(window_m):
        return math.inf, 0.0
    reach = world.half_widths[columns] + world.half_widths[row] + margin_m
    steps = _steps_to(_distance2(world.positions[columns], window_m) < (reach**2)[:, None], np.array([0]))
    gap, closing = _gaps(world, np.array([row]), columns, steps, reach)
    return float(gap[0]), float(closing[0])
