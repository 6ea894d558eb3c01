"""From sensor samples to the raw stream's vector: used by the planner, the trainer and replay alike."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from raw2drive_ros.contracts.public import ImuSample, OdometrySample, Route
from raw2drive_ros.driving.route_line import SAME_PLACE_M, RouteLine
from raw2drive_ros.tables.vector_layout import CHECKPOINT_SCALE_M, CHECKPOINTS_AHEAD

# A checkpoint is passed when it is this far ahead of the car, in the car's own axes ...
REACHED_AHEAD_M = 4.0
# ... and no further than this along the route: behind a U-turn or a sharp corner, and for a car that is turned
# sideways, it can be beside or behind the car long before the car gets there.
REACHED_ALONG_M = 6.0
# A checkpoint this far behind along the route is passed, wherever the car looks.
BEHIND_M = 4.0
# How far along the route the car can get between two samples beyond the distance that it has driven: what it gains
# where it cuts a corner of the line through the checkpoints.
GAIN_M = 8.0
# The car may be on a later stretch of the route, no further than this many times the distance that it has driven since
# it last got on: a driver who turns early, or takes a short cut, is not sent back.
SHORT_CUT = 2.0


@dataclass(slots=True)
class RouteProgress:
    """Which checkpoint comes next: the first one ahead along the route. Starts anew with every new route.

    Where the car is along the route (`arc_m`, metres from the first checkpoint) only grows, and by no more than the car
    can have driven; with it, checkpoints are passed one after the other. A route that comes by the same place twice, or
    turns back beside itself, is therefore followed in its order.
    """

    route: Route | None = None
    next_index: int = 0
    arc_m: float = 0.0
    _line: RouteLine | None = None
    _here_m: tuple[float, float] = (0.0, 0.0)
    _driven_m: float = 0.0

    def update(self, route: Route, odometry: OdometrySample) -> None:
        """Pass every checkpoint that the car has reached."""
        if self.route is None or self._line is None or route.stamp_ns != self.route.stamp_ns:
            self.route, self.next_index, self._line = route, 0, RouteLine(route.checkpoints_m)
            self.arc_m = self._line.locate(odometry.x_m, odometry.y_m, odometry.yaw_rad)
            self._driven_m = 0.0
        else:
            self._get_on(self._line, odometry)
        self._here_m = odometry.x_m, odometry.y_m
        last = len(self.route.checkpoints_m) - 1
        while self.next_index < last and self._reached(self.route, self._line, odometry):
            self.next_index += 1

    def _get_on(self, line: RouteLine, odometry: OdometrySample) -> None:
        """Move along the route with the car."""
        x, y = odometry.x_m, odometry.y_m
        step_m = math.hypot(x - self._here_m[0], y - self._here_m[1])
        self._driven_m += step_m
        yaw = odometry.yaw_rad
        found = line.nearest(x, y, yaw, self.arc_m, self.arc_m + step_m + GAIN_M, along=False)
        if found.distance_m > SAME_PLACE_M:
            to_m = self.arc_m + SHORT_CUT * self._driven_m + GAIN_M
            later = line.nearest(x, y, yaw, found.arc_m, to_m, along=True)
            found = later if later.distance_m < found.distance_m else found
        if found.arc_m > self.arc_m:
            self.arc_m, self._driven_m = found.arc_m, 0.0

    def _reached(self, route: Route, line: RouteLine, odometry: OdometrySample) -> bool:
        along_m = line.stations_m[self.next_index] - self.arc_m
        if along_m < -BEHIND_M:
            return True
        ahead_m, _ = _in_base(route.checkpoints_m[self.next_index], odometry)
        return along_m <= REACHED_ALONG_M and ahead_m <= REACHED_AHEAD_M


def _in_base(point_m: NDArray[np.float64], odometry: OdometrySample) -> tuple[float, float]:
    dx, dy = float(point_m[0]) - odometry.x_m, float(point_m[1]) - odometry.y_m
    cos, sin = math.cos(odometry.yaw_rad), math.sin(odometry.yaw_rad)
    return dx * cos + dy * sin, -dx * sin + dy * cos


def raw_vector(imu: ImuSample, odometry: OdometrySample, progress: RouteProgress) -> NDArray[np.float32]:
    """(10,) float32 in the order of `VECTOR_FIELDS`: motion, then the next checkpoints in `base_link` / 25 m.

    Checkpoints beyond the goal repeat the goal. Raises ValueError before the first `progress.update`.
    """
    if progress.route is None:
        raise ValueError('raw_vector: no route yet')
    values = [
        odometry.speed_mps,
        odometry.yaw_rate_radps,
        imu.specific_force_mps2[0],
        imu.specific_force_mps2[1],
    ]
    points = progress.route.checkpoints_m
    for i in range(CHECKPOINTS_AHEAD):
        index = min(progress.next_index + i, len(points) - 1)
        x, y = _in_base(points[index], odometry)
        values += [x / CHECKPOINT_SCALE_M, y / CHECKPOINT_SCALE_M]
    return np.array(values, np.float32)
