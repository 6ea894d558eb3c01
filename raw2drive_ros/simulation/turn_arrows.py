"""Marks of turn lanes before junctions: arrows on the lanes, and solid lines between them."""

from __future__ import annotations

import numpy as np

from raw2drive_ros.contracts.public import Float64
from raw2drive_ros.simulation.lanes import ArcLane
from raw2drive_ros.simulation.roads import Marking, Pose, RoadMap, advance

# Where the tips of the arrows are, before the stop line, and how long lines are solid there.
ARROWS_M, SOLID_M = (3.0, 22.0), 30.0
LENGTH_M, HALF_SHAFT_M, HEAD_M, HALF_HEAD_M = 4.0, 0.12, 1.2, 0.45
ROOM_M = 2.0


def mark_turn_lanes(road: RoadMap) -> None:
    """Add arrows and solid lines to the approaches of all junctions with turn lanes."""
    for site in road.junctions:
        if not site.spec.turn_lanes:
            continue
        for arm in site.inlets:
            node = road.node_into(site.piece, arm)
            lanes = road.lanes_into(node)
            before = site.spec.line_before_m(arm)
            turns = [_turns_of(road, node, number) for number in range(len(lanes))]
            for number, lane in enumerate(lanes):
                if number:
                    road.markings.append(Marking('white', _line_beside(lane, before)))
                for tip in ARROWS_M:
                    station = lane.length - before - tip
                    if station > LENGTH_M + ROOM_M:
                        for part in arrow_m(lane.pose(station), turns[number]):
                            road.markings.append(Marking('arrow', part))


def _turns_of(road: RoadMap, node: str, number: int) -> list[str]:
    """The turns that lane `number` may make at the end of its road."""
    across = [lane for lanes in road.network.graph[node].values() for lane in lanes]
    return sorted({lane.turn for lane in across if lane.from_lane == number and lane.junction >= 0})


def _line_beside(lane: ArcLane, before_m: float) -> Float64:
    """(N, 2) points of the left edge of the last part of a lane."""
    end = lane.length - before_m
    stations = np.arange(max(0.0, end - SOLID_M), end + 0.01, 1.0)
    return np.array([lane.pose(float(s), lane.width / 2)[:2] for s in stations])


def arrow_m(tip: Pose, turns: list[str]) -> list[Float64]:
    """(N, 2) polygons of an arrow that ends at `tip` and points to `turns` (left, ahead, right)."""
    neck = advance(tip, -HEAD_M)
    fork = tip if turns == ['ahead'] else advance(tip, -HEAD_M - 0.6)
    shapes = [(advance(tip, -LENGTH_M), neck if 'ahead' in turns else fork)]
    found = []
    if 'ahead' in turns:
        found.append(_polygon(neck, ((0.0, -HALF_HEAD_M), (HEAD_M, 0.0), (0.0, HALF_HEAD_M))))
    for side, turn in ((1.0, 'left'), (-1.0, 'right')):
        if turn in turns:
            bar = ((-2 * HALF_SHAFT_M, 0.0), (0.0, 0.0), (0.0, 0.5 * side), (-2 * HALF_SHAFT_M, 0.5 * side))
            found.append(_polygon(fork, bar))
            middle, base = -HALF_SHAFT_M, 0.5 * side
            head = ((middle - HALF_HEAD_M, base), (middle, base + 0.7 * side), (middle + HALF_HEAD_M, base))
            found.append(_polygon(fork, head))
    for begin, end in shapes:
        edges = [(begin, -HALF_SHAFT_M), (end, -HALF_SHAFT_M), (end, HALF_SHAFT_M), (begin, HALF_SHAFT_M)]
        found.append(np.array([advance(pose, 0.0, aside)[:2] for pose, aside in edges]))
    return found


def _polygon(pose: Pose, corners: tuple[tuple[float, float], ...]) -> Float64:
    return np.array([advance(pose, along, aside)[:2] for along, aside in corners])
