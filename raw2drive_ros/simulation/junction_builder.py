"""Builds junctions and roundabouts: arms, lanes across, surface, kerbs and lines."""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping

import numpy as np

from raw2drive_ros.contracts.public import Float64
from raw2drive_ros.simulation.lane_layer import SIDEWALK_M, LaneLayer
from raw2drive_ros.simulation.lanes import ArcLane, PolyLane, blend_m
from raw2drive_ros.simulation.layout import Junction, RoadLayout
from raw2drive_ros.simulation.roads import ARM_TURN_RAD, SAMPLE_M, JunctionSite, Marking, Pose, advance

# Directions of the arms from the middle, angles aside.
BEARING_RAD = {'back': math.pi, **ARM_TURN_RAD}
FROM_LEFT = ('left', 'ahead', 'right')
# Zebra crossings of arms: their middle before the junction, and half their length along the road.
ZEBRA_MIDDLE_M, ZEBRA_HALF_M = 2.4, 1.5
SQUARE_RAD = 1e-6
# Roundabouts: free width of the ring beside its lane, flare of the arms, and where on the ring they enter and leave.
RING_FREE_M, FLARE_M, RING_ENTRY_RAD = 0.5, 8.0, 0.55
# Largest radius of the kerbs between a roundabout and its arms.
FILLET_M = 25.0


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


def turn_of(source: str, target: str) -> str:
    """How drivers turn who go from one arm of a junction to another: left, ahead or right, angles aside."""
    turn = math.remainder(BEARING_RAD[target] - BEARING_RAD[source] - math.pi, 2.0 * math.pi)
    return 'ahead' if abs(turn) < 0.1 else 'left' if turn > 0.0 else 'right'


def lanes_through(spec: Junction, count: int) -> dict[tuple[str, str], tuple[int, ...]]:
    """(source, target) -> lanes that go there, as the turn lanes say. Every lane of an approach goes somewhere, and
    somebody comes into every lane that leads away."""
    arms = ('back', *spec.arms)
    pairs = list(itertools.permutations(arms, 2))
    found = {pair: {k for k in range(count) if spec.may_turn(turn_of(*pair), k)} for pair in pairs}
    for arm in arms:
        ways = sorted((pair for pair in pairs if pair[0] == arm), key=lambda pair: FROM_LEFT.index(turn_of(*pair)))
        for lane in range(count):
            if not any(lane in found[pair] for pair in ways):
                found[ways[0 if lane < count / 2 else -1]].add(lane)
    for arm in arms:
        ways = sorted((pair for pair in pairs if pair[1] == arm), key=lambda pair: turn_of(*pair) != 'ahead')
        for lane in range(count):
            if not any(lane in found[pair] for pair in ways):
                found[ways[0]].add(lane)
    return {pair: tuple(sorted(lanes)) for pair, lanes in found.items()}


class Across:
    """The lanes across a junction that the chain enters at `pose`."""

    def __init__(self, spec: Junction, layout: RoadLayout, pose: Pose) -> None:
        self.spec, self.layout, self.width = spec, layout, layout.lane_width_m
        self.half = half_size_m(spec, layout)
        self.centre, self.inlets = inlets_of(spec, layout, pose)

    def lane(self, source: str, target: str, number: int) -> ArcLane:
        """Lane `number` from one arm to another."""
        start, goal = self.inlets[source], advance(self.inlets[target], 0.0, 0.0, math.pi)
        angle = math.remainder(goal[2] - start[2], 2.0 * math.pi)
        quarter = abs(abs(angle) - math.pi / 2) < SQUARE_RAD
        offset, limit = (number + 0.5) * self.width, self.layout.speed_limit_mps
        begin, end = advance(start, 0.0, -offset), advance(goal, 0.0, -offset)
        if self.spec.island_m:
            return PolyLane(self._around(begin, end, source, target), self.width, limit)
        if quarter:
            radius = self.half + offset if angle > 0 else self.half - offset
            curvature = math.copysign(1.0 / radius, angle)
            return ArcLane(begin[:2], begin[2], radius * math.pi / 2, curvature, self.width, limit)
        if abs(angle) < SQUARE_RAD:
            return ArcLane(begin[:2], begin[2], 2.0 * self.half, 0.0, self.width, limit)
        return PolyLane(blend_m(begin, end), self.width, limit)

    def _around(self, begin: Pose, end: Pose, source: str, target: str) -> Float64:
        """Points of a way around the island, counter-clockwise."""
        radius = ring_radius_m(self.spec, self.layout)
        first = self.inlets[source][2] + math.pi + RING_ENTRY_RAD
        last = self.inlets[target][2] + math.pi - RING_ENTRY_RAD
        while last < first:
            last += 2.0 * math.pi
        enter, leave = self.on_ring(radius, first), self.on_ring(radius, last)
        count = max(2, math.ceil((last - first) * radius / 0.5))
        ring = [self.on_ring(radius, angle)[:2] for angle in np.linspace(first, last, count + 1)]
        return np.concatenate([blend_m(begin, enter)[:-1], np.array(ring), blend_m(leave, end)[1:]])

    def on_ring(self, radius: float, angle: float) -> Pose:
        """A pose on a circle around the middle, counter-clockwise."""
        x, y = self.centre[0] + radius * math.cos(angle), self.centre[1] + radius * math.sin(angle)
        return x, y, angle + math.pi / 2


class JunctionBuilder:
    """One junction: adds its lanes, surfaces and markings to the road of `layer`."""

    def __init__(self, layer: LaneLayer, index: int, spec: Junction, pose: Pose) -> None:
        self.layer, self.road, self.layout = layer, layer.road, layer.layout
        self.index, self.spec, self.pose = index, spec, pose
        if self.layout.backward_lanes != self.layout.forward_lanes:
            raise ValueError('Junction: needs as many backward as forward lanes')
        self.width = self.layout.lane_width_m
        self.half_road_m = self.layout.forward_lanes * self.width
        self.half = half_size_m(spec, self.layout)
        self.across = Across(spec, self.layout, pose)
        self.centre, self.inlets = self.across.centre, self.across.inlets

    def build(self, begin: float, arm_lengths: Mapping[tuple[int, str], float]) -> float:
        """Add everything; returns the length of the chain's leftmost lane across. begin: its station on the chain.
        arm_lengths: (piece, arm) -> m."""
        spec, road, index = self.spec, self.road, self.index
        allowed = lanes_through(spec, self.layout.forward_lanes)
        for source, target in itertools.permutations(self.inlets, 2):
            self._connect(source, target, allowed[source, target])
        for arm in spec.arms:
            if arm != spec.turn:
                self._arm(arm, arm_lengths[index, arm])
        outline = self._pave()
        self._lines()
        edge = (f'c{index}', f'c{index + 1}')
        road.forward.append(edge)
        road.backward.append((f'b{index + 1}', f'b{index}'))
        length = road.lane(edge, 0).length
        road.junctions.append(
            JunctionSite(
                index, self.centre[:2], self.pose[2], self.half, spec, begin, begin + length, self.inlets, outline
            )
        )
        return length

    def _connect(self, source: str, target: str, allowed: tuple[int, ...]) -> None:
        """The lanes from one arm to another. Those that the turn lanes exclude are kept for measuring alone."""
        road, edge = self.road, (self.road.node_into(self.index, source), self.road.node_out_of(self.index, target))
        lanes = [self.across.lane(source, target, number) for number in range(self.layout.forward_lanes)]
        for number, lane in enumerate(lanes):
            lane.junction, lane.turn = len(road.junctions), turn_of(source, target)
            lane.from_lane = lane.to_lane = number
            if number in allowed:
                road.network.add_lane(*edge, lane)
        road.across[edge] = lanes

    def _bearing(self, arm: str) -> float:
        """Direction from the middle to an arm, in `map`."""
        return self.inlets[arm][2] + math.pi

    def _arm(self, arm: str, length: float) -> None:
        index, inlet = self.index, self.inlets[arm]
        far = advance(inlet, -length)
        for lane in range(self.layout.forward_lanes):
            offset = (lane + 0.5) * self.width
            into, out = (f'j{index}{arm}far_in', f'j{index}{arm}in'), (f'j{index}{arm}out', f'j{index}{arm}far_out')
            self.layer.parallel(into, far, length, 0.0, -offset, reverse=False)
            self.layer.parallel(out, far, length, 0.0, offset, reverse=True)
        self.layer.paint(far, length, 0.0, self.layout.forward_lanes, self.layout.forward_lanes)

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
        order = sorted(self.inlets, key=lambda arm: math.remainder(self._bearing(arm), 2.0 * math.pi))
        pairs = list(zip(order, [*order[1:], order[0]], strict=True))
        for arm, following in pairs:
            self.road.markings.append(Marking('white', self._ring_kerb(arm, following, self.half_road_m, outer)))
        for shapes, more in ((self.road.surfaces_m, margin), (self.road.sidewalks_m, margin + SIDEWALK_M)):
            kerbs = [self._ring_kerb(*pair, self.half_road_m + more, outer + more) for pair in pairs]
            shapes.append(np.concatenate(kerbs))
        angles = np.linspace(0.0, 2.0 * math.pi, 49)
        island = np.array(self.centre[:2]) + self.spec.island_m * np.stack([np.cos(angles), np.sin(angles)], axis=1)
        self.road.islands_m.append(island)
        self.road.markings.append(Marking('white', island))
        return self.road.surfaces_m[-1]

    def _ring_kerb(self, arm: str, following: str, aside: float, radius: float) -> Float64:
        """(N, 2) points of the kerb from one arm of a roundabout along its outer edge to the next arm."""
        # A fillet touches the edge of the arm's road and, from outside, the circle.
        fillet = FILLET_M
        if radius > aside + 1.0:
            fillet = min(fillet, (self.half**2 - radius**2 + aside**2) / (2.0 * (radius - aside)))
        middle = (fillet + aside, math.sqrt(max((radius + fillet) ** 2 - (aside + fillet) ** 2, 0.0)))
        touches = math.atan2(*middle)
        first, last = self._bearing(arm), self._bearing(following)
        while last < first:
            last += 2.0 * math.pi
        if first + touches > last - touches:
            return self._kerb(arm, following, aside)
        turns = np.linspace(0.0, math.pi / 2 - touches, 9)
        # Along the arm outwards and to its left, seen from the middle.
        arc = np.stack([middle[1] - fillet * np.sin(turns), middle[0] - fillet * np.cos(turns)], axis=1)
        count = max(2, math.ceil((last - first - 2.0 * touches) * radius / SAMPLE_M))
        ring = [self._on_ring(radius, angle)[:2] for angle in np.linspace(first + touches, last - touches, count)]
        parts = [self._from_arm(first, arc), np.array(ring), self._from_arm(last, (arc * (1.0, -1.0))[::-1])]
        ends = [advance(self.inlets[arm], 0.0, -aside)[:2], advance(self.inlets[following], 0.0, aside)[:2]]
        return np.concatenate([np.array(ends[:1]), *parts, np.array(ends[1:])])

    def _from_arm(self, bearing: float, points: Float64) -> Float64:
        """(N, 2) points of `map` of points (along an arm, to its left) as seen from the middle."""
        cos, sin = math.cos(bearing), math.sin(bearing)
        return np.array(self.centre[:2]) + points @ np.array([[cos, sin], [-sin, cos]])

    def _on_ring(self, radius: float, angle: float) -> Pose:
        return self.across.on_ring(radius, angle)

    def _lines(self) -> None:
        """Stop lines, and dashed ones where the sign is a yield sign, on the approaches that have to wait."""
        spec = self.spec
        for arm in spec.zebras:
            road_m = (-self.half_road_m, self.half_road_m)
            self.road.markings += zebra_stripes(advance(self.inlets[arm], -ZEBRA_MIDDLE_M), *road_m)
        for arm, inlet in self.inlets.items():
            if spec.control == 'none' or (spec.control != 'light' and arm in spec.main_arms()):
                continue
            before = spec.line_before_m(arm)
            ends = [advance(inlet, -before, -w)[:2] for w in (0.2, self.half_road_m)]
            if spec.control == 'yield':
                middle = [np.array(ends[0]) + part * (np.array(ends[1]) - ends[0]) for part in (0.2, 0.35, 0.65, 0.8)]
                self.road.markings.append(Marking('stop', np.array(middle[:2])))
                self.road.markings.append(Marking('stop', np.array(middle[2:])))
            else:
                self.road.markings.append(Marking('stop', np.array(ends)))


def _meet(one: Pose, other: Pose) -> Float64:
    """The point where the lines through two poses meet."""
    a, b = np.array(one[:2]), np.array(other[:2])
    u = np.array((math.cos(one[2]), math.sin(one[2])))
    v = np.array((math.cos(other[2]), math.sin(other[2])))
    part = np.linalg.solve(np.stack([u, -v], axis=1), b - a)
    return a + part[0] * u


def zebra_stripes(pose: Pose, right: float, left: float) -> list[Marking]:
    """The stripes of a zebra crossing over a road whose middle is `pose`, between two lateral offsets."""
    found, offset = [], right + 0.3
    while offset + 0.5 < left:
        along = ((-ZEBRA_HALF_M, 0.0), (ZEBRA_HALF_M, 0.0), (ZEBRA_HALF_M, 0.5), (-ZEBRA_HALF_M, 0.5))
        found.append(Marking('zebra', np.array([advance(pose, a, offset + b)[:2] for a, b in along])))
        offset += 1.0
    return found
