"""From a `RoadLayout` to a `RoadMap`: pieces are laid one after another, each with its lanes, surface and markings."""

from __future__ import annotations

import math

import numpy as np
from highway_env.road.road import RoadNetwork

from raw2drive_ros.contracts.errors import LayoutError
from raw2drive_ros.contracts.public import Float64
from raw2drive_ros.simulation.junction_builder import JunctionBuilder, inlets_of, outlet_of, outline_points
from raw2drive_ros.simulation.lanes import ArcLane
from raw2drive_ros.simulation.layout import (
    ARM_LENGTH_M,
    DROP_BEFORE_M,
    LEAD_M,
    Junction,
    Piece,
    RoadLayout,
    Straight,
)
from raw2drive_ros.simulation.road_surface import RoadSurface
from raw2drive_ros.simulation.roads import SAMPLE_M, Edge, Marking, Pose, RoadMap, advance

# Arms, and the road before and beyond the chain, are shortened step by step where they would meet other roads.
STEP_M, SHORTEST_M = 15.0, 35.0
# An on-ramp: straight before its curve, as its path counts it, the curve, and the way from the acceleration lane into
# the next one.
RAMP_BEFORE_M, RAMP_RAD, RAMP_RADIUS_M, RAMP_BLEND_M = 60.0, math.radians(14.0), 120.0, 30.0
RAMP_CURVE_M = RAMP_RAD * RAMP_RADIUS_M
# Spacing of the points by which roads are kept apart.
COARSE_M = 4.0


class RoadBuilder:
    """Builds the map of a layout piece by piece; `build()` returns it. Raises LayoutError where pieces overlap."""

    def __init__(self, layout: RoadLayout) -> None:
        self.layout = layout
        self.road = RoadMap(RoadNetwork(), layout)
        self.width = layout.lane_width_m
        self.distance_m = 0.0
        # (piece, points) of the middles of all roads so far, to keep others clear of them.
        self.taken: list[tuple[int, Float64]] = []
        self.arm_lengths: dict[tuple[int, str], float] = {}

    def build(self) -> RoadMap:
        """The map."""
        poses = self._poses()
        lead_m = self._lengths(poses)
        self._lead('lead_in', advance(poses[0], -lead_m[0]), lead_m[0])
        for index, piece in enumerate(self.layout.pieces):
            pose = poses[index]
            if isinstance(piece, Junction):
                self.distance_m += JunctionBuilder(self, index, piece, pose).build()
                continue
            length, curvature = _shape(piece)
            self._section(index, pose, length, curvature)
            end = poses[index + 1]
            if isinstance(piece, Straight):
                if piece.ramp or piece.drop:
                    self._ramp(index, end, piece.length_m, straight=piece.drop)
                if piece.exit:
                    self._exit(index, end, piece.length_m)
        self._lead('lead_out', poses[-1], lead_m[1])
        for zebra_s in self.layout.zebras_m:
            self._zebra(zebra_s)
        self.road.surface = RoadSurface(self.road)
        return self.road

    def _poses(self) -> list[Pose]:
        """Where each piece begins, and where the last one ends; their middles are taken."""
        poses: list[Pose] = [(0.0, 0.0, 0.0)]
        for index, piece in enumerate(self.layout.pieces):
            pose = poses[-1]
            if isinstance(piece, Junction):
                outlet = outlet_of(piece, self.layout, pose)
                centre, _ = inlets_of(piece, self.layout, pose)
                points = np.array([pose[:2], centre[:2], outlet[:2]])
                poses.append(outlet)
            else:
                lane = ArcLane(pose[:2], pose[2], *_shape(piece), 1.0, 1.0)
                points = lane.centre_line(COARSE_M)
                poses.append(lane.pose(lane.length))
            if not self._is_clear(index, points):
                raise LayoutError(f'piece {index} overlaps another one')
            self.taken.append((index, points))
        return poses

    def _lengths(self, poses: list[Pose]) -> tuple[float, float]:
        """Lengths of the road before and beyond the chain; sets those of all arms."""
        count = len(self.layout.pieces)
        before = self._longest(-1, advance(poses[0], 0.0, 0.0, math.pi), LEAD_M, 0)
        beyond = self._longest(count, poses[-1], LEAD_M, count - 1)
        for index, piece in enumerate(self.layout.pieces):
            if isinstance(piece, Junction):
                _, inlets = inlets_of(piece, self.layout, poses[index])
                for arm in piece.arms:
                    if arm != piece.turn:
                        out = advance(inlets[arm], 0.0, 0.0, math.pi)
                        self.arm_lengths[index, arm] = self._longest(index, out, ARM_LENGTH_M, index)
        return before, beyond

    def _longest(self, number: int, pose: Pose, length: float, beside: int) -> float:
        """The longest road from `pose` on, up to `length`, that is clear of all others; it is taken. beside: the piece
        that it begins at."""
        while length >= SHORTEST_M:
            points = np.array([advance(pose, s)[:2] for s in np.arange(0.0, length + 1.0, COARSE_M)])
            if self._is_clear(beside, points):
                self.taken.append((number, points))
                return length
            length -= STEP_M
        raise LayoutError(f'no room for a road at piece {beside}')

    def _is_clear(self, piece: int, points: Float64) -> bool:
        """Whether a road is far enough from all roads but those of the neighbouring pieces."""
        lanes = max(self.layout.forward_lanes, self.layout.backward_lanes)
        clearance = 2.0 * lanes * self.width + 6.0
        for other, others in self.taken:
            if abs(piece - other) > 1:
                gap = points[:, None] - others[None]
                if np.min(np.einsum('abk,abk->ab', gap, gap)) < clearance**2:
                    return False
        return True

    def _lead(self, name: str, pose: Pose, length: float) -> None:
        """The road before the first piece or beyond the last one."""
        last = len(self.layout.pieces)
        if name == 'lead_in':
            forward, backward = (name, 'c0'), ('b0', f'{name}_back')
            self.road.lead_in = forward, backward
        else:
            forward, backward = (f'c{last}', name), (f'{name}_back', f'b{last}')
            self.road.lead_out = forward, backward
        self._strip_lanes(forward, backward, pose, length, 0.0)

    def add(self, edge: Edge, pose: Pose, length: float, curvature: float, junction: int = -1) -> None:
        """A lane on an edge, right of those that it has."""
        lane = ArcLane(pose[:2], pose[2], length, curvature, self.width, self.layout.speed_limit_mps)
        lane.junction = junction
        self.road.network.add_lane(*edge, lane)

    def parallel(
        self, edge: Edge, pose: Pose, length: float, curvature: float, offset: float, *, reverse: bool
    ) -> None:
        """A lane `offset` metres left of a reference arc."""
        scale = 1.0 - curvature * offset
        start = advance(pose, 0.0, offset)
        if not reverse:
            self.add(edge, start, length * scale, curvature / scale)
            return
        end = ArcLane(start[:2], start[2], length * scale, curvature / scale, 1, 1).pose(length * scale)
        self.add(edge, (end[0], end[1], end[2] + math.pi), length * scale, -curvature / scale)

    def _section(self, index: int, pose: Pose, length: float, curvature: float) -> None:
        forward, backward = (f'c{index}', f'c{index + 1}'), (f'b{index + 1}', f'b{index}')
        self._strip_lanes(forward, backward, pose, length, curvature)
        self.road.forward.append(forward)
        self.road.backward.append(backward)
        self.distance_m += length

    def _strip_lanes(self, forward: Edge, backward: Edge, pose: Pose, length: float, curvature: float) -> None:
        """The lanes, surface and markings of a stretch of the chain's road."""
        layout = self.layout
        for lane in range(layout.forward_lanes):
            self.parallel(forward, pose, length, curvature, -(lane + 0.5) * self.width, reverse=False)
        for lane in range(layout.backward_lanes):
            self.parallel(backward, pose, length, curvature, (lane + 0.5) * self.width, reverse=True)
        self.paint(pose, length, curvature, layout.forward_lanes, layout.backward_lanes)

    def paint(self, pose: Pose, length: float, curvature: float, forward: int, backward: int) -> None:
        """Asphalt, sidewalks, edge lines, lane lines and the centre line of one section."""
        layout, road = self.layout, self.road
        lane = ArcLane(pose[:2], pose[2], length, curvature, 1, 1)
        left, right = backward * self.width, -forward * self.width
        margin = layout.shoulder_m
        road.surfaces_m.append(outline_points(lane, left + margin, right - margin))
        road.sidewalks_m.append(outline_points(lane, left + margin + 2.0, right - margin - 2.0))
        mark = road.markings.append
        mark(Marking('white', lane.centre_line(SAMPLE_M, right)))
        mark(Marking('white' if backward else 'yellow', lane.centre_line(SAMPLE_M, left)))
        for i in range(1, forward):
            mark(Marking('white_dashed', lane.centre_line(SAMPLE_M, -i * self.width)))
        for i in range(1, backward):
            mark(Marking('white_dashed', lane.centre_line(SAMPLE_M, i * self.width)))
        if backward:
            kind = 'yellow_dashed' if forward == 1 else 'yellow'
            mark(Marking(kind, lane.centre_line(SAMPLE_M)))

    def _ramp(self, index: int, end: Pose, length: float, *, straight: bool) -> None:
        """A lane right of the section that ends at `end`, fed by a curved on-ramp, or straight from beside the road."""
        road, layout = self.road, self.layout
        start = advance(end, -length)
        offset = -(layout.forward_lanes + 0.5) * self.width
        angle, radius = (0.001 if straight else RAMP_RAD), RAMP_RADIUS_M
        join = advance(start, 0.0, offset)
        arc_length = radius * angle
        along, aside = radius * math.sin(angle), radius * (1 - math.cos(angle))
        # The ramp approaches from the right and curves right until it is parallel to the road.
        arc_start = advance(join, -along, -aside, angle)
        # Arc length 0 of the ramp's path is 60 m before the curve; the ramp comes from out of sight.
        before = DROP_BEFORE_M if straight else RAMP_BEFORE_M + LEAD_M
        far = advance(arc_start, -before)
        blend_m = RAMP_BLEND_M
        self.add((f'r{index}a', f'r{index}b'), far, before, 0.0)
        self.add((f'r{index}b', f'r{index}c'), arc_start, arc_length, -1 / radius)
        self.add((f'r{index}c', f'r{index}d'), join, length - blend_m, 0.0)
        road.ramp = [(f'r{index}a', f'r{index}b'), (f'r{index}b', f'r{index}c'), (f'r{index}c', f'r{index}d')]
        road.ramp_piece = index
        self._pave_side_lanes(road.ramp, beside=road.ramp[-1])
        taper = [
            advance(end, -blend_m, -layout.forward_lanes * self.width)[:2],
            advance(end, -blend_m, offset - self.width / 2)[:2],
            advance(end, 0.0, -layout.forward_lanes * self.width)[:2],
        ]
        road.surfaces_m.append(np.array(taper))
        road.markings.append(Marking('white', np.array(taper[1:])))
        self._dash_edge_line(start)

    def _exit(self, index: int, end: Pose, length: float) -> None:
        """A deceleration lane right of the section that ends at `end`, and an off-ramp that curves away."""
        road, layout = self.road, self.layout
        start = advance(end, -length)
        offset = -(layout.forward_lanes + 0.5) * self.width
        angle, radius, blend_m = math.radians(16.0), 110.0, 30.0
        lane_start = advance(start, blend_m, offset)
        leave = advance(end, 0.0, offset)
        arc = ArcLane(leave[:2], leave[2], radius * angle, -1 / radius, 1, 1)
        self.add((f'x{index}a', f'x{index}b'), lane_start, length - blend_m, 0.0)
        self.add((f'x{index}b', f'x{index}c'), leave, radius * angle, -1 / radius)
        self.add((f'x{index}c', f'x{index}d'), arc.pose(arc.length), 70.0 + LEAD_M, 0.0)
        road.exit = [(f'x{index}a', f'x{index}b'), (f'x{index}b', f'x{index}c'), (f'x{index}c', f'x{index}d')]
        self._pave_side_lanes(road.exit, beside=road.exit[0])
        taper = [
            advance(start, blend_m, -layout.forward_lanes * self.width)[:2],
            advance(start, blend_m, offset - self.width / 2)[:2],
            advance(start, 0.0, -layout.forward_lanes * self.width)[:2],
        ]
        road.surfaces_m.append(np.array(taper))
        road.markings.append(Marking('white', np.array(taper[1:])))
        self._dash_edge_line(start)

    def _pave_side_lanes(self, edges: list[Edge], beside: Edge) -> None:
        """Asphalt and edge lines of a ramp; edge `beside`, which runs along the road, has no line on its left."""
        road, half, shoulder = self.road, self.width / 2, self.layout.shoulder_m
        for edge in edges:
            lane = road.lane(edge, 0)
            road.surfaces_m.append(outline_points(lane, half, -half - shoulder))
            road.sidewalks_m.append(outline_points(lane, half + 1, -half - shoulder - 2))
            road.markings.append(Marking('white', lane.centre_line(SAMPLE_M, -half)))
            if edge != beside:
                road.markings.append(Marking('white', lane.centre_line(SAMPLE_M, half)))

    def _dash_edge_line(self, start: Pose) -> None:
        """Make the right edge line of the section that starts at `start` dashed, where a lane was added beside it."""
        road, layout = self.road, self.layout
        edge_line = road.markings.pop(
            next(
                i
                for i, marking in enumerate(road.markings)
                if marking.kind == 'white'
                and np.allclose(marking.points_m[0], advance(start, 0, -layout.forward_lanes * self.width)[:2])
            )
        )
        road.markings.append(Marking('white_dashed', edge_line.points_m))

    def _zebra(self, s_m: float) -> None:
        """A zebra crossing over the whole road at arc length `s_m` of the forward chain, on a straight piece."""
        path = self.road.forward_path(0)
        x, y, yaw = path.pose(s_m)
        origin = advance((x, y, yaw), 0.0, self.width / 2)
        left, right = self.layout.backward_lanes * self.width, self.layout.forward_lanes * self.width
        offset = -right + 0.3
        while offset + 0.5 < left:
            corners = [
                advance(origin, a, offset + b)[:2] for a, b in ((-1.5, 0.0), (1.5, 0.0), (1.5, 0.5), (-1.5, 0.5))
            ]
            self.road.markings.append(Marking('zebra', np.array(corners)))
            offset += 1.0


def _shape(piece: Piece) -> tuple[float, float]:
    """(length, curvature) of a straight or a curve."""
    if isinstance(piece, Straight):
        return piece.length_m, 0.0
    assert not isinstance(piece, Junction)
    return piece.radius_m * abs(piece.angle_rad), math.copysign(1.0 / piece.radius_m, piece.angle_rad)


def build_road(layout: RoadLayout) -> RoadMap:
    """The map of a layout. Raises LayoutError where pieces overlap; scenes are then drawn again."""
    return RoadBuilder(layout).build()
