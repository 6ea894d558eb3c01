"""A geometric stand-in for visibility: within range and not behind another box, seen from above."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from raw2drive_ros.contracts.public import Float64
from raw2drive_ros.simulation.actors import corners_m
from raw2drive_ros.simulation.world import World

RANGE_M = {'walker': 45.0, 'cyclist': 45.0, 'cone': 35.0, 'door': 35.0}
FAR_M = 75.0
TALL_M = 1.6


class GeometricSight:
    """`update` once per decision; then as `simulation.visibility.Visibility`."""

    def __init__(self) -> None:
        self.seen: dict[int, float] = {}
        self.time_s = 0.0
        self.lights: dict[int, float] = {}
        self.signs: dict[int, float] = {}

    def update(self, world: World) -> None:
        self.time_s = world.time_s
        ego = world.ego.position
        blockers = [a for a in world.actors if a.HEIGHT >= TALL_M and np.abs(a.position - ego).max() < FAR_M]
        segments = np.array([_diagonals(a) for a in blockers]).reshape(-1, 2, 2, 2)
        owner = [id(a) for a in blockers]
        for actor in world.actors:
            distance = math.hypot(*(actor.position - ego))
            if distance > RANGE_M.get(actor.kind, FAR_M):
                continue
            points = corners_m(*map(float, actor.position), actor.heading, actor.LENGTH, actor.WIDTH)
            keep = np.array([o != id(actor) for o in owner], bool)
            if not keep.any() or not _hidden(ego, points, segments[keep]).all():
                self.seen[id(actor)] = world.time_s
        for i, light in enumerate(world.lights):
            if 0.0 < light.line_s_m - world.route_s_m < 60.0:
                self.lights[i] = world.time_s
        for i, sign in enumerate(world.stop_signs):
            if 0.0 < sign.line_s_m - world.route_s_m < 50.0:
                self.signs[i] = world.time_s

    def seconds_since_seen(self, actor: Any) -> float:
        return self.time_s - self.seen.get(id(actor), -math.inf)

    def light_seen_s(self, index: int) -> float:
        return self.time_s - self.lights.get(index, -math.inf)

    def sign_seen_s(self, index: int) -> float:
        return self.time_s - self.signs.get(index, -math.inf)


def _diagonals(actor: Any) -> Float64:
    c = corners_m(*map(float, actor.position), actor.heading, actor.LENGTH, actor.WIDTH)
    return np.array([(c[0], c[2]), (c[1], c[3])])


def _hidden(eye: Float64, points: Float64, segments: Float64) -> Any:
    """(P,) whether the line from `eye` to each point crosses a diagonal of any box."""
    a, b = segments[:, :, 0].reshape(-1, 2), segments[:, :, 1].reshape(-1, 2)
    ray = (points - eye)[:, None]
    side_a = ray[..., 0] * (a - eye)[None, :, 1] - ray[..., 1] * (a - eye)[None, :, 0]
    side_b = ray[..., 0] * (b - eye)[None, :, 1] - ray[..., 1] * (b - eye)[None, :, 0]
    along = b - a
    to_eye = along[:, 0] * (eye - a)[:, 1] - along[:, 1] * (eye - a)[:, 0]
    to_point = along[None, :, 0] * (points[:, None] - a)[..., 1] - along[None, :, 1] * (points[:, None] - a)[..., 0]
    return ((side_a * side_b < 0.0) & (to_eye[None] * to_point < 0.0)).any(axis=1)
