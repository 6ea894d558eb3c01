"""What lies where on the ground of a scene, as a raster: lanes by direction, junctions, shoulders, bays, sidewalks."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from raw2drive_ros.contracts.public import Float64

PIXELS_PER_M = 4.0
MARGIN_M = 4.0
SHIFT = 4
# SHOULDER: paved, but no lane. PARKING: bays. FORWARD: a lane in the direction of the ego's chain, on a ramp
# too. BACKWARD: a lane of oncoming traffic. ARM: a lane of another road.
OFF, SIDEWALK, SHOULDER, FORWARD, BACKWARD, JUNCTION, ARM, PARKING = range(8)


class RoadSurface:
    """`kind_at(points_m)` looks points up; outside of the raster is OFF."""

    def __init__(self, extent_m: Float64) -> None:
        """extent_m: (N, 2) points that it has to reach."""
        self.origin_m: Float64 = extent_m.min(axis=0) - MARGIN_M
        columns, rows = np.ceil((extent_m.max(axis=0) + MARGIN_M - self.origin_m) * PIXELS_PER_M).astype(int).tolist()
        self.kinds: NDArray[np.uint8] = np.full((rows, columns), OFF, np.uint8)

    def copy(self) -> RoadSurface:
        """An independent copy."""
        found = RoadSurface.__new__(RoadSurface)
        found.origin_m, found.kinds = self.origin_m, self.kinds.copy()
        return found

    def fill(self, polygon_m: Float64, kind: int) -> None:
        """Set the kind of an (N, 2) polygon."""
        fixed = np.round(((polygon_m - self.origin_m) * PIXELS_PER_M - 0.5) * 2**SHIFT).astype(np.int32)
        cv2.fillPoly(self.kinds, [fixed], kind, shift=SHIFT)

    def kind_at(self, points_m: Float64) -> NDArray[np.uint8]:
        """(N,) what is at each of the (N, 2) points."""
        place = np.floor((points_m - self.origin_m) * PIXELS_PER_M).astype(int)
        rows, columns = self.kinds.shape
        inside = (place >= 0).all(axis=1) & (place[:, 0] < columns) & (place[:, 1] < rows)
        place[~inside] = 0
        return np.where(inside, self.kinds[place[:, 1], place[:, 0]], OFF).astype(np.uint8)
