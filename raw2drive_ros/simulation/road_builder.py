"""From a `RoadLayout` to a `RoadMap`: pieces are laid one after another, each with its lanes, surface and markings."""

from __future__ import annotations

import math

import numpy as np
from highway_env.road.road import RoadNetwork

from raw2drive_ros.contracts.errors import LayoutError
from raw2drive_ros.contracts.public import Float64
from raw2drive_ros.simulation.lanes import ArcLane
from raw2drive_ros.simulation.layout import (
    ARM_LENGTH_M,
    CORNER_RADIUS_M,
    LANE_WIDTH_M,
    Junction,
    RoadLayout,
    Straight,
)
from raw2drive_ros.simulation.roads import ARM_TURN_RAD, SAMPLE_M, Edge, JunctionSite, Marking, Pose, RoadMap


def _advance(pose: Pose, forward_m: float, left_m: float = 0.0, turn_rad: float = 0.0) -> Pose:
    x, y, yaw = pose
    return (
        x + forward_m * math.cos(yaw) - left_m * math.sin(yaw),
        y + forward_m * math.sin(yaw) + left_m * math.cos(yaw),
        yaw + turn_rad,
    )


class RoadBuilder:
    """Builds the map of a layout piece by piece; `build()` returns it."""

    def __init__(self, layout: RoadLayout) -> None:
        self.layout = layout
        self.road = RoadMap(RoadNetwork(), layout)
        self.centre: list[tuple[int, Float64]] = []
        self.distance_m = 0.0

    def build(self) -> RoadMap:
        pose: Pose = (0.0, 0.0, 0.0)
        for index, piece in enumerate(self.layout.pieces):
            if isinstance(piece, Junction):
                pose = self._junction(index, piece, pose)
            else:
                length, curvature = (
                    (piece.length_m, 0.0)
                    if isinstance(piece, Straight)
                    else (
                        piece.radius_m * abs(piece.angle_rad),
                        math.copysign(1.0 / piece.radius_m, piece.angle_rad),
                    )
                )
                pose = self._section(index, pose, length, curvature)
                if isinstance(piece, Straight) and piece.ramp:
                    self._ramp(index, pose, piece.length_m)
                if isinstance(piece, Straight) and piece.exit:
                    self._exit(index, pose, piece.length_m)
        self._reject_overlap()
        for zebra_s in self.layout.zebras_m:
            self._zebra(zebra_s)
        return self.road

    def _add(self, edge: Edge, pose: Pose, length: float, curvature: float, junction: int = -1) -> None:
        lane = ArcLane(pose[:2], pose[2], length, curvature, LANE_WIDTH_M, self.layout.speed_limit_mps)
        lane.junction = junction
        self.road.network.add_lane(*edge, lane)

    def _parallel(
        self, edge: Edge, pose: Pose, length: float, curvature: float, offset: float, *, reverse: bool
    ) -> None:
        """A lane `offset` metres left of a reference arc."""
        scale = 1.0 - curvature * offset
        start = _advance(pose, 0.0, offset)
        if not reverse:
            self._add(edge, start, length * scale, curvature / scale)
            return
        end = ArcLane(start[:2], start[2], length * scale, curvature / scale, 1, 1).pose(length * scale)
        self._add(edge, (end[0], end[1], end[2] + math.pi), length * scale, -curvature / scale)

    def _section(self, index: int, pose: Pose, length: float, curvature: float) -> Pose:
        layout, road = self.layout, self.road
        forward, backward = (f'c{index}', f'c{index + 1}'), (f'b{index + 1}', f'b{index}')
        for lane in range(layout.forward_lanes):
            self._parallel(forward, pose, length, curvature, -(lane + 0.5) * LANE_WIDTH_M, reverse=False)
        for lane in range(layout.backward_lanes):
            self._parallel(backward, pose, length, curvature, (lane + 0.5) * LANE_WIDTH_M, reverse=True)
        road.forward.append(forward)
        road.backward.append(backward)
        self._paint(pose, length, curvature, layout.forward_lanes, layout.backward_lanes)
        reference = ArcLane(pose[:2], pose[2], length, curvature, 1, 1)
        self.centre.append((index, reference.centre_line(4.0)))
        self.distance_m += length
        return reference.pose(length)

    def _strip(self, lane: ArcLane, left: float, right: float) -> Float64:
        return np.concatenate([lane.centre_line(SAMPLE_M, left), lane.centre_line(SAMPLE_M, right)[::-1]])

    def _paint(self, pose: Pose, length: float, curvature: float, forward: int, backward: int) -> None:
        """Asphalt, sidewalks, edge lines, lane lines and the centre line of one section."""
        layout, road = self.layout, self.road
        lane = ArcLane(pose[:2], pose[2], length, curvature, 1, 1)
        left, right = backward * LANE_WIDTH_M, -forward * LANE_WIDTH_M
        margin = layout.shoulder_m
        road.surfaces_m.append(self._strip(lane, left + margin, right - margin))
        road.sidewalks_m.append(self._strip(lane, left + margin + 2.0, right - margin - 2.0))
        mark = road.markings.append
        mark(Marking('white', lane.centre_line(SAMPLE_M, right)))
        mark(Marking('white' if backward else 'yellow', lane.centre_line(SAMPLE_M, left)))
        for i in range(1, forward):
            mark(Marking('white_dashed', lane.centre_line(SAMPLE_M, -i * LANE_WIDTH_M)))
        for i in range(1, backward):
            mark(Marking('white_dashed', lane.centre_line(SAMPLE_M, i * LANE_WIDTH_M)))
        if backward:
            kind = 'yellow_dashed' if forward == 1 else 'yellow'
            mark(Marking(kind, lane.centre_line(SAMPLE_M)))

    def _junction(self, index: int, spec: Junction, pose: Pose) -> Pose:
        layout, road = self.layout, self.road
        lanes = layout.forward_lanes
        if layout.backward_lanes != lanes:
            raise ValueError('Junction: needs as many backward as forward lanes')
        half = lanes * LANE_WIDTH_M + CORNER_RADIUS_M
        centre = _advance(pose, half)
        turn = ARM_TURN_RAD[spec.turn]
        outlet = _advance((*centre[:2], pose[2] + turn), half)
        inlets = {'back': pose}
        for arm in spec.arms:
            inlets[arm] = _advance((*centre[:2], pose[2] + ARM_TURN_RAD[arm]), half, 0.0, math.pi)
            if arm != spec.turn:
                self._arm(index, arm, inlets[arm])
        for source, start in inlets.items():
            for target, goal in inlets.items():
                if source != target:
                    edge = (road.node_into(index, source), road.node_out_of(index, target))
                    self._connector(edge, start, goal, half, lanes)
        square = [_advance(centre, sx * half, sy * half)[:2] for sx, sy in ((1, 1), (-1, 1), (-1, -1), (1, -1))]
        road.surfaces_m.append(np.array(square))
        # Where an arm is missing there is a kerb: mark its edge.
        for arm in ('left', 'right', 'ahead'):
            if arm not in spec.arms:
                edge_pose = _advance((*centre[:2], pose[2] + ARM_TURN_RAD[arm]), half)
                ends = [_advance(edge_pose, 0.0, side * half)[:2] for side in (-1, 1)]
                road.markings.append(Marking('white', np.array(ends)))
        if spec.control in ('light', 'stop'):
            for start in inlets.values():
                line = [_advance(start, -0.6, -w)[:2] for w in (0.2, lanes * LANE_WIDTH_M)]
                road.markings.append(Marking('stop', np.array(line)))
        connector = self.road.lane((f'c{index}', f'c{index + 1}'), 0)
        road.forward.append((f'c{index}', f'c{index + 1}'))
        road.backward.append((f'b{index + 1}', f'b{index}'))
        exit_distance = self.distance_m + connector.length
        road.junctions.append(JunctionSite(index, centre[:2], pose[2], half, spec, self.distance_m, exit_distance))
        self.centre.append((index, np.array([pose[:2], centre[:2], outlet[:2]])))
        self.distance_m = exit_distance
        return outlet

    def _arm(self, index: int, arm: str, inlet: Pose) -> None:
        """An arm of a junction, `ARM_LENGTH_M` long. inlet: pose where it enters, heading into the junction."""
        lanes = self.layout.forward_lanes
        far = _advance(inlet, -ARM_LENGTH_M)
        for lane in range(lanes):
            offset = (lane + 0.5) * LANE_WIDTH_M
            self._parallel((f'j{index}{arm}far_in', f'j{index}{arm}in'), far, ARM_LENGTH_M, 0.0, -offset, reverse=False)
            self._parallel((f'j{index}{arm}out', f'j{index}{arm}far_out'), far, ARM_LENGTH_M, 0.0, offset, reverse=True)
        self._paint(far, ARM_LENGTH_M, 0.0, lanes, lanes)
        self.centre.append((index, ArcLane(far[:2], far[2], ARM_LENGTH_M, 0.0, 1, 1).centre_line(4.0)))

    def _connector(self, edge: Edge, start: Pose, goal: Pose, half: float, lanes: int) -> None:
        """Lanes across a junction, from inlet `start` to the arm with inlet `goal`: straight or a quarter circle."""
        angle = math.remainder(goal[2] + math.pi - start[2], 2 * math.pi)
        for lane in range(lanes):
            offset = (lane + 0.5) * LANE_WIDTH_M
            begin = _advance(start, 0.0, -offset)
            if abs(angle) < 0.1:
                self._add(edge, begin, 2 * half, 0.0, len(self.road.junctions))
            else:
                radius = half + offset if angle > 0 else half - offset
                self._add(edge, begin, radius * math.pi / 2, math.copysign(1 / radius, angle), len(self.road.junctions))

    def _ramp(self, index: int, end: Pose, length: float) -> None:
        """An acceleration lane right of the section that ends at `end`, fed by a curved on-ramp."""
        road, layout = self.road, self.layout
        start = _advance(end, -length)
        offset = -(layout.forward_lanes + 0.5) * LANE_WIDTH_M
        angle, radius = math.radians(14.0), 120.0
        join = _advance(start, 0.0, offset)
        arc_length = radius * angle
        along, aside = radius * math.sin(angle), radius * (1 - math.cos(angle))
        # The ramp approaches from the right and curves right until it is parallel to the road.
        arc_start = _advance(join, -along, -aside, angle)
        far = _advance(arc_start, -60.0)
        blend_m = 30.0
        self._add((f'r{index}a', f'r{index}b'), far, 60.0, 0.0)
        self._add((f'r{index}b', f'r{index}c'), arc_start, arc_length, -1 / radius)
        self._add((f'r{index}c', f'r{index}d'), join, length - blend_m, 0.0)
        road.ramp = [(f'r{index}a', f'r{index}b'), (f'r{index}b', f'r{index}c'), (f'r{index}c', f'r{index}d')]
        road.ramp_piece = index
        self._pave_side_lanes(road.ramp, beside=road.ramp[-1])
        taper = [
            _advance(end, -blend_m, -layout.forward_lanes * LANE_WIDTH_M)[:2],
            _advance(end, -blend_m, offset - LANE_WIDTH_M / 2)[:2],
            _advance(end, 0.0, -layout.forward_lanes * LANE_WIDTH_M)[:2],
        ]
        road.surfaces_m.append(np.array(taper))
        road.markings.append(Marking('white', np.array(taper[1:])))
        self._dash_edge_line(start)

    def _exit(self, index: int, end: Pose, length: float) -> None:
        """A deceleration lane right of the section that ends at `end`, and an off-ramp that curves away."""
        road, layout = self.road, self.layout
        start = _advance(end, -length)
        offset = -(layout.forward_lanes + 0.5) * LANE_WIDTH_M
        angle, radius, blend_m = math.radians(16.0), 110.0, 30.0
        lane_start = _advance(start, blend_m, offset)
        leave = _advance(end, 0.0, offset)
        arc = ArcLane(leave[:2], leave[2], radius * angle, -1 / radius, 1, 1)
        self._add((f'x{index}a', f'x{index}b'), lane_start, length - blend_m, 0.0)
        self._add((f'x{index}b', f'x{index}c'), leave, radius * angle, -1 / radius)
        self._add((f'x{index}c', f'x{index}d'), arc.pose(arc.length), 70.0, 0.0)
        road.exit = [(f'x{index}a', f'x{index}b'), (f'x{index}b', f'x{index}c'), (f'x{index}c', f'x{index}d')]
        self._pave_side_lanes(road.exit, beside=road.exit[0])
        taper = [
            _advance(start, blend_m, -layout.forward_lanes * LANE_WIDTH_M)[:2],
            _advance(start, blend_m, offset - LANE_WIDTH_M / 2)[:2],
            _advance(start, 0.0, -layout.forward_lanes * LANE_WIDTH_M)[:2],
        ]
        road.surfaces_m.append(np.array(taper))
        road.markings.append(Marking('white', np.array(taper[1:])))
        self._dash_edge_line(start)

    def _pave_side_lanes(self, edges: list[Edge], beside: Edge) -> None:
        """Asphalt and edge lines of a ramp; edge `beside`, which runs along the road, has no line on its left."""
        road, half, shoulder = self.road, LANE_WIDTH_M / 2, self.layout.shoulder_m
        for edge in edges:
            lane = road.lane(edge, 0)
            road.surfaces_m.append(self._strip(lane, half, -half - shoulder))
            road.sidewalks_m.append(self._strip(lane, half + 1, -half - shoulder - 2))
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
                and np.allclose(marking.points_m[0], _advance(start, 0, -layout.forward_lanes * LANE_WIDTH_M)[:2])
            )
        )
        road.markings.append(Marking('white_dashed', edge_line.points_m))

    def _zebra(self, s_m: float) -> None:
        """A zebra crossing over the whole road at arc length `s_m` of the forward chain, on a straight piece."""
        path = self.road.forward_path(0)
        x, y, yaw = path.pose(s_m)
        origin = _advance((x, y, yaw), 0.0, LANE_WIDTH_M / 2)
        left, right = self.layout.backward_lanes * LANE_WIDTH_M, self.layout.forward_lanes * LANE_WIDTH_M
        offset = -right + 0.3
        while offset + 0.5 < left:
            corners = [
                _advance(origin, a, offset + b)[:2] for a, b in ((-1.5, 0.0), (1.5, 0.0), (1.5, 0.5), (-1.5, 0.5))
            ]
            self.road.markings.append(Marking('zebra', np.array(corners)))
            offset += 1.0

    def _reject_overlap(self) -> None:
        """Raise LayoutError where pieces that are not adjacent come too close to each other."""
        clearance = 2.0 * max(self.layout.forward_lanes, self.layout.backward_lanes) * LANE_WIDTH_M + 6.0
        for i, (piece_a, points_a) in enumerate(self.centre):
            for piece_b, points_b in self.centre[i + 1 :]:
                if abs(piece_a - piece_b) > 1:
                    gap = points_a[:, None] - points_b[None]
                    if np.min(np.einsum('abk,abk->ab', gap, gap)) < clearance**2:
                        raise LayoutError(f'pieces {piece_a} and {piece_b} overlap')


def build_road(layout: RoadLayout) -> RoadMap:
    """The map of a layout. Raises LayoutError where pieces overlap; scenes are then drawn again."""
    return RoadBuilder(layout).build()
