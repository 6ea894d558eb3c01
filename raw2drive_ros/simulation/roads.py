"""The road map of a scene: lanes, drivable surfaces and markings, all in `map`. `road_builder` makes it.

Nodes: `c<i>` forward chain, `b<i>` backward chain, `j<i><arm><in|out|far_in|far_out>` arms of a junction,
`r<i><letter>` on-ramp, `x<i><letter>` off-ramp; `<i>` is the index of the piece. Edge (a, b) holds its lanes from
the centre line outwards.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
from highway_env.road.road import RoadNetwork

from raw2drive_ros.contracts.public import Float64
from raw2drive_ros.simulation.lanes import ArcLane
from raw2drive_ros.simulation.layout import ARM_LENGTH_M, LEAD_M, Junction, RoadLayout
from raw2drive_ros.simulation.path import Path
from raw2drive_ros.simulation.road_surface import RoadSurface

ARM_TURN_RAD = {'left': math.pi / 2, 'ahead': 0.0, 'right': -math.pi / 2}
Pose = tuple[float, float, float]
Edge = tuple[str, str]
# Spacing of the points of centre lines and markings.
SAMPLE_M = 1.0


def advance(pose: Pose, forward_m: float, left_m: float = 0.0, turn_rad: float = 0.0) -> Pose:
    """A pose moved ahead and to the left in its own frame, then turned."""
    x, y, yaw = pose
    return (
        x + forward_m * math.cos(yaw) - left_m * math.sin(yaw),
        y + forward_m * math.sin(yaw) + left_m * math.cos(yaw),
        yaw + turn_rad,
    )


@dataclass(frozen=True, slots=True)
class Marking:
    """A road marking. kind: white, white_dashed, yellow, yellow_dashed or stop (polylines), zebra or arrow (polygons).

    points_m: (N, 2).
    """

    kind: str
    points_m: Float64


@dataclass(slots=True)
class JunctionSite:
    """Pose and extent of a junction. piece: its index in the layout. entry_s_m, exit_s_m: along the forward chain.
    inlets: arm -> pose of the middle of its road where it ends, heading into the junction. outline_m: (N, 2)
    polygon of its paved area."""

    piece: int
    centre_m: tuple[float, float]
    heading_rad: float
    half_size_m: float
    spec: Junction
    entry_s_m: float
    exit_s_m: float
    inlets: dict[str, Pose] = field(default_factory=dict)
    outline_m: Float64 = field(default_factory=lambda: np.zeros((0, 2)))


@dataclass(slots=True)
class RoadMap:
    """Lanes, surfaces and markings of a road. surfaces_m, sidewalks_m, parking_m, islands_m: (N, 2)
    polygons; parking bays and islands lie on surfaces. exit: edges of the off-ramp."""

    network: RoadNetwork
    layout: RoadLayout
    forward: list[Edge] = field(default_factory=list)
    backward: list[Edge] = field(default_factory=list)
    ramp: list[Edge] = field(default_factory=list)
    ramp_piece: int = -1
    exit: list[Edge] = field(default_factory=list)
    # The road before the first piece and beyond the last one: (forward, backward) edge of either.
    lead_in: tuple[Edge, Edge] | None = None
    lead_out: tuple[Edge, Edge] | None = None
    junctions: list[JunctionSite] = field(default_factory=list)
    # Lanes across junctions by their number, those that turn lanes exclude included: what paths are measured along.
    across: dict[Edge, list[ArcLane]] = field(default_factory=dict)
    surfaces_m: list[Float64] = field(default_factory=list)
    sidewalks_m: list[Float64] = field(default_factory=list)
    parking_m: list[Float64] = field(default_factory=list)
    islands_m: list[Float64] = field(default_factory=list)
    markings: list[Marking] = field(default_factory=list)
    reference: Path | None = None
    surface: RoadSurface | None = None

    def lane(self, edge: Edge, lane: int) -> ArcLane:
        lanes = self.across.get(edge) or self.network.graph[edge[0]][edge[1]]
        found: ArcLane = lanes[min(lane, len(lanes) - 1)]
        return found

    def path(self, edges: list[Edge], lane: int = 0, before: list[Edge] | None = None, beyond: int = 0) -> Path:
        """The centre line of one lane along consecutive edges. Arc lengths count from the end of the edges `before`;
        the path's purpose ends before the last `beyond` edges."""
        leading = before or []
        whole = [*leading, *edges]
        lanes = [self.lane(edge, lane) for edge in whole]
        start_s_m = -sum(part.length for part in lanes[: len(leading)])
        found = Path(np.concatenate([part.centre_line(SAMPLE_M) for part in lanes]), start_s_m)
        found.end_s_m = found.length_m - sum(part.length for part in lanes[len(lanes) - beyond :])
        return found

    def lanes_into(self, node: str) -> list[ArcLane]:
        """The lanes outside of junctions that lead to a node."""
        edges = [ends[node] for ends in self.network.graph.values() if node in ends]
        return [lane for lanes in edges for lane in lanes if lane.junction < 0]

    def stop_line(self, junction: int, arm: str) -> tuple[Pose, float]:
        """(pose of the middle of an approach's stop line heading into the junction, its width m), signs or not."""
        site = self.junctions[junction]
        width = self.layout.forward_lanes * self.layout.lane_width_m
        return advance(site.inlets[arm], -site.spec.line_before_m(arm), -width / 2), width

    def lanes_along(self, *, oncoming: bool) -> list[Edge]:
        """The edges of the chain in one direction, with those before and beyond it."""
        more = [edges[oncoming] for edges in (self.lead_in, self.lead_out) if edges is not None]
        return [*(self.backward if oncoming else self.forward), *more]

    def forward_path(self, lane: int = 0) -> Path:
        """A lane of the chain, with the road before and beyond it; arc length 0 is where the chain begins."""
        before = [self.lead_in[0]] if self.lead_in else []
        after = [self.lead_out[0]] if self.lead_out else []
        return self.path([*self.forward, *after], lane, before, len(after))

    def forward_path_cached(self) -> Path:
        """The leftmost forward lane, built once."""
        if self.reference is None:
            self.reference = self.forward_path(0)
        return self.reference

    def backward_path(self, lane: int = 0) -> Path:
        """A lane of oncoming traffic; arc length 0 is at the far end of the chain."""
        before = [self.lead_out[1]] if self.lead_out else []
        after = [self.lead_in[1]] if self.lead_in else []
        return self.path([*self.backward[::-1], *after], lane, before, len(after))

    def ramp_path(self) -> Path:
        """The on-ramp, its acceleration lane, then the rightmost lane of the main road; arc length 0 is 60 m before the
        end of the ramp's first straight."""
        right = self.layout.forward_lanes - 1
        on_ramp = self.path(self.ramp)
        after = [self.lead_out[0]] if self.lead_out else []
        merged = self.path([*self.forward[self.ramp_piece + 1 :], *after], right, None, len(after))
        whole = Path(np.concatenate([on_ramp.points_m, merged.points_m]), 60.0 - self.lane(self.ramp[0], 0).length)
        whole.end_s_m = whole.length_m - (merged.length_m - merged.end_s_m)
        return whole

    def exit_path(self) -> Path:
        """The off-ramp, from the end of its deceleration lane on."""
        found = self.path(self.exit[1:])
        found.end_s_m -= LEAD_M
        return found

    def crossing_path(self, junction: int, source: str, target: str, lane: int = 0) -> Path:
        """A lane across a junction from arm `source` to arm `target`, with the adjacent pieces at full length.

        Arms: left, right, ahead, or `back`, where the ego comes from.
        """
        piece = self.junctions[junction].piece
        edges: list[Edge] = []
        if source == 'back':
            edges += self.forward[max(0, piece - 1) : piece]
        elif source == self.junctions[junction].spec.turn:
            edges += self.backward[piece + 1 : piece + 2]
        else:
            edges.append((f'j{piece}{source}far_in', f'j{piece}{source}in'))
        edges.append((self.node_into(piece, source), self.node_out_of(piece, target)))
        if target == 'back':
            edges += self.backward[max(0, piece - 1) : piece]
        elif target == self.junctions[junction].spec.turn:
            edges += self.forward[piece + 1 : piece + 2]
        else:
            edges.append((f'j{piece}{target}out', f'j{piece}{target}far_out'))
        found = self.path(edges, lane)
        if source not in ('back', self.junctions[junction].spec.turn):
            before_m = self.lane(edges[0], lane).length - ARM_LENGTH_M
            found.start_s_m -= before_m
            found.length_m -= before_m
            found.end_s_m -= before_m
        return found

    def node_into(self, piece: int, arm: str) -> str:
        """Node at which the lanes of `arm` enter the junction that is piece `piece`."""
        if arm == 'back':
            return f'c{piece}'
        return f'b{piece + 1}' if arm == self._turn(piece) else f'j{piece}{arm}in'

    def node_out_of(self, piece: int, arm: str) -> str:
        """Node at which the lanes of `arm` leave the junction that is piece `piece`."""
        if arm == 'back':
            return f'b{piece}'
        return f'c{piece + 1}' if arm == self._turn(piece) else f'j{piece}{arm}out'

    def _turn(self, piece: int) -> str:
        spec = self.layout.pieces[piece]
        assert isinstance(spec, Junction)
        return spec.turn
