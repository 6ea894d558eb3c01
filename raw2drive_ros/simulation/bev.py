"""BEV masks of a world: 43 binary channels in the ego's frame, heading up (paper, appendix C.1).

Static layers are rasterised once per map as bit planes of one image and warped per frame; boxes are
drawn per frame from world-frame history, so the past is exact and not a warped old picture.
"""

from __future__ import annotations

import math

import cv2
import numpy as np
from numpy.typing import NDArray

from raw2drive_ros.bev_channels import (
    CHANNEL_COUNT,
    EGO_COLUMN_PX,
    EGO_ROW_PX,
    HISTORY_TICKS,
    PIXELS_PER_M,
    SIZE_PX,
    STATIC_CHANNELS,
    dynamic_channel,
)
from raw2drive_ros.contract import Float64
from raw2drive_ros.simulation.actors import Actor, corners_m
from raw2drive_ros.simulation.layout import LANE_WIDTH_M
from raw2drive_ros.simulation.world import World

MAP_PIXELS_PER_M = 4.0
ROUTE_STROKE_M = 2.0
LINE_STROKE_M = 0.6
ROUTE_AHEAD_M = 60.0
MIN_HALF_EXTENT_M = 0.8
NEAR_M = 60.0
SHIFT = 4

# Which class a kind of actor is drawn as.
CLASS_OF = {
    'car': 'vehicle',
    'van': 'vehicle',
    'parked': 'vehicle',
    'parked_van': 'vehicle',
    'emergency': 'emergency_vehicle',
    'parked_emergency': 'emergency_vehicle',
    'door': 'obstacle',
    'cyclist': 'cyclist',
    'walker': 'walker',
    'barrier': 'obstacle',
    'cone': 'obstacle',
}
MAP_BITS = {'road': 0, 'route_lane': 1, 'centre_line': 2, 'lane_line': 3, 'crosswalk_or_stop_line': 4}
Mask = NDArray[np.uint8]


class BevRenderer:
    """Draws one world's masks; build a new one per episode."""

    def __init__(self, world: World) -> None:
        self.world = world
        points = np.concatenate(world.road.surfaces_m)
        self.origin = points.min(axis=0) - 5.0
        size = np.ceil((points.max(axis=0) + 5.0 - self.origin) * MAP_PIXELS_PER_M).astype(int)
        self.map: Mask = np.zeros((size[1], size[0]), np.uint8)
        self._draw_map()

    def _to_map(self, points_m: Float64) -> NDArray[np.int32]:
        return np.round((points_m - self.origin) * MAP_PIXELS_PER_M * 2**SHIFT).astype(np.int32)

    def _draw_map(self) -> None:
        planes = {name: np.zeros_like(self.map) for name in MAP_BITS}
        for polygon in self.world.road.surfaces_m:
            cv2.fillPoly(planes['road'], [self._to_map(polygon)], 1, shift=SHIFT)
        thickness = max(1, round(LINE_STROKE_M * MAP_PIXELS_PER_M))
        for marking in self.world.road.markings:
            kind = marking.kind
            if kind == 'zebra':
                cv2.fillPoly(planes['crosswalk_or_stop_line'], [self._to_map(marking.points_m)], 1, shift=SHIFT)
                continue
            plane = (
                'crosswalk_or_stop_line'
                if kind == 'stop'
                else 'centre_line'
                if kind.startswith('yellow')
                else 'lane_line'
            )
            cv2.polylines(planes[plane], [self._to_map(marking.points_m)], False, 1, thickness, shift=SHIFT)
        route = self._to_map(self.world.route.points_m)
        wide = round(LANE_WIDTH_M * MAP_PIXELS_PER_M)
        cv2.polylines(planes['route_lane'], [route], False, 1, wide, shift=SHIFT)
        for name, bit in MAP_BITS.items():
            self.map |= planes[name] << bit

    def render(self) -> NDArray[np.bool_]:
        """(43, 128, 128) bool."""
        world = self.world
        masks = np.zeros((CHANNEL_COUNT, SIZE_PX, SIZE_PX), np.uint8)
        x, y, yaw = world.ego_history[0]
        static = self._warp_map(x, y, yaw)
        for name, bit in MAP_BITS.items():
            masks[STATIC_CHANNELS.index(name)] = (static >> bit) & 1
        to_pixels = _pixels_from_map(x, y, yaw)
        ahead = world.route.window(max(0.0, world.route_s_m - 2.0), ROUTE_AHEAD_M)
        if len(ahead) > 1:
            stroke = round(ROUTE_STROKE_M * PIXELS_PER_M)
            cv2.polylines(
                masks[STATIC_CHANNELS.index('route')], [_fixed(ahead, to_pixels)], False, 1, stroke, shift=SHIFT
            )
        ego = corners_m(x, y, yaw, world.ego.LENGTH, world.ego.WIDTH)
        cv2.fillConvexPoly(masks[STATIC_CHANNELS.index('ego')], _fixed(ego, to_pixels), 1, shift=SHIFT)
        for moment, age in enumerate(HISTORY_TICKS):
            self._draw_actors(masks, moment, min(age, len(world.history) - 1), (x, y), to_pixels)
            self._draw_signals(masks, moment, min(age, len(world.light_history) - 1), to_pixels)
        return masks.view(np.bool_)

    def _warp_map(self, x: float, y: float, yaw: float) -> Mask:
        """The map's bit planes in the ego's frame, nearest neighbour (bits must not mix)."""
        cos, sin = math.cos(yaw), math.sin(yaw)
        # Inverse map: pixel (column, row) of the mask -> pixel of the map image.
        scale = MAP_PIXELS_PER_M / PIXELS_PER_M
        # ego x = (EGO_ROW - row) / ppm, ego y = (EGO_COLUMN - column) / ppm; +0.5 centres the pixels.
        ex, ey = (EGO_ROW_PX - 0.5), (EGO_COLUMN_PX - 0.5)
        ox, oy = (x - self.origin[0]) * MAP_PIXELS_PER_M, (y - self.origin[1]) * MAP_PIXELS_PER_M
        matrix = np.array(
            [
                [scale * sin, -scale * cos, ox + scale * (cos * ex - sin * ey)],
                [-scale * cos, -scale * sin, oy + scale * (sin * ex + cos * ey)],
            ]
        )
        warped: Mask = cv2.warpAffine(
            self.map, matrix, (SIZE_PX, SIZE_PX), flags=cv2.INTER_NEAREST | cv2.WARP_INVERSE_MAP
        )
        return warped

    def _draw_actors(
        self,
        masks: Mask,
        moment: int,
        age: int,
        ego_m: tuple[float, float],
        to_pixels: Float64,
    ) -> None:
        actors, poses = self.world.history[age]
        for actor, (x, y, yaw) in zip(actors, poses, strict=True):
            if abs(x - ego_m[0]) > NEAR_M or abs(y - ego_m[1]) > NEAR_M:
                continue
            length, width = _drawn_size(actor)
            box = _fixed(corners_m(x, y, yaw, length, width), to_pixels)
            cv2.fillConvexPoly(masks[dynamic_channel(CLASS_OF[actor.kind], moment)], box, 1, shift=SHIFT)

    def _draw_signals(self, masks: Mask, moment: int, age: int, to_pixels: Float64) -> None:
        """Lights and stop signs as bars across the ego's lane at their line."""
        world = self.world
        colours = world.light_history[age]
        for light, colour in zip(world.lights, colours, strict=True):
            self._bar(masks[dynamic_channel(f'light_{colour}', moment)], light.line_s_m, to_pixels)
        for sign in world.stop_signs:
            if not sign.obeyed:
                self._bar(masks[dynamic_channel('stop_sign', moment)], sign.line_s_m, to_pixels)

    def _bar(self, mask: Mask, s_m: float, to_pixels: Float64) -> None:
        x, y, yaw = self.world.route.pose(s_m)
        bar = corners_m(x, y, yaw, 1.5, LANE_WIDTH_M)
        cv2.fillConvexPoly(mask, _fixed(bar, to_pixels), 1, shift=SHIFT)


def _drawn_size(actor: Actor) -> tuple[float, float]:
    return max(actor.LENGTH, 2 * MIN_HALF_EXTENT_M), max(actor.WIDTH, 2 * MIN_HALF_EXTENT_M)


def _pixels_from_map(x: float, y: float, yaw: float) -> Float64:
    """(2, 3) affine from `map` metres to (column, row) pixels, in OpenCV's centre-of-pixel convention."""
    cos, sin = math.cos(yaw), math.sin(yaw)
    linear = PIXELS_PER_M * np.array([[sin, -cos], [-cos, -sin]])
    offset = np.array([EGO_COLUMN_PX - 0.5, EGO_ROW_PX - 0.5]) - linear @ (x, y)
    return np.column_stack([linear, offset])


def _fixed(points_m: Float64, affine: Float64) -> NDArray[np.int32]:
    pixels = points_m @ affine[:, :2].T + affine[:, 2]
    return np.round(np.clip(pixels, -1000, 1000) * 2**SHIFT).astype(np.int32)
