"""Polylines parametrised by arc length: the ego's route and the paths of all traffic."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import numpy as np

from raw2drive_ros.contracts.public import Float64

SPACING_M = 0.5


class Path:
    """A polyline in `map`, resampled to equal steps of `SPACING_M`.

    points_m: (N, 2). headings_rad: (N,), unwrapped, so they can be interpolated. start_s_m: arc length of the first
    point, negative where the path begins before the place that arc lengths are counted from. length_m: arc length of
    the last point. end_s_m: where what the path is for ends (a route's road goes on beyond it); `length_m` by default.
    Lateral offsets are positive to the left.
    """

    def __init__(self, points_m: Float64, start_s_m: float = 0.0, end_s_m: float | None = None) -> None:
        steps = np.hypot(*np.diff(points_m, axis=0).T)
        keep = np.concatenate(([True], steps > 1e-6))
        points_m = points_m[keep]
        distance = np.concatenate(([0.0], np.cumsum(np.hypot(*np.diff(points_m, axis=0).T))))
        count = max(2, int(distance[-1] / SPACING_M) + 1)
        wanted = np.arange(count) * SPACING_M
        self.points_m: Float64 = np.stack([np.interp(wanted, distance, points_m[:, axis]) for axis in (0, 1)], axis=1)
        tangents = np.gradient(self.points_m, axis=0)
        self.headings_rad: Float64 = np.unwrap(np.arctan2(tangents[:, 1], tangents[:, 0]))
        self.start_s_m = start_s_m
        self.length_m = start_s_m + float(wanted[-1])
        self.end_s_m = self.length_m if end_s_m is None else end_s_m
        # Lists of Python floats: scalar look-ups are the simulator's hottest code, and lists are faster there.
        self._x = self.points_m[:, 0].tolist()
        self._y = self.points_m[:, 1].tolist()
        self._heading = self.headings_rad.tolist()

    def pose(self, s_m: float, lateral_m: float = 0.0) -> tuple[float, float, float]:
        """(x, y, yaw) at arc length `s_m`; extrapolated straight beyond both ends."""
        last = len(self._x) - 2
        place = (s_m - self.start_s_m) / SPACING_M
        index = min(max(int(place), 0), last)
        part = place - index
        x = self._x[index] + part * (self._x[index + 1] - self._x[index])
        y = self._y[index] + part * (self._y[index + 1] - self._y[index])
        blend = min(max(part, 0.0), 1.0)
        yaw = self._heading[index] + blend * (self._heading[index + 1] - self._heading[index])
        return x - lateral_m * math.sin(yaw), y + lateral_m * math.cos(yaw), yaw

    def index_at(self, s_m: float) -> int:
        """Index of the point at or before arc length `s_m`; of the first or last one beyond the ends."""
        return min(max(int((s_m - self.start_s_m) / SPACING_M), 0), len(self._x) - 1)

    def station(self, index: int) -> float:
        """Arc length of point `index`."""
        return self.start_s_m + index * SPACING_M

    def near(self, s_m: float, window_m: float) -> tuple[int, int]:
        """(first, last + 1) index of the points within `window_m` of arc length `s_m`; at least two."""
        # Beyond an end of the path the hint, too, lies outside it.
        along_m = min(max(s_m, self.start_s_m), self.length_m) - self.start_s_m
        first = max(0, int((along_m - window_m) / SPACING_M))
        last = min(len(self._x), int((along_m + window_m) / SPACING_M) + 2)
        return min(first, last - 2), last

    def project(
        self, x_m: float, y_m: float, hint_s_m: float | None = None, window_m: float = 15.0
    ) -> tuple[float, float]:
        """(arc length, signed lateral offset) of the nearest point, near `hint_s_m` when given."""
        if hint_s_m is None:
            first, last = 0, len(self._x)
        else:
            first, last = self.near(hint_s_m, window_m)
        delta_x = self.points_m[first:last, 0] - x_m
        delta_y = self.points_m[first:last, 1] - y_m
        index = first + int(np.argmin(delta_x * delta_x + delta_y * delta_y))
        yaw = self._heading[index]
        ahead_x, ahead_y = x_m - self._x[index], y_m - self._y[index]
        along = ahead_x * math.cos(yaw) + ahead_y * math.sin(yaw)
        lateral = -ahead_x * math.sin(yaw) + ahead_y * math.cos(yaw)
        return self.station(index) + along, lateral

    def project_many(self, points_m: Float64, hint_s_m: float, window_m: float) -> tuple[Float64, Float64]:
        """`project` of (N, 2) points near one hint: (arc lengths, signed lateral offsets), each (N,)."""
        first, last = self.near(hint_s_m, window_m)
        own = self.points_m[first:last]
        dx, dy = points_m[:, 0, None] - own[None, :, 0], points_m[:, 1, None] - own[None, :, 1]
        index = np.argmin(dx * dx + dy * dy, axis=1)
        every = np.arange(len(points_m))
        ahead_x, ahead_y = dx[every, index], dy[every, index]
        cos, sin = np.cos(self.headings_rad[first + index]), np.sin(self.headings_rad[first + index])
        stations = self.start_s_m + (first + index) * SPACING_M
        return stations + ahead_x * cos + ahead_y * sin, -ahead_x * sin + ahead_y * cos

    def window(self, s_m: float, ahead_m: float) -> Float64:
        """(M, 2) points from `s_m` to `s_m + ahead_m`, 1 m apart."""
        first = self.index_at(s_m)
        return self.points_m[first : first + int(ahead_m / SPACING_M) : 2]

    def curvature(self, s_m: float, ahead_m: float) -> float:
        """Largest |curvature| (1/m) between `s_m` and `s_m + ahead_m`, over 2 m chords."""
        first = self.index_at(s_m)
        headings = self.headings_rad[first : first + int(ahead_m / SPACING_M) + 5]
        if len(headings) < 6:
            return 0.0
        return float(np.max(np.abs(headings[4:] - headings[:-4]))) / (4 * SPACING_M)

    def shifted(self, lateral_at: Callable[[float], float]) -> Path:
        """The path shifted to the left by `lateral_at(s)` metres (lane changes)."""
        offsets = np.array([lateral_at(self.station(i)) for i in range(len(self._x))])
        normal = np.stack([-np.sin(self.headings_rad), np.cos(self.headings_rad)], axis=1)
        shifted = Path(self.points_m + offsets[:, None] * normal, self.start_s_m)
        end = self.pose(self.end_s_m, lateral_at(self.end_s_m))
        shifted.end_s_m = shifted.project(end[0], end[1])[0]
        return shifted


# Path, (N, 2) points near it, and a hint of their arc length.
Query = tuple[Path, Float64, float]


def project_groups(queries: Sequence[Query], window_m: float) -> list[tuple[Float64, Float64]]:
    """`project_many` of several queries at once: the same as one after the other, in less time."""
    if len(queries) == 1:
        path, points, hint = queries[0]
        return [path.project_many(points, hint, window_m)]
    if not queries:
        return []
    windows = [path.near(hint, window_m) for path, _, hint in queries]
    counts = [len(points) for _, points, _ in queries]
    lengths = np.array([last - first for first, last in windows])
    begins = np.cumsum(lengths) - lengths
    of = np.repeat(np.arange(len(queries)), counts)
    # Rows beyond a shorter window repeat its last point, which is never the first of the nearest ones.
    rows = begins[of, None] + np.minimum(np.arange(lengths.max()), lengths[of, None] - 1)
    own = np.concatenate([path.points_m[first:last] for (path, _, _), (first, last) in zip(queries, windows)])
    headings = np.concatenate([path.headings_rad[first:last] for (path, _, _), (first, last) in zip(queries, windows)])
    points_m = np.concatenate([points for _, points, _ in queries])
    dx, dy = points_m[:, 0, None] - own[:, 0][rows], points_m[:, 1, None] - own[:, 1][rows]
    index = np.argmin(dx * dx + dy * dy, axis=1)
    every = np.arange(len(points_m))
    ahead_x, ahead_y = dx[every, index], dy[every, index]
    yaw = headings[begins[of] + index]
    cos, sin = np.cos(yaw), np.sin(yaw)
    first_index = np.array([first for first, _ in windows])[of] + index
    stations = np.array([path.start_s_m for path, _, _ in queries])[of] + first_index * SPACING_M
    ends = np.cumsum(counts)[:-1]
    found = np.split(stations + ahead_x * cos + ahead_y * sin, ends), np.split(-ahead_x * sin + ahead_y * cos, ends)
    return list(zip(*found))


def smooth_step(value: float, start: float, width: float) -> float:
    """0 before `start`, 1 after `start + width`, a cubic in between."""
    part = min(max((value - start) / max(width, 1e-9), 0.0), 1.0)
    return part * part * (3.0 - 2.0 * part)
