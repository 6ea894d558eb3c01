"""From a `RoadLayout` to a `RoadMap`: pieces are laid one after another, each with its lanes, surface and markings."""

from __future__ import annotations

import math

import numpy as np

from raw2drive_ros.contracts.errors import LayoutError
from raw2drive_ros.contracts.public import Float64
from raw2drive_ros.simulation.junction_builder import (
    Across,
    JunctionBuilder,
    half_size_m,
    inlets_of,
    outlet_of,
    zebra_stripes,
)
from raw2drive_ros.simulation.lane_layer import LaneLayer, has_side_lane
from raw2drive_ros.simulation.lanes import ArcLane
from raw2drive_ros.simulation.layout import (
    ARM_LENGTH_M,
    LEAD_M,
    Junction,
    Piece,
    RoadLayout,
    Straight,
)
from raw2drive_ros.simulation.roads import Pose, RoadMap, advance
from raw2drive_ros.simulation.side_lanes import add_exit, add_ramp
from raw2drive_ros.simulation.surface_painter import paint_surface
from raw2drive_ros.simulation.turn_arrows import mark_turn_lanes

# Arms, and the road before and beyond the chain, are shortened step by step where they would meet other roads.
STEP_M, SHORTEST_M = 15.0, 35.0
# Spacing of the points by which roads are kept apart.
COARSE_M = 4.0
# Parking bays end so far from junctions; shorter strips are left out.
CLEAR_OF_JUNCTION_M, SHORTEST_BAYS_M = 12.0, 12.0
# So far from where it joins the chain a ramp is a road of its own.
JOINED_M = 50.0


class RoadBuilder(LaneLayer):
    """Builds the map of a layout piece by piece; `build()` returns it. Raises LayoutError where pieces overlap."""

    def __init__(self, layout: RoadLayout) -> None:
        super().__init__(layout)
        self.distance_m = 0.0
        # (piece, points) of the middles of all roads so far, to keep others clear of them.
        self.taken: list[tuple[int, Float64]] = []
        # Piece -> (middle, half its size) of junctions.
        self.sites: dict[int, tuple[Pose, float]] = {}
        self.arm_lengths: dict[tuple[int, str], float] = {}

    def build(self) -> RoadMap:
        """The map."""
        poses = self._poses()
        lead_m = self._lengths(poses)
        self._lead('lead_in', advance(poses[0], -lead_m[0]), lead_m[0])
        for index, piece in enumerate(self.layout.pieces):
            pose = poses[index]
            if isinstance(piece, Junction):
                self.distance_m += JunctionBuilder(self, index, piece, pose).build(self.distance_m, self.arm_lengths)
                continue
            length, curvature = _shape(piece)
            self._section(index, pose, length, curvature)
            end = poses[index + 1]
            if isinstance(piece, Straight):
                if piece.ramp or piece.drop:
                    add_ramp(self, index, end, piece.length_m, straight=piece.drop)
                if piece.exit:
                    add_exit(self, index, end, piece.length_m)
        self._lead('lead_out', poses[-1], lead_m[1])
        self._check_side_lanes()
        for zebra_s in self.layout.zebras_m:
            self._zebra(zebra_s)
        mark_turn_lanes(self.road)
        self.road.surface = paint_surface(self.road)
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
                self.sites[index] = centre, half_size_m(piece, self.layout)
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
        """Whether a road is far enough from all roads but those of the neighbouring pieces. Roads that meet at a
        junction may be closer near it."""
        lanes = max(self.layout.forward_lanes, self.layout.backward_lanes)
        clearance = 2.0 * lanes * self.width + 6.0
        for other, others in self.taken:
            apart = abs(piece - other)
            site = next((self.sites[i] for i in sorted((piece, other, (piece + other) // 2)) if i in self.sites), None)
            if not apart or (apart == 1 and site is None):
                continue
            own, theirs = points, others
            if apart <= 2 and site is not None:
                own, theirs = (_outside(part, site[0], site[1] + clearance) for part in (own, theirs))
            gap = own[:, None] - theirs[None]
            if gap.size and np.min(np.einsum('abk,abk->ab', gap, gap)) < clearance**2:
                return False
        return True

    def _check_side_lanes(self) -> None:
        """Raise LayoutError where a ramp or an exit meets another road, away from where it joins the chain."""
        road = self.road
        beside = next((i for i, piece in enumerate(self.layout.pieces) if has_side_lane(piece)), -1)
        clearance = (max(self.layout.forward_lanes, self.layout.backward_lanes) + 1.0) * self.width + 3.0
        if any(isinstance(piece, Straight) and piece.drop for piece in self.layout.pieces):
            # A lane that ends runs beside the chain's lanes all the way.
            clearance = (self.layout.forward_lanes + 0.5) * self.width - 0.4
        for edges, end in ((road.ramp, -1), (road.exit, 0)):
            if not edges:
                continue
            join = road.lane(edges[end], 0).pose(0.0 if edges is road.ramp else road.lane(edges[0], 0).length)
            points = np.concatenate([road.lane(edge, 0).centre_line(COARSE_M) for edge in edges])
            points = _outside(points, join, JOINED_M)
            for other, others in self.taken:
                gap = points[:, None] - others[None]
                if other != beside and np.min(np.einsum('abk,abk->ab', gap, gap)) < clearance**2:
                    raise LayoutError(f'the ramp of piece {beside} meets piece {other}')

    def _lead(self, name: str, pose: Pose, length: float) -> None:
        """The road before the first piece or beyond the last one."""
        last = len(self.layout.pieces)
        if name == 'lead_in':
            forward, backward = (name, 'c0'), ('b0', f'{name}_back')
            self.road.lead_in = forward, backward
        else:
            forward, backward = (f'c{last}', name), (f'{name}_back', f'b{last}')
            self.road.lead_out = forward, backward
        self.strip_lanes(forward, backward, pose, length, 0.0)

    def _section(self, index: int, pose: Pose, length: float, curvature: float) -> None:
        forward, backward = (f'c{index}', f'c{index + 1}'), (f'b{index + 1}', f'b{index}')
        pieces = self.layout.pieces
        begin = CLEAR_OF_JUNCTION_M if index and isinstance(pieces[index - 1], Junction) else 0.0
        following = pieces[index + 1] if index + 1 < len(pieces) else None
        end = length - (CLEAR_OF_JUNCTION_M if isinstance(following, Junction) else 0.0)
        if end - begin > SHORTEST_BAYS_M:
            self.bays(pose, length, curvature, begin, end)
        self.strip_lanes(forward, backward, pose, length, curvature)
        self.road.forward.append(forward)
        self.road.backward.append(backward)
        self.distance_m += length

    def _zebra(self, s_m: float) -> None:
        """A zebra crossing over the whole road at arc length `s_m` of the forward chain, on a straight piece."""
        path = self.road.forward_path(0)
        x, y, yaw = path.pose(s_m)
        origin = advance((x, y, yaw), 0.0, self.width / 2)
        left, right = self.layout.backward_lanes * self.width, self.layout.forward_lanes * self.width
        self.road.markings += zebra_stripes(origin, -right, left)


def piece_stations_m(layout: RoadLayout, lane: int = 0) -> tuple[float, ...]:
    """Arc lengths on lane `lane` of the forward chain at which each piece begins, and where the last one ends."""
    pose: Pose = (0.0, 0.0, 0.0)
    found = [0.0]
    for piece in layout.pieces:
        if isinstance(piece, Junction):
            across = Across(piece, layout, pose)
            length = across.lane('back', piece.turn, lane).length
            pose = outlet_of(piece, layout, pose)
        else:
            whole, curvature = _shape(piece)
            length = whole * (1.0 + curvature * (lane + 0.5) * layout.lane_width_m)
            pose = ArcLane(pose[:2], pose[2], whole, curvature, 1.0, 1.0).pose(whole)
        found.append(found[-1] + length)
    return tuple(found)


def _outside(points: Float64, middle: Pose, radius: float) -> Float64:
    """The points that are farther than `radius` from `middle`."""
    return points[np.hypot(points[:, 0] - middle[0], points[:, 1] - middle[1]) > radius]


def _shape(piece: Piece) -> tuple[float, float]:
    """(length, curvature) of a straight or a curve."""
    if isinstance(piece, Straight):
        return piece.length_m, 0.0
    assert not isinstance(piece, Junction)
    return piece.radius_m * abs(piece.angle_rad), math.copysign(1.0 / piece.radius_m, piece.angle_rad)


def build_road(layout: RoadLayout) -> RoadMap:
    """The map of a layout. Raises LayoutError where pieces overlap; scenes are then drawn again."""
    return RoadBuilder(layout).build()
