"""Who is first on whose path: the same question for all traffic at once, because it is most of a physics step."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from raw2drive_ros.contract import Float64

if TYPE_CHECKING:
    from raw2drive_ros.simulation.actors import PathVehicle
    from raw2drive_ros.simulation.world import World

LOOK_AHEAD_M = 50.0
MARGIN_M = 0.3
ALIGNED_COS = 0.75
STANDING_MPS = 0.5
# Traffic reacts to an ego that changes lanes once its centre is in theirs, as CARLA's agents do.
IN_LANE_M = 1.4
FAR_M = 1e6
NOBODY = 10_000


def find_leaders(world: World, vehicles: Sequence[PathVehicle]) -> None:
    """Set `gap_m` and `closing_mps` of each vehicle: to the first thing on its path ahead, or (inf, 0)."""
    if not vehicles:
        return
    windows = np.full((len(vehicles), int(LOOK_AHEAD_M), 2), FAR_M)
    for window, vehicle in zip(windows, vehicles, strict=True):
        points = vehicle.path.window(vehicle.s_m, LOOK_AHEAD_M)
        window[: len(points)] = points
    rows = np.array([world.index_of(vehicle) for vehicle in vehicles])
    near = np.abs(world.positions[None] - world.positions[rows, None]).max(axis=2) < LOOK_AHEAD_M
    near[np.arange(len(rows)), rows] = False
    columns = np.flatnonzero(near.any(axis=0))
    if not len(columns):
        gaps, closings = np.full(len(rows), math.inf), np.zeros(len(rows))
    else:
        near = near[:, columns]
        delta = world.positions[columns][None, :, None] - windows[:, None]
        distance2 = np.einsum('vapk,vapk->vap', delta, delta)
        ego = len(world.actors)
        if columns[-1] == ego:
            near[:, -1] &= ~_overlook_ego(world, vehicles, rows, distance2[:, -1])
        gaps, closings = _first(world, rows, columns, near, distance2, MARGIN_M)
    for vehicle, gap, closing in zip(vehicles, gaps.tolist(), closings.tolist(), strict=True):
        vehicle.gap_m, vehicle.closing_mps = gap, closing


def _overlook_ego(world: World, vehicles: Sequence[PathVehicle], rows: Float64, distance2: Float64) -> Float64:
    """(V,) bool: who has priority does not look out for an ego that crosses, and nobody for one beside the lane."""
    if world.ego.speed < STANDING_MPS:
        return np.zeros(len(rows), bool)
    priority = np.array([vehicle.has_priority for vehicle in vehicles])
    crossing = np.cos(world.headings[rows] - world.ego.heading) < ALIGNED_COS
    return (priority & crossing) | (distance2.min(axis=1) > IN_LANE_M**2)


def _first(
    world: World, rows: Float64, columns: Float64, near: Float64, distance2: Float64, margin_m: float
) -> tuple[Float64, Float64]:
    """(free gaps, closing speeds) of followers `rows` towards candidates `columns`; inf where nobody is ahead."""
    half = world.half_widths[columns]
    reach = half[None] + world.half_widths[rows, None] + margin_m
    hits = distance2 < (reach**2)[:, :, None]
    first = np.where(hits.any(axis=2) & near, hits.argmax(axis=2), NOBODY)
    best = first.argmin(axis=1)
    every = np.arange(len(rows))
    at = first[every, best]
    other = columns[best]
    cos = np.cos(world.headings[rows] - world.headings[other])
    gap = at + reach[every, best] * 0.5 - world.half_lengths[rows] - world.half_lengths[other] * np.abs(cos)
    nobody = at == NOBODY
    closing = world.speeds[rows] - world.speeds[other] * cos
    return np.where(nobody, math.inf, np.maximum(gap, 0.05)), np.where(nobody, 0.0, closing)


def first_on_path(world: World, row: int, window_m: Float64, margin_m: float, reach_m: float) -> tuple[float, float]:
    """(free gap, closing speed) from the actor in row `row` of the world's arrays to the first thing that reaches
    into its corridor, or (inf, 0).

    window_m: (M, 2) points of its path, 1 m apart, from where it is. margin_m: room on either side of it.
    """
    near = np.abs(world.positions - world.positions[row]).max(axis=1) < reach_m
    near[row] = False
    columns = np.flatnonzero(near)
    if not len(columns) or not len(window_m):
        return math.inf, 0.0
    delta = world.positions[columns][:, None] - window_m[None]
    distance2 = np.einsum('apk,apk->ap', delta, delta)
    gap, closing = _first(world, np.array([row]), columns, np.ones((1, len(columns)), bool), distance2[None], margin_m)
    return float(gap[0]), float(closing[0])
