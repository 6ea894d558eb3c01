"""Ways through the road map for traffic: from a lane that begins at the edge of the map to one that ends there.

A course is a chain of lanes of `RoadMap.network`, joined into one path. It lists the junctions that it crosses, with
the arc lengths where they begin and end. `CourseBook` builds courses on demand and keeps them.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from raw2drive_ros.contracts.public import Float64
from raw2drive_ros.simulation.lanes import ArcLane
from raw2drive_ros.simulation.path import SPACING_M, Path
from raw2drive_ros.simulation.roads import SAMPLE_M, RoadMap

# A connector that changes the heading by less is no turn.
STRAIGHT_RAD = 0.5
# Traffic takes curves with this lateral acceleration, and brakes this hard before them.
CURVE_MPS2 = 2.5
BRAKING_MPS2 = 1.8
# Longest chain of lanes of a course.
MAX_LANES = 200
LEFT, AHEAD, RIGHT = 'left', 'ahead', 'right'

LaneRef = tuple[str, str, int]


@dataclass(frozen=True, slots=True)
class Crossing:
    """A junction on a course.

    junction: its number. source_arm, target_arm: left, right, ahead or back, as the ego's chain sees them. connector:
    the lane across the junction. turn: left, ahead or right, as the vehicle sees it. stop_s_m, enter_s_m, leave_s_m:
    arc lengths on the course of the stop line and of the ends of the lane across.
    """

    junction: int
    source_arm: str
    target_arm: str
    connector: LaneRef
    turn: str
    stop_s_m: float
    enter_s_m: float
    leave_s_m: float


@dataclass(frozen=True, slots=True, eq=False)
class Course:
    """A path through the map. lanes: what it consists of. begins_m: (len(lanes) + 1,) arc length at which each begins,
    and the end of the last. speeds_mps: what curves allow, every `SPACING_M`, braking before them included."""

    path: Path
    lanes: tuple[LaneRef, ...]
    begins_m: tuple[float, ...]
    crossings: tuple[Crossing, ...]
    speeds_mps: tuple[float, ...]

    def station_of(self, lane: LaneRef) -> float:
        """Arc length at which a lane of the course begins."""
        return self.begins_m[self.lanes.index(lane)]


def curve_speeds_mps(path: Path) -> tuple[float, ...]:
    """What curves allow at each point of a path: `CURVE_MPS2` sideways, `BRAKING_MPS2` before them."""
    bend = np.abs(np.gradient(path.headings_rad, SPACING_M))
    bend = np.convolve(np.pad(bend, 2, mode='edge'), np.ones(5) / 5, mode='valid')
    squares = (CURVE_MPS2 / np.maximum(bend, 1e-3)).tolist()
    for i in range(len(squares) - 2, -1, -1):
        squares[i] = min(squares[i], squares[i + 1] + 2.0 * BRAKING_MPS2 * SPACING_M)
    return tuple(math.sqrt(square) for square in squares)


class CourseBook:
    """The lane graph of a road and all courses that were asked for. `Path` objects are shared by equal courses."""

    def __init__(self, road: RoadMap) -> None:
        self.road = road
        self.lanes: dict[LaneRef, ArcLane] = {}
        for start, ends in road.network.graph.items():
            for end, lanes in ends.items():
                for number, lane in enumerate(lanes):
                    self.lanes[start, end, number] = lane
        self.after: dict[LaneRef, tuple[LaneRef, ...]] = {ref: self._successors(ref) for ref in self.lanes}
        self.before: dict[LaneRef, list[LaneRef]] = {ref: [] for ref in self.lanes}
        for ref, following in self.after.items():
            for other in following:
                self.before[other].append(ref)
        self.main = {(*edge, lane) for edge in (*road.forward, *road.backward) for lane in range(self._count(edge))}
        self.arms = {(site_index, node): arm for site_index, node, arm in self._arm_nodes()}
        self.known: dict[tuple[LaneRef, ...], Course] = {}

    def _count(self, edge: tuple[str, str]) -> int:
        return len(self.road.network.graph.get(edge[0], {}).get(edge[1], ()))

    def count(self, ref: LaneRef) -> int:
        """Number of lanes of the edge of a lane."""
        return self._count(ref[:2])

    def approach_of(self, junction: int, arm: str) -> LaneRef:
        """The leftmost lane that leads into a junction from `arm`."""
        node = self.road.node_into(self.road.junctions[junction].piece, arm)
        return min(ref for ref in self.lanes if ref[1] == node and self.lanes[ref].junction < 0)

    def distance_m(self, ref: LaneRef, x_m: float, y_m: float) -> float:
        """How far a point is from a lane."""
        lane = self.lanes[ref]
        along, _ = lane.local_coordinates(np.array((x_m, y_m)))
        x, y, _ = lane.pose(min(max(along, 0.0), lane.length))
        return math.hypot(x - x_m, y - y_m)

    def _successors(self, ref: LaneRef) -> tuple[LaneRef, ...]:
        start, end, number = ref
        leads_to = self.lanes[ref].to_lane
        wanted = number if leads_to is None else leads_to
        found = []
        for target, lanes in self.road.network.graph.get(end, {}).items():
            for index, lane in enumerate(lanes):
                comes_from = getattr(lane, 'from_lane', None)
                if (index if comes_from is None else comes_from) == wanted and target != start:
                    found.append((end, target, index))
        return tuple(found)

    def _arm_nodes(self) -> list[tuple[int, str, str]]:
        found = []
        for number, site in enumerate(self.road.junctions):
            for arm in ('back', *site.spec.arms):
                found.append((number, self.road.node_into(site.piece, arm), arm))
                found.append((number, self.road.node_out_of(site.piece, arm), arm))
        return found

    def lane(self, edge: tuple[str, str], number: int) -> LaneRef:
        """Lane `number` of an edge, or the nearest one; across a junction, the lane that begins in lane `number`."""
        lanes = self.road.network.graph[edge[0]][edge[1]]
        begins = [index if lane.from_lane is None else lane.from_lane for index, lane in enumerate(lanes)]
        return (*edge, min(range(len(lanes)), key=lambda index: abs(begins[index] - number)))

    def sources(self) -> list[LaneRef]:
        """Lanes that begin at the edge of the map."""
        return [ref for ref in self.lanes if not self.before[ref] and not self._is_side(ref)]

    def is_sink(self, ref: LaneRef) -> bool:
        """Whether a lane ends at the edge of the map, not in the middle of a road."""
        return not self.after[ref] and not self.road.network.graph.get(ref[1]) and not self._is_side(ref)

    def _is_side(self, ref: LaneRef) -> bool:
        """On- and off-ramps: traffic on them has to change lanes, which a course does not."""
        return ref[:2] in self.road.ramp or ref[:2] in self.road.exit

    def turn_of(self, ref: LaneRef) -> str:
        """How a lane turns: left, ahead or right."""
        lane = self.lanes[ref]
        if lane.turn:
            return lane.turn
        angle = lane.length * lane.curvature
        return AHEAD if abs(angle) < STRAIGHT_RAD else LEFT if angle > 0.0 else RIGHT

    def choices(self, ref: LaneRef) -> tuple[LaneRef, ...]:
        """The lanes that a vehicle may go on to. At a junction of several lanes the outer ones turn outwards only."""
        following = self.after[ref]
        if len(following) < 2 or self._has_turn_lanes(following[0]):
            return following
        last = self._count((ref[0], ref[1])) - 1
        allowed = [
            other
            for other in following
            if (turn := self.turn_of(other)) == AHEAD
            or (turn == LEFT and ref[2] == 0)
            or (turn == RIGHT and ref[2] == last)
        ]
        return tuple(allowed) or following

    def _has_turn_lanes(self, connector: LaneRef) -> bool:
        junction = self.lanes[connector].junction
        return junction >= 0 and bool(self.road.junctions[junction].spec.turn_lanes)

    def downstream(self, ref: LaneRef, then: Sequence[str] = ()) -> tuple[LaneRef, ...]:
        """Lanes from `ref` to the edge of the map. then: the turn at each junction on the way (left, ahead, right, or
        'chain' for the ego's road); after the last one, or where it is not possible, along the ego's road or ahead."""
        turns = list(then)
        lanes = [ref]
        while len(lanes) < MAX_LANES:
            following = self.choices(lanes[-1])
            if not following:
                break
            if len(following) > 1:
                lanes.append(self._choose(following, turns.pop(0) if turns else 'chain'))
            else:
                lanes.append(following[0])
                if turns and self.lanes[following[0]].junction >= 0:
                    turns.pop(0)
        return tuple(lanes)

    def _choose(self, following: tuple[LaneRef, ...], turn: str) -> LaneRef:
        for wanted in (turn, 'chain', AHEAD):
            for other in following:
                if other in self.main if wanted == 'chain' else self.turn_of(other) == wanted:
                    return other
        return following[0]

    def upstream(self, ref: LaneRef) -> tuple[LaneRef, ...]:
        """Lanes from the edge of the map to `ref`, along the ego's road where that is possible."""
        lanes = [ref]
        while len(lanes) < MAX_LANES:
            leading = self.before[lanes[0]]
            if not leading:
                break
            straight = [other for other in leading if self.lanes[other].junction < 0 or other in self.main]
            ahead = [other for other in leading if self.turn_of(other) == AHEAD]
            lanes.insert(0, (straight or ahead or leading)[0])
        return tuple(lanes)

    def through(self, ref: LaneRef, then: Sequence[str] = ()) -> Course:
        """The course that leads through a lane."""
        return self.course((*self.upstream(ref)[:-1], *self.downstream(ref, then)))

    def across(self, junction: int, source: str, target: str, lane: int = 0, then: Sequence[str] = ()) -> Course:
        """The course across a junction from arm `source` to arm `target`. Raises ValueError for an unknown arm."""
        site = self.road.junctions[junction]
        graph = self.road.network.graph
        edge = (self.road.node_into(site.piece, source), self.road.node_out_of(site.piece, target))
        if edge[1] not in graph.get(edge[0], {}):
            raise ValueError(f'AcrossJunction: junction {junction} has no way from {source!r} to {target!r}')
        return self.through(self.lane(edge, lane), then)

    def course(self, lanes: tuple[LaneRef, ...]) -> Course:
        """The course along a chain of lanes."""
        if lanes not in self.known:
            self.known[lanes] = self._build(lanes)
        return self.known[lanes]

    def _build(self, lanes: tuple[LaneRef, ...]) -> Course:
        path = Path(np.concatenate([self.lanes[ref].centre_line(SAMPLE_M) for ref in lanes]))
        begins = np.concatenate(([0.0], np.cumsum([self.lanes[ref].length for ref in lanes])))
        crossings = []
        for index, ref in enumerate(lanes):
            lane = self.lanes[ref]
            if lane.junction < 0 or (lane.junction, ref[0]) not in self.arms:
                continue
            enter, leave = float(begins[index]), float(begins[index + 1])
            source, target = self.arms[lane.junction, ref[0]], self.arms.get((lane.junction, ref[1]), '')
            stop = enter - self.road.junctions[lane.junction].spec.line_before_m(source)
            crossings.append(Crossing(lane.junction, source, target, ref, self.turn_of(ref), stop, enter, leave))
        return Course(path, lanes, tuple(float(s) for s in begins), tuple(crossings), curve_speeds_mps(path))

    def points_of(self, ref: LaneRef, after_m: float) -> tuple[Float64, Float64]:
        """(points (N, 2), arc lengths (N,)) every half metre of a lane across a junction and `after_m` beyond it."""
        lane = self.lanes[ref]
        stations = np.arange(0.0, lane.length, 0.5)
        points = [lane.pose(float(s))[:2] for s in stations]
        following = self.after[ref]
        if following:
            beyond = np.arange(0.0, after_m, 0.5)
            points += [self.lanes[following[0]].pose(float(s))[:2] for s in beyond]
            stations = np.concatenate((stations, lane.length + beyond))
        return np.array(points), stations
