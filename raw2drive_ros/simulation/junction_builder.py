"""Builds junctions and roundabouts: arms, lanes across, surface, kerbs and lines."""

from __future__ import annotations

import itertools
import math
from typing import TYPE_CHECKING

import numpy as np

from raw2drive_ros.contracts.public import Float64
from raw2drive_ros.simulation.lanes import ArcLane, PolyLane, blend_m
from raw2drive_ros.simulation.layout import Junction, RoadLayout
from raw2drive_ros.simulation.roads import ARM_TURN_RAD, SAMPLE_M, JunctionSite, Marking, Pose, advance

if TYPE_CHECKING:
    from raw2drive_ros.simulation.road_builder import RoadBuilder

STOP_BEFORE_M = 0.6
SQUARE_RAD = 1e-6
# Roundabouts: free width of the ring beside its lane, flare of the arms, and where on the ring they enter and leave.
RING_FREE_M, FLARE_M, RING_ENTRY_RAD = 0.5, 8.0, 0.55
SIDEWALK_M = 2.0


def half_size_m(spec: Junction, layout: RoadLayout) -> float:
    """Distance from the middle of a junction to where its arms end."""
    width = layout.forward_lanes * layout.lane_width_m
    if spec.island_m:
        return ring_radius_m(spec, layout) + layout.lane_width_m / 2 + RING_FREE_M + FLARE_M
    bearings = sorted([math.pi, *(ARM_TURN_RAD[arm] + spec.deviation_rad(arm) for arm in spec.arms)])
    following = [*bearings[1:], bearings[0] + 2.0 * math.pi]
    narrowest = min(b - a for a, b in zip(bearings, following, strict=True))
    return width / math.tan(min(narrowest, math.pi / 2) / 2.0) + spec.corner_m


def ring_radius_m(spec: Junction, layout: RoadLayout) -> float:
    """Radius of the middle of a roundabout's lane."""
    return spec.island_m + layout.lane_width_m / 2 + RING_FREE_M


def inlets_of(spec: Junction, layout: RoadLayout, pose: Pose) -> tuple[Pose, dict[str, Pose]]:
    """(pose of the middle, pose of each arm's end heading into the junction) for a chain that enters at `pose`."""
    half = half_size_m(spec, layout)
    centre = advance(pose, half)
    found = {'back': pose}
    for arm in spec.arms:
        bearing = pose[2] + ARM_TURN_RAD[arm] + spec.deviation_rad(arm)
        found[arm] = advance((*centre[:2], bearing), half, 0.0, math.pi)
    return centre, found


def outlet_of(spec: Junction, layout: RoadLayout, pose: Pose) -> Pose:
    """Where the chain leaves a junction that it enters at `pose`."""
    _, inlets = inlets_of(spec, layout, pose)
    return advance(inlets[spec.turn], 0.0, 0.0, math.pi)


class JunctionBuilder:
    """One junction: adds its lanes, surfaces and markings to the road of `builder`."""

    def __init__(self, builder: RoadBuilder, index: int, spec: Junction, pose: Pose) -> None:
        self.builder, self.road, self.layout = builder, builder.road, builder.layout
        self.index, self.spec, self.pose = index, spec, pose
        if self.layout.backward_lanes != self.layout.forward_lanes:
            raise ValueError('Junction: needs as many backward as forward lanes')
        self.width = self.layout.lane_width_m
        self.half_road_m = self.layout.forward_lanes * self.width
        self.half = half_size_m(spec, self.layout)
        self.centre, self.inlets = inlets_of(spec, self.layout, pose)

    def build(self) -> float:
        """Add everything; returns the length of the chain's leftmost lane across."""
        spec, road, index = self.spec, self.road, self.index
        for source, target in itertools.permutations(self.inlets, 2):
            self._connect(source, target)
        for arm in spec.arms:
            if arm != spec.turn:
                self._arm(arm)
        outline = self._pave()
        self._lines()
        edge = (f'c{index}', f'c{index + 1}')
        road.forward.append(edge)
        road.backward.append((f'b{index + 1}', f'b{index}'))
        length = road.lane(edge, 0).length
        begin = self.builder.distance_m
        road.junctions.append(
            JunctionSite(
                index, self.centre[:2], self.pose[2], self.half, spec, begin, begin + length, self.inlets, outline
            )
        )
        return length

    def _connect(self, source: str, target: str) -> None:
        edge = (self.road.node_into(self.index, source), self.road.node_out_of(self.index, target))
        start, goal = self.inlets[source], advance(self.inlets[target], 0.0, 0.0, math.pi)
        angle = math.remainder(goal[2] - start[2], 2.0 * math.pi)
        quarter = abs(abs(angle) - math.pi / 2) < SQUARE_RAD
        square = (quarter or abs(angle) < SQUARE_RAD) and not self.spec.island_m
        for lane in range(self.layout.forward_lanes):
            offset = (lane + 0.5) * self.width
            begin, end = advance(start, 0.0, -offset), advance(goal, 0.0, -offset)
            if square and not quarter:
                self.builder.add(edge, begin, 2.0 * self.half, 0.0, len(self.road.junctions))
            elif square:
                radius = self.half + offset if angle > 0 else self.half - offset
                curvature = math.copysign(1.0 / radius, angle)
                self.builder.add(edge, begin, radius * math.pi / 2, curvature, len(self.road.junctions))
            else:
                points = self._around(begin, end, source, target) if self.spec.island_m else blend_m(begin, end)
                across = PolyLane(points, self.width, self.layout.speed_limit_mps)
                across.junction = len(self.road.junctions)
                self.road.network.add_lane(*edge, across)

    def _around(self, begin: Pose, end: Pose, source: str, target: str) -> Float64:
        """Points of a way around the island, counter-clockwise."""
        radius = ring_radius_m(self.spec, self.layout)
        first = self._bearing(source) + RING_ENTRY_RAD
        last = self._bearing(target) - RING_ENTRY_RAD
        while last < first:
            last += 2.0 * math.pi
        enter, leave = self._on_ring(radius, first), self._on_ring(radius, last)
        count = max(2, math.ceil((last - first) * radius / 0.5))
        ring = [self._on_ring(radius, angle)[:2] for angle in np.linspace(first, last, count + 1)]
        return np.concatenate([blend_m(begin, enter)[:-1], np.array(ring), blend_m(leave, end)[1:]])

    def _bearing(self, arm: str) -> float:
        """Direction from the middle to an arm, in `map`."""
        return self.inlets[arm][2] + math.pi

    def _on_ring(self, radius: float, angle: float) -> Pose:
        x, y = self.centre[0] + radius * math.cos(angle), self.centre[1] + radius * math.sin(angle)
        return x, y, angle + math.pi / 2

    def _arm(self, arm: str) -> None:
        index, inlet, length = self.index, self.inlets[arm], self.builder.arm_lengths[self.index, arm]
        far = advance(inlet, -length)
        for lane in range(self.layout.forward_lanes):
            offset = (lane + 0.5) * self.width
            into, out = (f'j{index}{arm}far_in', f'j{index}{arm}in'), (f'j{index}{arm}out', f'j{index}{arm}far_out')
            self.builder.parallel(into, far, length, 0.0, -offset, reverse=False)
            self.builder.parallel(out, far, length, 0.0, offset, reverse=True)
        self.builder.paint(far, length, 0.0, self.layout.forward_lanes, self.layout.forward_lanes)

    def _pave(self) -> Float64:
        """Surface, sidewalks, and kerb lines between neighbouring arms; returns the outline of the surface."""
        margin = self.layout.shoulder_m
        if self.spec.island_m:
            return self._pave_ring(margin)
        order = sorted(self.inlets, key=lambda arm: math.remainder(self._bearing(arm), 2.0 * math.pi))
        outline, wide = [], []
        for arm, following in zip(order, [*order[1:], order[0]], strict=True):
            # Seen from the middle, the left kerb of an arm and the right kerb of the next one, counter-clockwise.
            outline.append(self._kerb(arm, following, self.half_road_m + margin))
            wide.append(self._kerb(arm, following, self.half_road_m + margin + SIDEWALK_M))
            self.road.markings.append(Marking('white', self._kerb(arm, following, self.half_road_m)))
        self.road.surfaces_m.append(np.concatenate(outline))
        self.road.sidewalks_m.append(np.concatenate(wide))
        return self.road.surfaces_m[-1]

    def _kerb(self, arm: str, following: str, aside: float) -> Float64:
        """(N, 2) points of the kerb between two neighbouring arms, `aside` from their middles."""
        start = advance(self.inlets[arm], 0.0, -aside)
        # Poses look into the junction: the arm's left side as seen from the middle is its right one.
        end = advance(self.inlets[following], 0.0, aside, math.pi)
        if abs(math.remainder(end[2] - start[2], 2.0 * math.pi)) < 0.15:
            return np.array([start[:2], end[:2]])
        corner = _meet(start, end)
        t = np.linspace(0.0, 1.0, 9)[:, None]
        a, c = np.array(start[:2]), np.array(end[:2])
        return (1 - t) ** 2 * a + 2 * (1 - t) * t * corner + t**2 * c

    def _pave_ring(self, margin: float) -> Float64:
        outer = ring_radius_m(self.spec, self.layout) + self.width / 2 + RING_FREE_M
        angles = np.linspace(0.0, 2.0 * math.pi, 49)[:-1]
        circle = np.stack([np.cos(angles), np.sin(angles)], axis=1)
        middle = np.array(self.centre[:2])
        for arm in self.inlets:
            mouth, inner = self.inlets[arm], advance(self.inlets[arm], FLARE_M + 2.0)
            for shapes, more in ((self.road.surfaces_m, margin), (self.road.sidewalks_m, margin + SIDEWALK_M)):
                flare = [(mouth, self.half_road_m + more), (inner, self.half_road_m + more + 3.0)]
                left = [advance(pose, 0.0, aside)[:2] for pose, aside in flare]
                right = [advance(pose, 0.0, -aside)[:2] for pose, aside in flare]
                shapes.append(np.array([*left, *right[::-1]]))
        self.road.surfaces_m.append(middle + outer * circle)
        self.road.sidewalks_m.append(middle + (outer + SIDEWALK_M) * circle)
        island = middle + self.spec.island_m * np.concatenate([circle, circle[:1]])
        self.road.islands_m.append(island)
        self.road.markings.append(Marking('white', island))
        return middle + self.half * circle

    def _lines(self) -> None:
        """Stop lines, and dashed ones where the sign is a yield sign, on the approaches that have to wait."""
        spec = self.spec
        for arm, inlet in self.inlets.items():
            if spec.control == 'none' or (spec.control != 'light' and arm in self._main_arms()):
                continue
            ends = [advance(inlet, -STOP_BEFORE_M, -w)[:2] for w in (0.2, self.half_road_m)]
            if spec.control == 'yield':
                middle = [np.array(ends[0]) + part * (np.array(ends[1]) - ends[0]) for part in (0.2, 0.35, 0.65, 0.8)]
                self.road.markings.append(Marking('stop', np.array(middle[:2])))
                self.road.markings.append(Marking('stop', np.array(middle[2:])))
            else:
                self.road.markings.append(Marking('stop', np.array(ends)))

    def _main_arms(self) -> tuple[str, ...]:
        return self.spec.main_arms()


def _meet(one: Pose, other: Pose) -> Float64:
    """The point where the lines through two poses meet."""
    a, b = np.array(one[:2]), np.array(other[:2])
    u = np.array((math.cos(one[2]), math.sin(one[2])))
    v = np.array((math.cos(other[2]), math.sin(other[2])))
    part = np.linalg.solve(np.stack([u, -v], axis=1), b - a)
    return a + part[0] * u


def outline_points(lane: ArcLane, left: float, right: float) -> Float64:
    """(N, 2) polygon of a strip along a lane."""
    return np.concatenate([lane.centre_line(SAMPLE_M, left), lane.centre_line(SAMPLE_M, right)[::-1]])
