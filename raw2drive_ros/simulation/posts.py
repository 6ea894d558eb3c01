"""Where signs and lamps of a junction stand: beside the road, on ground that nobody drives on, for every approach."""

from __future__ import annotations

import itertools
import math

import numpy as np

from raw2drive_ros.contracts.public import Float64
from raw2drive_ros.simulation.road_surface import OFF, SIDEWALK
from raw2drive_ros.simulation.roads import Pose, RoadMap, advance

# A sign stands so far before the stop line; posts stand so far from the edge of the pavement.
SIGN_BEFORE_M, BESIDE_M = 0.4, 0.8
# A lamp stands so far beyond the junction, or at the nearest free place that its approach sees straight ahead.
BEYOND_M, STEP_M, LEAST_M = 1.0, 1.5, 9.0
WIDEST_RAD = 0.4
CLEAR_M = 0.4
AROUND = np.array([(0.0, 0.0), (1.0, 0.0), (-1.0, 0.0), (0.0, 1.0), (0.0, -1.0)]) * CLEAR_M


def sign_pole(road: RoadMap, junction: int, arm: str) -> Pose:
    """The pole of a sign that approach `arm` sees: right of the road at the stop line, looking back along it."""
    site = road.junctions[junction]
    line = advance(site.inlets[arm], -site.spec.line_before_m(arm) - SIGN_BEFORE_M)
    for more in np.arange(0.0, 12.0, 0.5).tolist():
        place = advance(line, 0.0, -(_beside_m(road) + more), math.pi)
        if _is_free(road, place):
            return place
    return advance(line, 0.0, -_beside_m(road), math.pi)


def lamp_pole(road: RoadMap, junction: int, arm: str) -> Pose:
    """The pole of a lamp that approach `arm` sees: beyond the junction and right of it where there is room."""
    site = road.junctions[junction]
    inlet, whole = site.inlets[arm], 2.0 * site.half_size_m
    wanted = (whole + BEYOND_M, -_beside_m(road))
    along = np.arange(wanted[0] - whole, wanted[0] + 6.0, STEP_M)
    aside = np.concatenate([wanted[1] + np.arange(0.0, 8.0, STEP_M), wanted[1] - np.arange(STEP_M, 10.0, STEP_M)])
    places = sorted(
        itertools.product(along.tolist(), aside.tolist()),
        key=lambda place: (math.hypot(place[0] - wanted[0], place[1] - wanted[1]), place),
    )
    for forward, left in places:
        seen = forward >= LEAST_M and abs(math.atan2(left + road.layout.lane_width_m / 2, forward)) < WIDEST_RAD
        place = advance(inlet, forward, left, math.pi)
        if seen and _is_free(road, place):
            return place
    return advance(inlet, *wanted, math.pi)


def _beside_m(road: RoadMap) -> float:
    return road.layout.forward_lanes * road.layout.lane_width_m + max(road.layout.shoulder_m + BESIDE_M, 1.5)


def _is_free(road: RoadMap, pose: Pose) -> bool:
    """Whether a post at a pose stands on no road."""
    assert road.surface is not None
    points: Float64 = AROUND + pose[:2]
    return bool(np.isin(road.surface.kind_at(points), (OFF, SIDEWALK)).all())
