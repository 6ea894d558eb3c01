"""Lanes: straights and arcs in plain `math` (highway-env's own spend their time on numpy scalars), and any line."""

from __future__ import annotations

import math

import numpy as np
from highway_env.road.lane import AbstractLane, LineType

from raw2drive_ros.contracts.public import Float64
from raw2drive_ros.simulation.path import Path


class ArcLane(AbstractLane):
    """A lane of constant curvature (0 = straight). Lateral coordinates are positive to the LEFT.

    start_m: (x, y) of the centre line's start in `map`. curvature: 1/m, positive turns left. junction: number of the
    junction that the lane crosses, -1 outside of junctions. to_lane: index of the lane that it leads into on the next
    edge; None: of the same index; from_lane: of the lane on the edge before.
    """

    forbidden = False
    priority = 0

    def __init__(
        self,
        start_m: tuple[float, float],
        heading_rad: float,
        length_m: float,
        curvature: float,
        width_m: float,
        speed_limit_mps: float,
    ) -> None:
        self.start_m = start_m
        self.heading_rad = heading_rad
        self.length = length_m
        self.curvature = curvature
        self.width = width_m
        self.speed_limit = speed_limit_mps
        self.line_types = [LineType.NONE, LineType.NONE]
        self.junction = -1
        self.to_lane: int | None = None
        self.from_lane: int | None = None

    def pose(self, longitudinal: float, lateral: float = 0.0) -> tuple[float, float, float]:
        """(x, y, yaw) in `map`."""
        x, y = self.start_m
        yaw = self.heading_rad
        if abs(self.curvature) < 1e-9:
            x += longitudinal * math.cos(yaw)
            y += longitudinal * math.sin(yaw)
        else:
            end = yaw + longitudinal * self.curvature
            x += (math.sin(end) - math.sin(yaw)) / self.curvature
            y -= (math.cos(end) - math.cos(yaw)) / self.curvature
            yaw = end
        return x - lateral * math.sin(yaw), y + lateral * math.cos(yaw), yaw

    def position(self, longitudinal: float, lateral: float) -> Float64:
        return np.array(self.pose(longitudinal, lateral)[:2])

    def local_coordinates(self, position: Float64) -> tuple[float, float]:
        delta_x = float(position[0]) - self.start_m[0]
        delta_y = float(position[1]) - self.start_m[1]
        cos, sin = math.cos(self.heading_rad), math.sin(self.heading_rad)
        along = delta_x * cos + delta_y * sin
        left = -delta_x * sin + delta_y * cos
        if abs(self.curvature) < 1e-9:
            return along, left
        radius = 1.0 / self.curvature
        angle = math.atan2(along, (radius - left) * math.copysign(1, radius))
        distance = math.hypot(along, radius - left)
        return angle * abs(radius), (abs(radius) - distance) * math.copysign(1, radius)

    def heading_at(self, longitudinal: float) -> float:
        return self.heading_rad + longitudinal * self.curvature

    def width_at(self, longitudinal: float) -> float:
        return self.width

    def centre_line(self, spacing_m: float = 1.0, lateral_m: float = 0.0) -> Float64:
        """(N, 2) points along the lane at a lateral offset."""
        count = max(2, math.ceil(self.length / spacing_m) + 1)
        return np.array([self.pose(s, lateral_m)[:2] for s in np.linspace(0.0, self.length, count)])

    def to_config(self) -> dict[str, object]:
        return {
            'class_path': f'{type(self).__module__}.{type(self).__name__}',
            'config': {
                'start_m': list(self.start_m),
                'heading_rad': self.heading_rad,
                'length_m': self.length,
                'curvature': self.curvature,
                'width_m': self.width,
                'speed_limit_mps': self.speed_limit,
            },
        }

    @classmethod
    def from_config(cls, config: dict[str, object]) -> ArcLane:
        return cls(**config)  # type: ignore[arg-type]


class PolyLane(ArcLane):
    """A lane along any smooth line. points_m: (N, 2), at most a metre apart. `curvature` is its mean."""

    def __init__(self, points_m: Float64, width_m: float, speed_limit_mps: float) -> None:
        self.line = Path(points_m)
        length = float(np.hypot(*np.diff(points_m, axis=0).T).sum())
        turn = float(self.line.headings_rad[-1] - self.line.headings_rad[0])
        start = (float(points_m[0, 0]), float(points_m[0, 1]))
        super().__init__(start, float(self.line.headings_rad[0]), length, turn / length, width_m, speed_limit_mps)

    def pose(self, longitudinal: float, lateral: float = 0.0) -> tuple[float, float, float]:
        return self.line.pose(longitudinal, lateral)

    def local_coordinates(self, position: Float64) -> tuple[float, float]:
        return self.line.project(float(position[0]), float(position[1]))

    def heading_at(self, longitudinal: float) -> float:
        return self.line.pose(longitudinal)[2]


def blend_m(begin: tuple[float, float, float], end: tuple[float, float, float], spacing_m: float = 0.5) -> Float64:
    """(N, 2) points of a cubic Bezier curve between two poses (x, y, yaw); close to an arc where an arc fits."""
    reach = 0.39 * math.hypot(end[0] - begin[0], end[1] - begin[1])
    a, d = np.array(begin[:2]), np.array(end[:2])
    b = a + reach * np.array((math.cos(begin[2]), math.sin(begin[2])))
    c = d - reach * np.array((math.cos(end[2]), math.sin(end[2])))
    count = max(4, math.ceil(3.0 * reach / spacing_m))
    t = np.linspace(0.0, 1.0, count + 1)[:, None]
    return (1 - t) ** 3 * a + 3 * (1 - t) ** 2 * t * b + 3 * (1 - t) * t**2 * c + t**3 * d
