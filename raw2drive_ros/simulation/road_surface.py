"""What lies where on the ground of a scene: lanes by direction, junctions, shoulders, sidewalks, as a raster."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from raw2drive_ros.contracts.public import Float64
from raw2drive_ros.simulation.junction_builder import outline_points
from raw2drive_ros.simulation.roads import Edge, RoadMap

PIXELS_PER_M = 4.0
MARGIN_M = 4.0
SHIFT = 4
# SHOULDER: paved, but no lane; parked cars stand there. FORWARD: a lane in the direction of the ego's chain, on a ramp
# too. BACKWARD: a lane of oncoming traffic. ARM: a lane of another road.
OFF, SIDEWALK, SHOULDER, FORWARD, BACKWARD, JUNCTION, ARM = range(7)


class RoadSurface:
    """`kind_at(points_m)` looks points up; outside of the raster is OFF."""

    def __init__(self, road: RoadMap) -> None:
        points = np.concatenate([*road.sidewalks_m, *road.surfaces_m])
        self.origin_m: Float64 = points.min(axis=0) - MARGIN_M
        columns, rows = np.ceil((points.max(axis=0) + MARGIN_M - self.origin_m) * PIXELS_PER_M).astype(int).tolist()
        self.kinds: NDArray[np.uint8] = np.full((rows, columns), OFF, np.uint8)
        for polygon in road.sidewalks_m:
            self._fill(polygon, SIDEWALK)
        for polygon in road.surfaces_m:
            self._fill(polygon, SHOULDER)
        forward = {*road.lanes_along(oncoming=False), *road.ramp, *road.exit}
        backward = set(road.lanes_along(oncoming=True))
        for start, ends in road.network.graph.items():
            for end, lanes in ends.items():
                for lane in lanes:
                    if lane.junction < 0:
                        half = lane.width / 2
                        self._fill(outline_points(lane, half, -half), _kind((start, end), forward, backward))
        for site in road.junctions:
            self._fill(site.outline_m, JUNCTION)
        for polygon in road.islands_m:
            self._fill(polygon, SIDEWALK)

    def _fill(self, polygon_m: Float64, kind: int) -> None:
        fixed = np.round(((polygon_m - self.origin_m) * PIXELS_PER_M - 0.5) * 2**SHIFT).astype(np.int32)
        cv2.fillPoly(self.kinds, [fixed], kind, shift=SHIFT)

    def kind_at(self, points_m: Float64) -> NDArray[np.uint8]:
        """(N,) what is at each of the (N, 2) points."""
        place = np.floor((points_m - self.origin_m) * PIXELS_PER_M).astype(int)
        rows, columns = self.kinds.shape
        inside = (place >= 0).all(axis=1) & (place[:, 0] < columns) & (place[:, 1] < rows)
        place[~inside] = 0
        return np.where(inside, self.kinds[place[:, 1], place[:, 0]], OFF).astype(np.uint8)


def _kind(edge: Edge, forward: set[Edge], backward: set[Edge]) -> int:
    return FORWARD if edge in forward else BACKWARD if edge in backward else ARM
