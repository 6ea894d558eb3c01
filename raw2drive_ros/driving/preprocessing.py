"""From sensor samples to the raw stream's vector: used by the planner, the trainer and replay alike."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from raw2drive_ros.contracts.public import ImuSample, OdometrySample, Route
from raw2drive_ros.tables.vector_layout import CHECKPOINT_SCALE_M, CHECKPOINTS_AHEAD

REACHED_AHEAD_M = 4.0


@dataclass(slots=True)
class RouteProgress:
    """Which checkpoint comes next; moves forward only, and starts anew with every new route."""

    route: Route | None = None
    next_index: int = 0

    def update(self, route: Route, odometry: OdometrySample) -> None:
        """Pass every checkpoint that is no longer ahead of the car."""
        if self.route is None or route.stamp_ns != self.route.stamp_ns:
            self.route, self.next_index = route, 0
        last = len(route.checkpoints_m) - 1
        while self.next_index < last:
            ahead, _ = _in_base(route.checkpoints_m[self.next_index], odometry)
            if ahead > REACHED_AHEAD_M:
                break
            self.next_index += 1


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
