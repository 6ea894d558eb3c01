"""What stands beside the road and hides what is behind it: houses, trees, walls, hedges, hills and poles.

Nothing of it is an actor: it stands clear of roads and sidewalks, cannot be hit from them, and is in no mask. Close to
junctions it is placed so that it narrows the view into the roads across.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from raw2drive_ros.contracts.public import Float64
from raw2drive_ros.simulation.draws import EVALUATION, TRAINING, VALIDATION, Draw
from raw2drive_ros.simulation.road_surface import OFF, RoadSurface
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
# Distance of the faces that look to the road from the edge of the sidewalk.
CLEAR_M = 1.5
SPACING_M = (9.0, 26.0)
FAR_M = {'hill': 25.0}
PER_CORNER = 2
# An item that does not fit is moved away from the road in steps, so many times.
STEP_M, STEPS = 1.5, 10


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
        """(N, 2) points on the edge and in the middle of its outline, about a metre apart."""
        half_l, half_w = self.length_m / 2 + margin_m, self.width_m / 2 + margin_m
        along = np.linspace(-half_l, half_l, max(3, math.ceil(2 * half_l)))
        across = np.linspace(-half_w, half_w, max(3, math.ceil(2 * half_w)))
        grid = np.stack(np.meshgrid(along, across), axis=-1).reshape(-1, 2)
        cos, sin = math.cos(self.yaw_rad), math.sin(self.yaw_rad)
        return grid @ np.array([[cos, sin], [-sin, cos]]) + (self.x_m, self.y_m)


def place_scenery(road: RoadMap, surface: RoadSurface, draw: Draw) -> tuple[SceneryItem, ...]:
    """The scenery of a scene, the same for the event and its twin."""
    rng = draw.stream('scenery')
    density = float(rng.uniform(0.35, 1.0))
    found: list[SceneryItem] = []
    for pose in _corners(road):
        for _ in range(PER_CORNER):
            if rng.random() < density:
                _try(found, surface, _item(rng, draw.split, pose, near=True))
    for lane_pose in _roadsides(road, rng):
        item = _item(rng, draw.split, lane_pose, near=False)
        if rng.random() < density:
            _try(found, surface, item)
    return tuple(found)


def _corners(road: RoadMap) -> list[Pose]:
    """Poses at the corners of junctions, from which scenery is moved away until it is clear of the road."""
    found = []
    for site in road.junctions:
        bearings = sorted(pose[2] + math.pi for pose in site.inlets.values())
        for one, other in zip(bearings, [*bearings[1:], bearings[0] + 2.0 * math.pi], strict=True):
            if other - one < math.pi * 0.95:
                middle = (one + other) / 2.0
                found.append(advance((*site.centre_m, middle), site.half_size_m * 0.8))
    return found


def _roadsides(road: RoadMap, rng: np.random.Generator) -> list[Pose]:
    """Poses beside all roads, every few metres, heading away from the road."""
    found = []
    for start in road.network.graph:
        for lanes in road.network.graph[start].values():
            lane = lanes[-1]
            if lane.junction >= 0:
                continue
            station = float(rng.uniform(0.0, SPACING_M[1]))
            while station < lane.length:
                x, y, yaw = lane.pose(station, -lane.width / 2)
                found.append((x, y, yaw - math.pi / 2))
                station += float(rng.uniform(*SPACING_M))
    return found


def _item(rng: np.random.Generator, split: str, pose: Pose, *, near: bool) -> SceneryItem:
    """An item that stands at `pose`, its length across the direction of the pose."""
    kinds = [kind for kind in KINDS[split] if not near or kind in ('house', 'wall', 'hedge')]
    kind = kinds[int(rng.integers(len(kinds)))]
    length, width, height = (float(rng.uniform(*span)) for span in SIZES_M[kind])
    colours = COLOURS[split]
    colour = colours[int(rng.integers(len(colours)))]
    away = FAR_M.get(kind, 0.0) + (0.0 if near else float(rng.exponential(4.0)))
    turn = float(rng.normal(0.0, 0.08))
    x, y, yaw = advance(pose, width / 2 + away)
    seed = int(rng.integers(2**31))
    return SceneryItem(kind, x, y, yaw + math.pi / 2 + turn, length, width, height, colour, seed)


def _try(found: list[SceneryItem], surface: RoadSurface, item: SceneryItem) -> None:
    """Move an item away from the road until it is clear of all roads, sidewalks and other items; or leave it out."""
    away = item.yaw_rad - math.pi / 2
    for step in range(STEPS):
        by = step * STEP_M
        moved = replace(item, x_m=item.x_m + by * math.cos(away), y_m=item.y_m + by * math.sin(away))
        if (surface.kind_at(moved.footprint_m(CLEAR_M)) != OFF).any():
            continue
        reach = math.hypot(moved.length_m, moved.width_m) / 2
        apart = (
            math.hypot(moved.x_m - o.x_m, moved.y_m - o.y_m) > reach + math.hypot(o.length_m, o.width_m) / 2
            for o in found
        )
        if all(apart):
            found.append(moved)
        return
