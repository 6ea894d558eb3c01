"""Lays lanes along straights and arcs, and paves and paints them: what chains, arms and ramps are made of."""

from __future__ import annotations

import math

from highway_env.road.road import RoadNetwork

from raw2drive_ros.simulation.lanes import ArcLane, outline_points
from raw2drive_ros.simulation.layout import Piece, RoadLayout, Straight
from raw2drive_ros.simulation.roads import SAMPLE_M, Edge, Marking, Pose, RoadMap, advance

SIDEWALK_M = 2.0


class LaneLayer:
    """Adds lanes, surfaces and markings to `road`, which is empty at first."""

    def __init__(self, layout: RoadLayout) -> None:
        self.layout = layout
        self.road = RoadMap(RoadNetwork(), layout)
        self.width = layout.lane_width_m

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

    def strip_lanes(self, forward: Edge, backward: Edge, pose: Pose, length: float, curvature: float) -> None:
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
        road.sidewalks_m.append(outline_points(lane, left + margin + SIDEWALK_M, right - margin - SIDEWALK_M))
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

    def bays(self, pose: Pose, length: float, curvature: float, begin: float, end: float) -> None:
        """Strips of parking bays beside a straight or a curve, between two stations of it. There are none on
        the right of roads with ramps, exits and lanes that end."""
        layout, road = self.layout, self.road
        whole = ArcLane(pose[:2], pose[2], length, curvature, 1, 1)
        start = whole.pose(begin)
        part = ArcLane(start[:2], start[2], end - begin, curvature, 1, 1)
        for side, sign, lanes in (('right', -1.0, layout.forward_lanes), ('left', 1.0, layout.backward_lanes)):
            bays = layout.parking_width_m(side)
            if not bays or (side == 'right' and any(has_side_lane(piece) for piece in layout.pieces)):
                continue
            edge = sign * lanes * self.width
            kerb = edge + sign * (bays + layout.shoulder_m)
            road.sidewalks_m.append(outline_points(part, edge, kerb + SIDEWALK_M * sign))
            road.surfaces_m.append(outline_points(part, edge, kerb))
            road.parking_m.append(outline_points(part, edge, edge + sign * bays))


def has_side_lane(piece: Piece) -> bool:
    """Whether a lane runs beside a piece, or comes or goes there."""
    return isinstance(piece, Straight) and (piece.ramp or piece.exit or piece.drop)
