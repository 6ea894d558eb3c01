"""From a `RoadLayout` to a `RoadMap`: pieces are laid one after another, each with its lanes, surface and markings."""

from __future__ import annotations

import math

import numpy as np

from raw2drive_ros.contracts.errors import LayoutError
from raw2drive_ros.simulation.junction_builder import (
    Across,
    JunctionBuilder,
    half_size_m,
    inlets_of,
    outlet_of,
    zebra_stripes,
)
from raw2drive_ros.simulation.lane_layer import LaneLayer
from raw2drive_ros.simulation.lanes import ArcLane
from raw2drive_ros.simulation.layout import (
    ARM_M,
    LEAD_M,
    Junction,
    Piece,
    RoadLayout,
    Straight,
)
from raw2drive_ros.simulation.road_clearance import Clearance, Taken, outside, within
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
        self.clearance = Clearance(layout)
        self.chain_m = 0.0
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
        station = 0.0
        for index, piece in enumerate(self.layout.pieces):
            pose = poses[-1]
            if isinstance(piece, Junction):
                half = half_size_m(piece, self.layout)
                centre, _ = inlets_of(piece, self.layout, pose)
                poses.append(outlet_of(piece, self.layout, pose))
                points, length = np.array([pose[:2], centre[:2], poses[-1][:2]]), 2.0 * half
                self.clearance.add_site(index, centre[:2], half)
            else:
                lane = ArcLane(pose[:2], pose[2], *_shape(piece), 1.0, 1.0)
                points, length = lane.centre_line(COARSE_M), lane.length
                poses.append(lane.pose(lane.length))
            stations = np.linspace(station, station + length, len(points))
            if not self.clearance.take(Taken(points, stations)):
                raise LayoutError(f'piece {index} overlaps another one')
            station += length
        self.chain_m = station
        return poses

    def _lengths(self, poses: list[Pose]) -> tuple[float, float]:
        """Lengths of the road before and beyond the chain; sets those of all arms."""
        before = self._longest(advance(poses[0], 0.0, 0.0, math.pi), LEAD_M, (0.0, -1.0))
        beyond = self._longest(poses[-1], LEAD_M, (self.chain_m, 1.0))
        for index, piece in enumerate(self.layout.pieces):
            if isinstance(piece, Junction):
                _, inlets = inlets_of(piece, self.layout, poses[index])
                for arm in piece.arms:
                    if arm != piece.turn:
                        out = advance(inlets[arm], 0.0, 0.0, math.pi)
                        self.arm_lengths[index, arm] = self._longest(out, ARM_M, junction=index)
        return before, beyond

    def _longest(
        self, pose: Pose, length: float, chain: tuple[float, float] | None = None, junction: int | None = None
    ) -> float:
        """The longest road from `pose` on, up to `length`, that is clear of all others; it is taken. chain: (station
        at which it begins, direction) of a road that continues the chain. junction: piece whose arm it is."""
        while length >= SHORTEST_M:
            along = np.arange(0.0, length + 1.0, COARSE_M)
            points = np.array([advance(pose, s)[:2] for s in along.tolist()])
            stations = None if chain is None else chain[0] + chain[1] * along
            if self.clearance.take(Taken(points, stations, junction)):
                return length
            length -= STEP_M
        raise LayoutError('no room for a road at ' + ('the chain' if junction is None else f'piece {junction}'))

    def _check_side_lanes(self) -> None:
        """Raise LayoutError where a ramp or an exit meets another road, away from where it joins the chain."""
        road = self.road
        least_m = (max(self.layout.forward_lanes, self.layout.backward_lanes) + 1.0) * self.width + 3.0
        if any(isinstance(piece, Straight) and piece.drop for piece in self.layout.pieces):
            # A lane that ends runs beside the chain's lanes all the way.
            least_m = (self.layout.forward_lanes + 0.5) * self.width - 0.4
        # Without the lane that runs along the chain.
        for edges, join_s_m in ((road.ramp[:-1], math.inf), (road.exit[1:], 0.0)):
            if not edges:
                continue
            nearest = road.lane(edges[-1 if join_s_m else 0], 0)
            join = nearest.pose(min(join_s_m, nearest.length))
            points = np.concatenate([road.lane(edge, 0).centre_line(COARSE_M) for edge in edges])
            points = outside(points, np.array(join[:2]), JOINED_M)
            if any(within(points, other.points_m, least_m).any() for other in self.clearance.roads):
                raise LayoutError('a ramp or an exit meets another road')

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


def _shape(piece: Piece) -> tuple[float, float]:
    """(length, curvature) of a straight or a curve."""
    if isinstance(piece, Straight):
        return piece.length_m, 0.0
    assert not isinstance(piece, Junction)
    return piece.radius_m * abs(piece.angle_rad), math.copysign(1.0 / piece.radius_m, piece.angle_rad)


def build_road(layout: RoadLayout) -> RoadMap:
    """The map of a layout. Raises LayoutError where pieces overlap; scenes are then drawn again."""
    return RoadBuilder(layout).build()
