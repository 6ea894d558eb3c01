"""What the expert knows of the road: every lane, what follows it, and which lanes run beside the ego's route.

It is what a map holds. Nothing here depends on where anybody is or wants to go.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from raw2drive_ros.contracts.public import Float64
from raw2drive_ros.simulation.lanes import ArcLane
from raw2drive_ros.simulation.layout import LANE_WIDTH_M
from raw2drive_ros.simulation.path import SPACING_M, Path
from raw2drive_ros.simulation.world import World

Ints = NDArray[np.int64]
# Spacing of the points that lanes are looked up by.
SAMPLE_M = 2.0
JOINED_M, JOINED_COS = 1.2, 0.95
ALIGNED_COS = 0.6
# Farthest from a lane's centre line that a vehicle counts as in the lane; on connectors, which overlap, less.
IN_LANE_M, ON_CONNECTOR_M = 2.1, 1.3
REACHES_M = (60.0, 150.0)
MOST_CONTINUATIONS = 6
TURN_RAD = 0.4
# Stations along the route at which the lanes beside it are known.
BESIDE_STEP_M = 4.0
ONCOMING, NOTHING, FORWARD = -1, 0, 1


@dataclass(frozen=True, slots=True)
class Continuation:
    """One way on from a lane. path: from the lane's start on. offsets_m: lane index -> arc length of its start on it.
    crossings: (junction, arc length of entry and exit, turn) of each junction on it; turn: left, ahead or right."""

    path: Path
    offsets_m: dict[int, float]
    crossings: tuple[tuple[int, float, float, str], ...]


@dataclass(frozen=True, slots=True)
class Place:
    """Where a vehicle is on a lane: index of the lane, arc length, lateral offset and heading error (left positive)."""

    lane: int
    s_m: float
    lateral_m: float
    error_rad: float


class LaneMap:
    """The lanes of a world's road. spans: (entry, exit, junction) of each junction along the route."""

    def __init__(self, world: World) -> None:
        graph = world.road.network.graph
        self.lanes: list[ArcLane] = [lane for ends in graph.values() for lanes in ends.values() for lane in lanes]
        self.width_m: float = getattr(world.scene.layout, 'lane_width_m', LANE_WIDTH_M)
        stations = [_stations(lane.length) for lane in self.lanes]
        self.lane_of: Ints = np.repeat(np.arange(len(self.lanes)), [len(s) for s in stations])
        self.s_of: Float64 = np.concatenate(stations)
        poses = [lane.pose(float(s)) for lane, along in zip(self.lanes, stations, strict=True) for s in along]
        x, y, yaw = np.array(poses).T
        self.x, self.y, self.cos, self.sin = x, y, np.cos(yaw), np.sin(yaw)
        self.junction_of: Ints = np.array([lane.junction for lane in self.lanes])[self.lane_of]
        self.successors = _successors(self.lanes)
        self.known: dict[tuple[int, float], list[Continuation]] = {}
        self._beside(world.route)

    def _beside(self, route: Path) -> None:
        """Which lanes run beside the route, and where it crosses junctions."""
        self.route_start_m: float = getattr(route, 'start_s_m', 0.0)
        self.beside_s: Float64 = self.route_start_m + np.arange(0.0, route.length_m, BESIDE_STEP_M)
        self.beside: dict[int, Ints] = {}
        for side in (-2, -1, 0, 1, 2):
            poses = np.array([route.pose(float(s), side * self.width_m) for s in self.beside_s])
            self.beside[side] = self._directions(poses)
        poses = np.array([route.pose(float(s)) for s in self.beside_s])
        junctions = self._junctions(poses)
        self.spans: list[tuple[float, float, int]] = []
        for s, junction in zip(self.beside_s.tolist(), junctions.tolist(), strict=True):
            if junction < 0:
                continue
            if self.spans and self.spans[-1][2] == junction:
                self.spans[-1] = (self.spans[-1][0], s, junction)
            else:
                self.spans.append((s, s, junction))
        self.spans = [self._exact(route, span) for span in self.spans]

    def _exact(self, route: Path, span: tuple[float, float, int]) -> tuple[float, float, int]:
        """A span of the route with its ends found to 0.5 m."""
        fine = np.arange(max(span[0] - BESIDE_STEP_M, self.route_start_m), span[1] + BESIDE_STEP_M, 0.5)
        inside = self._junctions(np.array([route.pose(float(s)) for s in fine])) == span[2]
        return float(fine[inside][0]), float(fine[inside][-1]), span[2]

    def _junctions(self, poses: Float64) -> Ints:
        """(N,) junction that each pose of the route lies in, or -1."""
        lane, _, lateral, along = self._nearest(poses)
        found = np.array([self.lanes[i].junction for i in lane])
        found[(np.abs(lateral) > self.width_m) | (along > 1.0)] = -1
        return found

    def _directions(self, poses: Float64) -> Ints:
        """(N,) FORWARD, ONCOMING or NOTHING: which kind of lane each pose lies in, seen along its heading."""
        found = np.full(len(poses), NOTHING)
        _, _, lateral, along = self._nearest(poses)
        found[(np.abs(lateral) < 0.35 * self.width_m) & (along < 1.0)] = FORWARD
        turned = poses + np.array((0.0, 0.0, math.pi))
        _, _, lateral, along = self._nearest(turned)
        found[(found == NOTHING) & (np.abs(lateral) < 0.35 * self.width_m) & (along < 1.0)] = ONCOMING
        return found

    def _nearest(self, poses: Float64) -> tuple[Ints, Ints, Float64, Float64]:
        """(lane, sample, lateral offset, distance along beyond the lane's ends) of the nearest aligned lane."""
        squared, facing = self._distances(poses)
        squared[facing < ALIGNED_COS] = np.inf
        sample = squared.argmin(axis=1)
        dx, dy = poses[:, 0] - self.x[sample], poses[:, 1] - self.y[sample]
        lateral = -dx * self.sin[sample] + dy * self.cos[sample]
        along = np.abs(dx * self.cos[sample] + dy * self.sin[sample])
        lateral[~np.isfinite(squared[np.arange(len(poses)), sample])] = np.inf
        return self.lane_of[sample], sample, lateral, along

    def _distances(self, poses: Float64) -> tuple[Float64, Float64]:
        """(N, samples) squared distances and cosines of the difference in heading."""
        dx, dy = poses[:, 0, None] - self.x, poses[:, 1, None] - self.y
        facing = np.cos(poses[:, 2])[:, None] * self.cos + np.sin(poses[:, 2])[:, None] * self.sin
        return dx * dx + dy * dy, facing

    def places(self, poses: Float64) -> list[list[Place]]:
        """The lanes that each of (N, 3) poses may be on, nearest first: none off the road, several in a junction."""
        if not len(poses):
            return []
        squared, facing = self._distances(poses)
        squared[facing < ALIGNED_COS] = np.inf
        found: list[list[Place]] = []
        for row, pose in enumerate(poses):
            best = int(squared[row].argmin())
            places: list[Place] = []
            if squared[row, best] < (IN_LANE_M + SAMPLE_M) ** 2:
                places = self._places(squared[row], pose, best)
            found.append(places)
        return found

    def _places(self, squared: Float64, pose: Float64, best: int) -> list[Place]:
        lanes = [int(self.lane_of[best])]
        if self.junction_of[best] >= 0:
            near = np.flatnonzero(
                (squared < (ON_CONNECTOR_M + 1.0) ** 2) & (self.junction_of == self.junction_of[best])
            )
            lanes += [lane for lane in dict.fromkeys(self.lane_of[near].tolist()) if lane != lanes[0]]
        places = []
        for lane in lanes:
            arc = self.lanes[lane]
            s, lateral = arc.local_coordinates(pose[:2])
            error = math.remainder(float(pose[2]) - arc.heading_at(s), 2.0 * math.pi)
            limit = IN_LANE_M if arc.junction < 0 else ON_CONNECTOR_M
            if abs(lateral) < limit and -SAMPLE_M < s < arc.length + SAMPLE_M:
                places.append(Place(lane, s, lateral, error))
        return places

    def has_lane_beside(self, place: Place, side: int) -> bool:
        """Whether a lane of the same direction runs `side` lanes to the left of a place."""
        pose = np.array([self.lanes[place.lane].pose(place.s_m, side * self.width_m)])
        return any(abs(found.lateral_m) < 0.3 * self.width_m for found in self.places(pose)[0])

    def continuations(self, lane: int, reach_m: float) -> list[Continuation]:
        """Every way on from the start of a lane, until `reach_m` beyond its end."""
        reach = next((r for r in REACHES_M if r >= reach_m), REACHES_M[-1])
        key = (lane, reach)
        if key not in self.known:
            self.known[key] = [self._continuation(chain) for chain in self._chains(lane, reach)]
        return self.known[key]

    def _chains(self, lane: int, reach_m: float) -> list[list[int]]:
        chains, done = [([lane], 0.0)], []
        while chains and len(chains) + len(done) <= MOST_CONTINUATIONS:
            chain, length = chains.pop(0)
            following = [i for i in self.successors[chain[-1]] if i not in chain] if length < reach_m else []
            if not following:
                done.append(chain)
            chains += [([*chain, i], length + self.lanes[i].length) for i in following]
        return (done + [chain for chain, _ in chains])[:MOST_CONTINUATIONS]

    def _continuation(self, chain: list[int]) -> Continuation:
        points, offsets, crossings, length = [], {}, [], 0.0
        for lane in chain:
            arc = self.lanes[lane]
            offsets[lane] = length
            points.append(arc.centre_line(1.0))
            if arc.junction >= 0:
                turned = arc.curvature * arc.length
                turn = 'left' if turned > TURN_RAD else 'right' if turned < -TURN_RAD else 'ahead'
                crossings.append((arc.junction, length, length + arc.length, turn))
            length += arc.length
        return Continuation(Path(np.concatenate(points)), offsets, tuple(crossings))

    def lane_beside(self, s_m: float, side: int) -> int:
        """FORWARD, ONCOMING or NOTHING at `side` lanes to the left of the route's arc length `s_m`."""
        index = round((s_m - self.route_start_m) / BESIDE_STEP_M)
        return int(self.beside[side][min(max(index, 0), len(self.beside_s) - 1)])

    def next_span(self, s_m: float) -> tuple[float, float, int] | None:
        """(entry, exit, junction) of the junction that the route crosses at `s_m` or next, or None."""
        return next((span for span in self.spans if span[1] > s_m), None)


def _stations(length_m: float) -> Float64:
    return np.linspace(0.0, length_m, max(2, math.ceil(length_m / SAMPLE_M) + 1))


def _successors(lanes: list[ArcLane]) -> list[list[int]]:
    """Per lane the lanes that begin where it ends, found by geometry."""
    starts = np.array([lane.pose(0.0) for lane in lanes])
    ends = np.array([lane.pose(lane.length) for lane in lanes])
    apart = np.hypot(ends[:, 0, None] - starts[:, 0], ends[:, 1, None] - starts[:, 1])
    joined = (apart < JOINED_M) & (np.cos(ends[:, 2, None] - starts[:, 2]) > JOINED_COS)
    return [np.flatnonzero(row).tolist() for row in joined]


def poses_at(path: Path, s_m: Float64, lateral_m: Float64 | float = 0.0) -> tuple[Float64, Float64, Float64]:
    """`Path.pose` of arrays: x, y, yaw of the shape of `s_m`; straight on beyond both ends."""
    where = (s_m - getattr(path, 'start_s_m', 0.0)) / SPACING_M
    index = np.minimum(np.maximum(where.astype(np.int64), 0), len(path.points_m) - 2)
    part = where - index
    begin, end = path.points_m[index], path.points_m[index + 1]
    place = begin + part[..., None] * (end - begin)
    blend = np.minimum(np.maximum(part, 0.0), 1.0)
    yaw = path.headings_rad[index] + blend * (path.headings_rad[index + 1] - path.headings_rad[index])
    return place[..., 0] - lateral_m * np.sin(yaw), place[..., 1] + lateral_m * np.cos(yaw), yaw


class RouteFrame:
    """Projects points near the ego onto its route: every second point of the route, then exactly."""

    def __init__(self, route: Path, s_m: float, behind_m: float, ahead_m: float) -> None:
        start = getattr(route, 'start_s_m', 0.0)
        first = max(0, int((s_m - behind_m - start) / SPACING_M))
        last = max(first + 8, int((s_m + ahead_m - start) / SPACING_M))
        step = round(SAMPLE_M / SPACING_M)
        self.points = route.points_m[first:last:step]
        self.yaw = route.headings_rad[first:last:step]
        self.cos, self.sin = np.cos(self.yaw), np.sin(self.yaw)
        self.s = start + SPACING_M * (first + step * np.arange(len(self.points)))

    def project(self, x: Float64, y: Float64) -> tuple[Float64, Float64, Float64]:
        """(arc length, lateral offset, heading of the route there) of points of any shape."""
        dx, dy = x[..., None] - self.points[:, 0], y[..., None] - self.points[:, 1]
        index = np.argmin(dx * dx + dy * dy, axis=-1)
        ahead_x, ahead_y = x - self.points[index, 0], y - self.points[index, 1]
        cos, sin = self.cos[index], self.sin[index]
        along = ahead_x * cos + ahead_y * sin
        lateral = -ahead_x * sin + ahead_y * cos
        last = len(self.s) - 1
        other = np.minimum(np.maximum(index + np.where(along > 0.0, 1, -1), 0), last)
        turn = (self.yaw[other] - self.yaw[index]) * np.minimum(np.abs(along) / SAMPLE_M, 1.0)
        return self.s[index] + along, lateral, self.yaw[index] + turn
