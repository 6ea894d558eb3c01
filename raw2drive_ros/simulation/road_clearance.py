"""Keeps the roads of a map apart from each other: chain, road before and beyond it, arms, ramps."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from raw2drive_ros.contracts.public import Float64
from raw2drive_ros.simulation.layout import RoadLayout

SIDEWALKS_M = 5.0
# Along the chain, places that are so many clearances apart must be a clearance apart as the crow flies too.
BENDS_WITHIN = 2.5


@dataclass(frozen=True, slots=True)
class Taken:
    """The middle of a road. points_m: (N, 2). stations_m: (N,) along the chain, None for other roads. junction: piece
    whose arm it is."""

    points_m: Float64
    stations_m: Float64 | None = None
    junction: int | None = None


class Clearance:
    """All roads so far. least_m: distance between the middles of two roads of which neither covers the other."""

    def __init__(self, layout: RoadLayout) -> None:
        lanes = max(layout.forward_lanes, layout.backward_lanes)
        beside = 2.0 * layout.shoulder_m + layout.parking_width_m('left') + layout.parking_width_m('right')
        self.least_m = 2.0 * lanes * layout.lane_width_m + SIDEWALKS_M + beside
        self.roads: list[Taken] = []
        # Piece -> (middle, radius within which its roads may be closer).
        self.sites: dict[int, tuple[Float64, float]] = {}

    def add_site(self, piece: int, middle: tuple[float, float], half_size_m: float) -> None:
        """A junction: near it, its roads may be close."""
        self.sites[piece] = np.array(middle), half_size_m + self.least_m

    def take(self, road: Taken) -> bool:
        """Add a road if it is clear of all others; returns whether it is."""
        if not all(self._is_clear(road, other) for other in self.roads):
            return False
        self.roads.append(road)
        return True

    def _is_clear(self, road: Taken, other: Taken) -> bool:
        if road.junction is not None and road.junction == other.junction:
            return True
        own, theirs = road.points_m, other.points_m
        for junction in (road.junction, other.junction):
            if junction is not None:
                own, theirs = (outside(points, *self.sites[junction]) for points in (own, theirs))
        close = within(own, theirs, self.least_m)
        if road.stations_m is not None and other.stations_m is not None:
            apart = np.abs(road.stations_m[:, None] - other.stations_m[None])
            close &= apart > BENDS_WITHIN * self.least_m
        return not close.any()


def outside(points_m: Float64, middle: Float64, radius: float) -> Float64:
    """The points that are farther than `radius` from `middle`."""
    return points_m[np.hypot(points_m[:, 0] - middle[0], points_m[:, 1] - middle[1]) > radius]


def within(points_m: Float64, others_m: Float64, distance_m: float) -> np.ndarray:
    """(N, M) whether points are closer to each other than a distance."""
    gap = points_m[:, None] - others_m[None]
    return np.asarray(np.einsum('abk,abk->ab', gap, gap) < distance_m**2)
