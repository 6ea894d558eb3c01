"""What stands beside the road and hides what is behind it: houses, trees, walls, hedges, hills and poles.

Nothing of it is an actor: it stands clear of roads and sidewalks, cannot be hit from them, and is in no mask. Close to
junctions it is placed so that it narrows the view into the roads across for who comes, not for who waits at the line.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from raw2drive_ros.contracts.public import Float64
from raw2drive_ros.simulation.boxes import boxes_overlap, corners_m
from raw2drive_ros.simulation.draws import EVALUATION, TRAINING, VALIDATION, Draw
from raw2drive_ros.simulation.lanes import ArcLane
from raw2drive_ros.simulation.road_surface import OFF, SIDEWALK, RoadSurface
from raw2drive_ros.simulation.roads import Pose, RoadMap, advance

# kind: (length, width, height) in metres, each from ... to; the length runs along the road.
SIZES_M = {
    'house': ((8.0, 18.0), (7.0, 12.0), (4.0, 11.0)),
    'tree': ((3.0, 6.0), (3.0, 6.0), (4.0, 10.0)),
    'wall': ((8.0, 24.0), (0.3, 0.4), (1.2, 2.4)),
    'hedge': ((6.0, 20.0), (0.8, 1.4), (0.9, 1.8)),
    'hill': ((30.0, 60.0), (20.0, 40.0), (4.0, 12.0)),
    'pole': ((0.2, 0.3), (0.2, 0.3), (5.0, 8.0)),
}
KINDS = {
    TRAINING: ('house', 'house', 'tree', 'tree', 'tree', 'wall', 'hedge', 'pole', 'hill'),
    VALIDATION: ('house', 'tree', 'tree', 'hedge', 'hedge', 'pole', 'hill'),
    EVALUATION: ('house', 'house', 'tree', 'tree', 'wall', 'wall', 'hedge', 'pole', 'hill'),
}
# Colours are numbered; each split has its own.
COLOURS = {TRAINING: range(8), VALIDATION: range(6, 11), EVALUATION: range(8, 14)}
# At the corners of junctions: what stands there is high enough to hide a car.
CORNER_KINDS, CORNER_HEIGHT_M = ('house', 'wall', 'hedge'), 1.9
# Distance of the faces that look to the road from the edge of the sidewalk.
CLEAR_M = 1.5
# One item per so many metres of roadside, within what a scene of ordinary length holds.
SPACING_M, FEWEST, MOST = (15.0, 28.0), 40, 90
ORDINARY_M = 2500.0
ROUNDS = 8
FAR_M = {'hill': 25.0}
PER_CORNER, AT_CORNER = 2, (0.3, 0.95)
# Who stands with the eye so far before the stop line sees so much of the roads across. At some junctions, this share of
# them, so does who comes near.
STANDS_M, COMES_M, SEES_M, OPEN_SHARE = 4.0, (12.0, 32.0), 65.0, 0.6
# An item that does not fit is moved away from the road in steps, so many times.
STEP_M, STEPS = 1.5, 12
# Between items.
APART_M = 0.5


@dataclass(frozen=True, slots=True)
class SceneryItem:
    """kind: of `SIZES_M`. Pose in `map`, size in metres. colour: index into the renderer's paints. seed: of
    its details."""

    kind: str
    x_m: float
    y_m: float
    yaw_rad: float
    length_m: float
    width_m: float
    height_m: float
    colour: int
    seed: int

    def footprint_m(self, margin_m: float = 0.0) -> Float64:
        """(N, 2) points on the edge of its outline, about a metre apart: no road is so small that it fits inside."""
        half_l, half_w = self.length_m / 2 + margin_m, self.width_m / 2 + margin_m
        along = np.linspace(-half_l, half_l, max(3, math.ceil(2 * half_l) + 1))
        across = np.linspace(-half_w, half_w, max(3, math.ceil(2 * half_w) + 1))
        grid = np.concatenate(
            [np.stack([along, np.full(len(along), side * half_w)], axis=1) for side in (-1.0, 1.0)]
            + [np.stack([np.full(len(across), side * half_l), across], axis=1) for side in (-1.0, 1.0)]
        )
        cos, sin = math.cos(self.yaw_rad), math.sin(self.yaw_rad)
        return grid @ np.array([[cos, sin], [-sin, cos]]) + (self.x_m, self.y_m)


def place_scenery(road: RoadMap, surface: RoadSurface, draw: Draw) -> tuple[SceneryItem, ...]:
    """The scenery of a scene, the same for the event and its twin."""
    rng = draw.stream('scenery')
    roadside_m = sum(lanes[-1].length for lanes in _roadside_lanes(road))
    wanted = roadside_m / float(rng.uniform(*SPACING_M))
    wanted = max(wanted, FEWEST) if roadside_m > ORDINARY_M else min(max(wanted, FEWEST), MOST)
    at_corner = float(rng.uniform(*AT_CORNER))
    ground = _with_sight(road, surface, rng)
    found: list[SceneryItem] = []
    for pose, bearing in _corners(road):
        for _ in range(PER_CORNER):
            if rng.random() < at_corner:
                _try(found, ground, _corner_item(rng, draw.split, pose, bearing), pose[2])
    for _ in range(ROUNDS):
        for pose in _roadsides(road, rng):
            if len(found) < wanted:
                _try(found, ground, _item(rng, draw.split, pose), pose[2])
    return tuple(found)


def _with_sight(road: RoadMap, surface: RoadSurface, rng: np.random.Generator) -> RoadSurface:
    """A copy of the surface in which the ground is taken over which the ego has to see, where it waits or comes."""
    ground = surface.copy()
    for site in road.junctions:
        is_open, comes_m = rng.random() < OPEN_SHARE, float(rng.uniform(*COMES_M))
        eye = advance(site.inlets['back'], -(comes_m if is_open else STANDS_M + site.spec.line_before_m('back')))
        for arm in site.spec.arms:
            out = advance(site.inlets[arm], 0.0, 0.0, math.pi)
            points = [eye, advance(out, SEES_M), out, site.centre_m]
            ground.fill(np.array([point[:2] for point in points]), SIDEWALK)
    return ground


def _corners(road: RoadMap) -> list[tuple[Pose, float]]:
    """(pose, bearing) at the corners of junctions: the way from the middle outwards, from which scenery is moved until
    it is clear of the roads, and the direction of a road that it stands along."""
    found = []
    for site in road.junctions:
        bearings = sorted(pose[2] + math.pi for pose in site.inlets.values())
        for one, other in zip(bearings, [*bearings[1:], bearings[0] + 2.0 * math.pi], strict=True):
            if other - one < math.pi * 0.95:
                pose = advance((*site.centre_m, (one + other) / 2.0), site.half_size_m * 0.6)
                found += [(pose, one), (pose, other)]
    return found


def _roadside_lanes(road: RoadMap) -> list[list[ArcLane]]:
    """The lanes of all edges outside of junctions."""
    edges = [lanes for ends in road.network.graph.values() for lanes in ends.values()]
    return [lanes for lanes in edges if lanes[-1].junction < 0]


def _roadsides(road: RoadMap, rng: np.random.Generator) -> list[Pose]:
    """Poses beside all roads, in random order, heading away from the road."""
    found: list[Pose] = []
    for lanes in _roadside_lanes(road):
        lane = lanes[-1]
        for station in rng.uniform(0.0, lane.length, max(1, round(lane.length / SPACING_M[1]))).tolist():
            x, y, yaw = lane.pose(station, -lane.width / 2)
            found.append((x, y, yaw - math.pi / 2))
    return [found[index] for index in rng.permutation(len(found)).tolist()]


def _item(rng: np.random.Generator, split: str, pose: Pose) -> SceneryItem:
    """An item that stands at `pose`, its length across the direction of the pose."""
    kinds = KINDS[split]
    kind = kinds[int(rng.integers(len(kinds)))]
    away = FAR_M.get(kind, 0.0) + float(rng.exponential(4.0))
    turn = float(rng.normal(0.0, 0.08))
    sizes = [float(rng.uniform(*span)) for span in SIZES_M[kind]]
    place = advance(pose, sizes[1] / 2 + away)
    return _made(rng, split, kind, sizes, (place[0], place[1], pose[2] + math.pi / 2 + turn))


def _corner_item(rng: np.random.Generator, split: str, pose: Pose, bearing: float) -> SceneryItem:
    """An item at the corner of a junction that stands along the road that leaves in direction `bearing`."""
    kinds = [kind for kind in CORNER_KINDS if kind in KINDS[split]]
    kind = kinds[int(rng.integers(len(kinds)))]
    length, width, height = (float(rng.uniform(*span)) for span in SIZES_M[kind])
    place = advance((pose[0], pose[1], bearing), length / 2)
    return _made(rng, split, kind, [length, width, max(height, CORNER_HEIGHT_M)], place)


def _made(rng: np.random.Generator, split: str, kind: str, sizes: list[float], pose: Pose) -> SceneryItem:
    colours = COLOURS[split]
    colour = colours[int(rng.integers(len(colours)))]
    return SceneryItem(kind, *pose, *sizes, colour, int(rng.integers(2**31)))


def _try(found: list[SceneryItem], surface: RoadSurface, item: SceneryItem, away_rad: float) -> None:
    """Move an item away from the road until it is clear of all roads, sidewalks and other items; or leave it out."""
    steps = STEP_M * np.arange(STEPS)[:, None] * (math.cos(away_rad), math.sin(away_rad))
    places = item.footprint_m(CLEAR_M)[None] + steps[:, None]
    taken = (surface.kind_at(places.reshape(-1, 2)) != OFF).reshape(STEPS, -1).any(axis=1)
    if taken.all():
        return
    dx, dy = steps[int(np.argmin(taken))].tolist()
    moved = replace(item, x_m=item.x_m + dx, y_m=item.y_m + dy)
    if not any(_touch(moved, other) for other in found):
        found.append(moved)


def _touch(one: SceneryItem, other: SceneryItem) -> bool:
    """Whether two items stand in each other, or closer than `APART_M`."""
    reach = (math.hypot(one.length_m, one.width_m) + math.hypot(other.length_m, other.width_m)) / 2 + APART_M
    if math.hypot(one.x_m - other.x_m, one.y_m - other.y_m) > reach:
        return False
    boxes = [corners_m(i.x_m, i.y_m, i.yaw_rad, i.length_m + APART_M, i.width_m + APART_M) for i in (one, other)]
    return boxes_overlap(*boxes)
