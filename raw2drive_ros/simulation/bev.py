"""BEV masks of a world: 43 binary channels in the ego frame, heading up (paper, appendix C.1).

Static layers are rasterised once per map, as bit planes of one image, and warped for every frame. Actors are drawn for
every frame from their poses in `map`, past ones included, so past masks are exact rather than warped old masks.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Protocol

import cv2
import numpy as np
from numpy.typing import NDArray

from raw2drive_ros.contracts.public import Float64
from raw2drive_ros.simulation.actors import Actor, corners_m
from raw2drive_ros.simulation.signals import StopSign
from raw2drive_ros.simulation.world import World
from raw2drive_ros.tables.bev_channels import (
    CHANNEL_COUNT,
    EGO_COLUMN_PX,
    EGO_ROW_PX,
    HISTORY_TICKS,
    PIXELS_PER_M,
    SIZE_PX,
    STATIC_CHANNELS,
    dynamic_channel,
)

MAP_PIXELS_PER_M = 4.0
ROUTE_STROKE_M = 2.0
LINE_STROKE_M = 0.6
ROUTE_AHEAD_M = 60.0
MIN_HALF_EXTENT_M = 0.8
SHIFT = 4

# Kind of actor -> class of dynamic channel.
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
CLASS_CHANNEL = {kind: dynamic_channel(name, 0) for kind, name in CLASS_OF.items()}
# Bit plane `i` of the map image holds static channel `i`.
MAP_LAYERS = ('road', 'route_lane', 'centre_line', 'lane_line', 'crosswalk_or_stop_line')
STATIC_BITS = np.arange(len(STATIC_CHANNELS), dtype=np.uint8)[:, None, None]
ROUTE, EGO = STATIC_CHANNELS.index('route'), STATIC_CHANNELS.index('ego')
# Corners of a box in half lengths and half widths, counter-clockwise from front left.
BOX = np.array([(1.0, 1.0), (-1.0, 1.0), (-1.0, -1.0), (1.0, -1.0)])
Mask = NDArray[np.uint8]


class Seen(Protocol):
    """What was seen lately at each of `HISTORY_TICKS`. moment: index of it."""

    def actor(self, actor: Actor, moment: int) -> bool:
        """Whether the actor had been seen."""

    def light(self, index: int, moment: int) -> str:
        """Colour in which a light of the ego was last seen, '' where it was not."""

    def sign(self, index: int, moment: int) -> bool:
        """Whether a stop sign of the ego had been seen."""


class BevRenderer:
    """Renders the masks of one world; make a new one for every episode.

    drawn: (actor, index of the moment, channel, polygon in fixed-point pixels) of every box in the last masks.
    """

    def __init__(self, world: World) -> None:
        self.world = world
        points = np.concatenate(world.road.surfaces_m)
        self.origin = points.min(axis=0) - 5.0
        size = np.ceil((points.max(axis=0) + 5.0 - self.origin) * MAP_PIXELS_PER_M).astype(int)
        self.map: Mask = np.zeros((size[1], size[0]), np.uint8)
        self.drawn: list[tuple[Actor, int, int, NDArray[np.int32]]] = []
        self._draw_map()

    def _to_map(self, points_m: Float64) -> NDArray[np.int32]:
        return np.round((points_m - self.origin) * MAP_PIXELS_PER_M * 2**SHIFT).astype(np.int32)

    def _draw_map(self) -> None:
        planes = {name: np.zeros_like(self.map) for name in MAP_LAYERS}
        for polygon in self.world.road.surfaces_m:
            cv2.fillPoly(planes['road'], [self._to_map(polygon)], 1, shift=SHIFT)
        for polygon in self.world.road.islands_m:
            cv2.fillPoly(planes['road'], [self._to_map(polygon)], 0, shift=SHIFT)
        thickness = max(1, round(LINE_STROKE_M * MAP_PIXELS_PER_M))
        for marking in self.world.road.markings:
            kind = marking.kind
            if kind == 'arrow':
                continue
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
            cv2.polylines(
                planes[plane],
                [self._to_map(marking.points_m)],
                isClosed=False,
                color=1,
                thickness=thickness,
                shift=SHIFT,
            )
        route = self._to_map(self.world.route.points_m)
        wide = round(self.world.scene.layout.lane_width_m * MAP_PIXELS_PER_M)
        cv2.polylines(planes['route_lane'], [route], isClosed=False, color=1, thickness=wide, shift=SHIFT)
        for name in MAP_LAYERS:
            self.map |= planes[name] << STATIC_CHANNELS.index(name)

    def render(self) -> NDArray[np.bool_]:
        """(43, 128, 128) bool: the masks of the world as it is now."""
        world = self.world
        masks = np.zeros((CHANNEL_COUNT, SIZE_PX, SIZE_PX), np.uint8)
        x, y, yaw = world.ego_history[0]
        static = masks[: len(STATIC_CHANNELS)]
        np.right_shift(self._warp_map(x, y, yaw), STATIC_BITS, out=static)
        np.bitwise_and(static, 1, out=static)
        to_pixels = _pixels_from_map(x, y, yaw)
        ahead = world.route.window(max(0.0, world.route_s_m - 2.0), ROUTE_AHEAD_M)
        if len(ahead) > 1:
            stroke = round(ROUTE_STROKE_M * PIXELS_PER_M)
            cv2.polylines(
                masks[ROUTE], [_fixed(ahead, to_pixels)], isClosed=False, color=1, thickness=stroke, shift=SHIFT
            )
        ego = corners_m(x, y, yaw, world.ego.LENGTH, world.ego.WIDTH)
        cv2.fillConvexPoly(masks[EGO], _fixed(ego, to_pixels), 1, shift=SHIFT)
        self._draw_actors(masks, to_pixels)
        if world.lights or world.stop_signs:
            for moment in range(len(HISTORY_TICKS)):
                self._draw_signals(masks, moment, self._colours_then(moment), world.stop_signs, to_pixels)
        return masks.view(np.bool_)

    def render_seen(self, masks: NDArray[np.bool_], seen: Seen) -> NDArray[np.bool_]:
        """The masks that `render` has just returned, with only those actors, lights and signs that were seen."""
        world = self.world
        shown = [seen.actor(actor, moment) for actor, moment, _, _ in self.drawn]
        moments = range(len(HISTORY_TICKS))
        colours = [tuple(seen.light(index, moment) for index in range(len(world.lights))) for moment in moments]
        signs = [[s for index, s in enumerate(world.stop_signs) if seen.sign(index, moment)] for moment in moments]
        known = all(colours[m] == self._colours_then(m) and len(signs[m]) == len(world.stop_signs) for m in moments)
        if known and all(shown):
            # The same array, which `tick_messages` packs once.
            return masks
        visible = np.zeros_like(masks, dtype=np.uint8)
        visible[: len(STATIC_CHANNELS)] = masks[: len(STATIC_CHANNELS)]
        for (_, _, channel, polygon), there in zip(self.drawn, shown, strict=True):
            if there:
                cv2.fillConvexPoly(visible[channel], polygon, 1, cv2.LINE_8, SHIFT)
        if world.lights or world.stop_signs:
            to_pixels = _pixels_from_map(*world.ego_history[0])
            for moment in moments:
                self._draw_signals(visible, moment, colours[moment], signs[moment], to_pixels)
        return visible.view(np.bool_)

    def _colours_then(self, moment: int) -> tuple[str, ...]:
        """The colours of the ego's lights at `HISTORY_TICKS[moment]`."""
        history = self.world.light_history
        return history[min(HISTORY_TICKS[moment], len(history) - 1)]

    def _warp_map(self, x: float, y: float, yaw: float) -> Mask:
        """The map's bit planes in the ego frame; nearest neighbour, because bit planes cannot be interpolated."""
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

    def _draw_actors(self, masks: Mask, to_pixels: Float64) -> None:
        """Boxes of the actors at all `HISTORY_TICKS`, transformed in one pass."""
        world = self.world
        self.drawn = []
        kept: list[tuple[Actor, int, int]] = []
        sizes: list[tuple[float, float]] = []
        moments = []
        for moment, age in enumerate(HISTORY_TICKS):
            actors, poses = world.history[min(age, len(world.history) - 1)]
            if not actors:
                continue
            moments.append(poses)
            kept += [(actor, moment, CLASS_CHANNEL[actor.kind] + moment) for actor in actors]
            sizes += [(actor.LENGTH, actor.WIDTH) for actor in actors]
        if not moments:
            return
        poses = np.concatenate(moments)
        half = np.maximum(np.array(sizes) / 2, MIN_HALF_EXTENT_M)
        cos, sin = np.cos(poses[:, 2]), np.sin(poses[:, 2])
        corners = BOX * half[:, None]
        turn = np.stack([cos, sin, -sin, cos], axis=1).reshape(-1, 2, 2)
        boxes = corners @ turn + poses[:, None, :2]
        pixels = boxes @ to_pixels[:, :2].T + to_pixels[:, 2]
        middle = pixels.mean(axis=1)
        reach = PIXELS_PER_M * half.sum(axis=1)[:, None] + 1.0
        inside = ((middle > -reach) & (middle < SIZE_PX + reach)).all(axis=1)
        fixed = _rounded(pixels)
        for index in np.flatnonzero(inside).tolist():
            cv2.fillConvexPoly(masks[kept[index][2]], fixed[index], 1, cv2.LINE_8, SHIFT)
            self.drawn.append((*kept[index], fixed[index]))

    def _draw_signals(
        self, masks: Mask, moment: int, colours: Sequence[str], signs: Sequence[StopSign], to_pixels: Float64
    ) -> None:
        """Traffic lights and stop signs as bars across the ego's lane at their stop line. colours: '' is not drawn."""
        for light, colour in zip(self.world.lights, colours, strict=True):
            if colour:
                self._bar(masks[dynamic_channel(f'light_{colour}', moment)], light.line_s_m, to_pixels)
        for sign in signs:
            if not sign.obeyed:
                self._bar(masks[dynamic_channel('stop_sign', moment)], sign.line_s_m, to_pixels)

    def _bar(self, mask: Mask, s_m: float, to_pixels: Float64) -> None:
        x, y, yaw = self.world.route.pose(s_m)
        bar = corners_m(x, y, yaw, 1.5, self.world.scene.layout.lane_width_m)
        cv2.fillConvexPoly(mask, _fixed(bar, to_pixels), 1, shift=SHIFT)


def _pixels_from_map(x: float, y: float, yaw: float) -> Float64:
    """(2, 3) affine from `map` metres to (column, row) pixels, in OpenCV's centre-of-pixel convention."""
    cos, sin = math.cos(yaw), math.sin(yaw)
    a, b = PIXELS_PER_M * sin, PIXELS_PER_M * cos
    return np.array(
        [
            [a, -b, EGO_COLUMN_PX - 0.5 - (a * x - b * y)],
            [-b, -a, EGO_ROW_PX - 0.5 + (b * x + a * y)],
        ]
    )


def _fixed(points_m: Float64, affine: Float64) -> NDArray[np.int32]:
    return _rounded(points_m @ affine[:, :2].T + affine[:, 2])


def _rounded(pixels: Float64) -> NDArray[np.int32]:
    return np.rint(np.minimum(np.maximum(pixels, -1000.0), 1000.0) * 2**SHIFT).astype(np.int32)
