"""A route as a line: how far along it is the car?"""

from __future__ import annotations

import math
from bisect import bisect_left
from collections.abc import Iterator
from itertools import pairwise
from typing import NamedTuple

from raw2drive_ros.contracts.public import Float64

# Two directions agree when they differ by less than 60 degrees.
AGREES = 0.5
# At the start of a drive: a stretch in the car's own direction is preferred to one that is nearer by less than this.
# The other lane of a road is that near.
ROAD_WIDTH_M = 10.0
# Stretches whose distances from the car differ by less than this are equally near; the first along the route counts.
SAME_PLACE_M = 3.0
ROUNDING_M = 1e-6


class Place(NamedTuple):
    """The nearest point of a stretch of the route. arc_m: where it is along the route. cosine: of the angle between
    the route's direction there and the car's."""

    distance_m: float
    arc_m: float
    cosine: float


class RouteLine:
    """The polyline through the (N, 2) checkpoints of a route, in `map`; its first segment is extended backwards.

    stations_m: arc length from the first checkpoint to each of the N.
    """

    def __init__(self, checkpoints_m: Float64) -> None:
        # Floats: the few segments around the car are looked at one by one, at every sample.
        points = [(float(x), float(y)) for x, y in checkpoints_m]
        self.stations_m = [0.0]
        self._segments: list[tuple[float, float, float, float]] = []
        for (x, y), (next_x, next_y) in pairwise(points):
            length_m = math.hypot(next_x - x, next_y - y)
            # Two checkpoints at one place have no direction; nothing is projected onto them but the place itself.
            scale = 1.0 / length_m if length_m else 0.0
            self._segments.append((x, y, (next_x - x) * scale, (next_y - y) * scale))
            self.stations_m.append(self.stations_m[-1] + length_m)

    def locate(self, x_m: float, y_m: float, yaw_rad: float) -> float:
        """Arc length of the car where nothing is known about it: on the nearest stretch; on one in the car's own
        direction if that is about as near; on the first one where the route comes by several times."""
        places = list(self._places(x_m, y_m, -math.inf, math.inf, yaw_rad))
        nearest_m = min(place.distance_m for place in places)
        along = [p for p in places if p.cosine > AGREES and p.distance_m <= nearest_m + ROAD_WIDTH_M]
        usable = along or places
        limit_m = min(place.distance_m for place in usable) + SAME_PLACE_M
        found = next((place for place in usable if place.distance_m <= limit_m), usable[0])
        # Segments of one stretch are about equally near around a checkpoint: of those the nearest.
        for place in usable[usable.index(found) + 1 :]:
            if place.arc_m - found.arc_m > SAME_PLACE_M or place.distance_m >= found.distance_m:
                break
            found = place
        return found.arc_m

    def nearest(self, x_m: float, y_m: float, yaw_rad: float, from_m: float, to_m: float, *, along: bool) -> Place:
        """The nearest point between two arc lengths, the first of equally near ones. along: of stretches in the car's
        direction only; without any, the distance is infinite."""
        found = Place(math.inf, from_m, 1.0)
        for place in self._places(x_m, y_m, from_m, to_m, yaw_rad):
            if place.distance_m < found.distance_m - ROUNDING_M and (place.cosine > AGREES or not along):
                found = place
        return found

    def _places(self, x_m: float, y_m: float, from_m: float, to_m: float, yaw_rad: float) -> Iterator[Place]:
        """The nearest point of every segment between two arc lengths."""
        cos, sin = math.cos(yaw_rad), math.sin(yaw_rad)
        last = len(self._segments) - 1
        for i in range(max(bisect_left(self.stations_m, from_m) - 1, 0), last + 1):
            begin_m, end_m = self.stations_m[i], self.stations_m[i + 1]
            if i and begin_m > to_m:
                return
            x, y, ahead_x, ahead_y = self._segments[i]
            dx, dy = x_m - x, y_m - y
            along_m = dx * ahead_x + dy * ahead_y
            along_m = min(max(along_m, from_m - begin_m, 0.0 if i else -math.inf), end_m - begin_m, to_m - begin_m)
            distance_m = math.hypot(dx - along_m * ahead_x, dy - along_m * ahead_y)
            yield Place(distance_m, begin_m + along_m, cos * ahead_x + sin * ahead_y)
