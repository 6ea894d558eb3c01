"""A scene from above, route from left to right: road, actors with their kinds and paths, signals, legend."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence
from itertools import product

import cv2
import numpy as np
from numpy.typing import NDArray

from raw2drive_ros.contracts.public import Float64
from raw2drive_ros.report.panels import Rgb, text
from raw2drive_ros.simulation.actors import Actor, PathVehicle, Walker, corners_m
from raw2drive_ros.simulation.bev import CLASS_OF
from raw2drive_ros.simulation.world import World
from raw2drive_ros.tables.bev_colours import COLOURS

MIN_HEIGHT, MAX_HEIGHT, LEGEND_PX = 230, 620, 30
MARGIN_M, NEAR_ROUTE_M = 14.0, 45.0
MAX_PIXELS_PER_M = 12.0
PATH_SECONDS, PATH_MIN_M, PATH_MAX_M = 8.0, 20.0, 90.0
SCALE_BAR_M, LONG_BAR_M, LONG_BAR_BELOW = 20, 100, 2.0
TOGETHER_PX = 30.0
BESIDE_M, DASH_POINTS = 0.1, 6
SHIFT = 4
LABEL_SIZE, COST_PER_PX = 0.38, 0.01
PAPER, GROUND, DARK = (250, 250, 250), (228, 232, 224), (40, 44, 52)
PAINT = {'white': (225, 225, 225), 'yellow': (225, 180, 60)}
LIGHTS = {'red': (235, 40, 40), 'yellow': (255, 200, 0), 'green': (0, 190, 60)}
STOP = COLOURS['stop_sign']
Colour = tuple[int, int, int]


def colour_of(kind: str) -> Colour:
    """The colour of its mask class; parked vehicles are darker."""
    red, green, blue = COLOURS[f'{CLASS_OF[kind]}@now']
    return (red * 5 // 8, green * 5 // 8, blue * 5 // 8) if kind.startswith('parked') else (red, green, blue)


class Overview:
    """Draws the current state of a world into a picture `width` pixels wide; the height follows from the scene."""

    def __init__(self, world: World, width: int) -> None:
        self.world = world
        self.later = [actor for _, actor in world.pending]
        start, goal = (np.array(world.route.pose(s)[:2]) for s in (world.route_s_m, world.goal_s_m))
        angle = math.atan2(*(goal - start)[::-1])
        turn = np.array([[math.cos(angle), math.sin(angle)], [-math.sin(angle), math.cos(angle)]])
        shown = self._shown_m() @ turn.T
        low, high = shown.min(axis=0) - MARGIN_M, shown.max(axis=0) + MARGIN_M
        size = high - low
        self.scale = float(min(width / size[0], MAX_HEIGHT / size[1], MAX_PIXELS_PER_M))
        self.height = int(max(MIN_HEIGHT, size[1] * self.scale))
        # Image rows count downwards; in the scene, y points to the left of the route.
        self.linear = self.scale * np.array([[1.0, 0.0], [0.0, -1.0]]) @ turn
        self.offset = np.array([width / 2, self.height / 2]) - self.scale * np.array([1.0, -1.0]) * (low + high) / 2
        self.canvas: Rgb = np.full((self.height + LEGEND_PX, width, 3), GROUND, np.uint8)
        self.labels: list[tuple[int, int, int, int]] = []

    def draw(self, trail_m: Sequence[tuple[float, float]] = ()) -> Rgb:
        """(H, width, 3) RGB. trail_m: positions that the ego drives through from here on."""
        self._road()
        self._routes()
        self._signals()
        for actor in (*self.later, *self.world.actors):
            self._way(actor)
        for actor in self.later:
            self._box(actor, colour_of(actor.kind), filled=False)
        for actor in self.world.actors:
            self._box(actor, colour_of(actor.kind))
        if len(trail_m) > 1:
            self._line(np.array(trail_m), COLOURS['ego'], 2)
        self._box(self.world.ego, COLOURS['ego'])
        self._name('ego', self.world.ego.position)
        gates = Counter((round(float(actor.position[0])), round(float(actor.position[1]))) for actor in self.later)
        for place, count in gates.items():
            self._name(f'{count} enter later', np.array(place, np.float64))
        for kind, places in self._groups():
            words = kind.replace('_', ' ')
            self._name(words if len(places) == 1 else f'{len(places)} x {words}', np.mean(places, axis=0))
        self._legend()
        return self.canvas

    # -- pieces -----------------------------------------------------------------------------------

    def _shown_m(self) -> Float64:
        """(N, 2): the route from start to goal, the junctions on it, and the actors near to it."""
        world = self.world
        stations = np.arange(world.route_s_m, world.goal_s_m, 5.0)
        route = np.array([world.route.pose(float(s))[:2] for s in (*stations, world.goal_s_m)])
        near = [a.position for a in world.actors if np.abs(route - a.position).max(axis=1).min() < NEAR_ROUTE_M]
        for site in world.road.junctions:
            if np.abs(route - site.centre_m).max(axis=1).min() < site.half_size_m:
                near += [site.centre_m + site.half_size_m * np.array(c) for c in product((-1, 1), repeat=2)]
        return np.concatenate([route, np.array(near).reshape(-1, 2)])

    def _groups(self) -> list[tuple[str, list[Float64]]]:
        """(kind, places) of actors of one kind that stand close together and share a label."""
        groups: list[tuple[str, list[Float64]]] = []
        for actor in self.world.actors:
            for kind, places in groups:
                apart = np.abs(np.array(places) - actor.position).max(axis=1).min()
                if kind == actor.kind and apart * self.scale < TOGETHER_PX:
                    places.append(actor.position)
                    break
            else:
                groups.append((actor.kind, [actor.position]))
        return groups

    def pixels(self, points_m: Float64) -> NDArray[np.int32]:
        """(N, 2) points of the map (m) -> (N, 2) pixels (x, y) of the picture, in units of 2**-SHIFT pixel."""
        pixels = points_m @ self.linear.T + self.offset
        return np.round(np.clip(pixels, -20_000, 20_000) * 2**SHIFT).astype(np.int32)

    def _line(self, points_m: Float64, colour: Colour, thickness: int) -> None:
        cv2.polylines(
            self.canvas,
            [self.pixels(points_m)],
            isClosed=False,
            color=colour,
            thickness=thickness,
            lineType=cv2.LINE_AA,
            shift=SHIFT,
        )

    def _fill(self, points_m: Float64, colour: Colour) -> None:
        cv2.fillPoly(self.canvas, [self.pixels(points_m)], colour, cv2.LINE_AA, SHIFT)

    def _road(self) -> None:
        road = self.world.road
        for polygon in road.surfaces_m:
            self._fill(polygon, COLOURS['road'])
        for marking in road.markings:
            colour = PAINT['yellow' if marking.kind.startswith('yellow') else 'white']
            if marking.kind in ('zebra', 'arrow'):
                self._fill(marking.points_m, colour)
            elif marking.kind.endswith('dashed'):
                # Points are 1 m apart: 3 m of paint, 3 m without.
                for first in range(0, len(marking.points_m) - 1, 6):
                    self._line(marking.points_m[first : first + 4], colour, 1)
            else:
                self._line(marking.points_m, colour, 3 if marking.kind == 'stop' else 1)

    def _routes(self) -> None:
        world = self.world
        ahead = world.route.window(world.route_s_m, world.goal_s_m - world.route_s_m)
        below = self.canvas.copy()
        self._line(ahead, COLOURS['route'], max(3, round(1.6 * self.scale)))
        self.canvas[:] = cv2.addWeighted(self.canvas, 0.75, below, 0.25, 0.0)
        # The reference path past an obstacle, where it leaves the route.
        beside = np.abs(world.detour_offsets_m) > BESIDE_M
        for first in range(0, len(beside) - DASH_POINTS, 2 * DASH_POINTS):
            if beside[first]:
                self._line(world.detour_points_m[first : first + DASH_POINTS], COLOURS['route'], 2)
        self._across(world.goal_s_m, (255, 255, 255))
        self._name('goal', np.array(world.route.pose(world.goal_s_m)[:2]))

    def _across(self, s_m: float, colour: Colour) -> None:
        """A bar across the ego's lane."""
        half = self.world.scene.layout.lane_width_m / 2
        ends = [self.world.route.pose(s_m, side)[:2] for side in (-half, half)]
        self._line(np.array(ends), colour, max(3, round(0.6 * self.scale)))

    def _signals(self) -> None:
        for light in self.world.lights:
            self._across(light.line_s_m, LIGHTS[light.colour])
            self._post(light.pole_pose, LIGHTS[light.colour])
        for sign in self.world.stop_signs:
            self._across(sign.line_s_m, STOP)
            self._post(sign.pole_pose, STOP)

    def _post(self, pose: tuple[float, float, float], colour: Colour) -> None:
        x, y = (self.pixels(np.array([pose[:2]]))[0] >> SHIFT).tolist()
        cv2.circle(self.canvas, (x, y), 6, colour, -1, cv2.LINE_AA)
        cv2.circle(self.canvas, (x, y), 6, DARK, 1, cv2.LINE_AA)

    def _way(self, actor: Actor) -> None:
        """Where a moving actor is heading, as an arrow."""
        if isinstance(actor, PathVehicle):
            speed = max(actor.speed, actor.target_speed)
            length = min(max(PATH_MIN_M, speed * PATH_SECONDS), PATH_MAX_M)
            stations = np.arange(actor.s_m, min(actor.s_m + length, actor.path.length_m), 1.0)
            points = np.array([actor.path.pose(float(s), actor.lateral_m)[:2] for s in stations])
        elif isinstance(actor, Walker):
            step = actor.left_to_walk_m * np.array([math.cos(actor.heading), math.sin(actor.heading)])
            points = np.array([actor.position, actor.position + step])
        else:
            return
        if len(points) < 2:
            return
        self._line(points, colour_of(actor.kind), 1)
        tip, along = points[-1], points[-1] - points[-2]
        along = along / max(float(np.hypot(*along)), 1e-6) * 7.0 / self.scale
        aside = np.array([-along[1], along[0]]) * 0.5
        self._fill(np.array([tip, tip - along + aside, tip - along - aside]), colour_of(actor.kind))

    def _box(self, actor: Actor, colour: Colour, *, filled: bool = True) -> None:
        x, y = actor.position
        # A minimum size, because cones and walkers would be two pixels wide.
        smallest = 6.0 / self.scale
        box = corners_m(float(x), float(y), actor.heading, max(actor.LENGTH, smallest), max(actor.WIDTH, smallest))
        if filled:
            self._fill(box, colour)
        edge = DARK if filled else colour
        cv2.polylines(
            self.canvas, [self.pixels(box)], isClosed=True, color=edge, thickness=1, lineType=cv2.LINE_AA, shift=SHIFT
        )

    def _name(self, words: str, place_m: Float64) -> None:
        """A label near a place, off the road where possible; left out where it would cover another label."""
        x, y = (self.pixels(place_m[None])[0] >> SHIFT).tolist()
        (wide, high), _ = cv2.getTextSize(words, cv2.FONT_HERSHEY_SIMPLEX, LABEL_SIZE, 1)
        found: list[tuple[float, tuple[int, int, int, int]]] = []
        for rise, left in product((12, 26, 40, 54), (x - wide // 2, x + 10, x - 10 - wide)):
            for base in (y - rise, y + rise + high):
                box = (left - 2, base - high - 2, left + wide + 2, base + 3)
                inside = box[0] >= 0 and box[1] >= 0 and box[2] < self.canvas.shape[1] and box[3] < self.height
                if inside and not any(_overlap(box, other) for other in self.labels):
                    below = self.canvas[box[1] : box[3], box[0] : box[2]]
                    covered = float((below != GROUND).any(axis=2).mean())
                    found.append((covered + COST_PER_PX * rise, box))
        if found:
            box = min(found)[1]
            self.labels.append(box)
            cv2.rectangle(self.canvas, box[:2], box[2:], PAPER, -1)
            text(self.canvas, words, (box[0] + 2, box[3] - 3), LABEL_SIZE, DARK)

    def _legend(self) -> None:
        """Kinds with their numbers, signals, and a scale bar, below the scene."""
        cv2.rectangle(self.canvas, (0, self.height), (self.canvas.shape[1], self.height + LEGEND_PX), PAPER, -1)
        counts = Counter(actor.kind for actor in (*self.world.actors, *self.later))
        entries: list[tuple[str, Colour]] = [('ego', COLOURS['ego']), ('route', COLOURS['route'])]
        entries += [(f'{kind.replace("_", " ")} x{n}', colour_of(kind)) for kind, n in sorted(counts.items())]
        entries += [(f'{c} light', LIGHTS[c]) for c in dict.fromkeys(light.colour for light in self.world.lights)]
        entries += [('stop sign', STOP)] if self.world.stop_signs else []
        x, base = 12, self.height + 20
        for words, colour in entries:
            cv2.rectangle(self.canvas, (x, base - 10), (x + 12, base + 2), colour, -1)
            cv2.rectangle(self.canvas, (x, base - 10), (x + 12, base + 2), DARK, 1)
            text(self.canvas, words, (x + 18, base), 0.42, DARK)
            x += 18 + cv2.getTextSize(words, cv2.FONT_HERSHEY_SIMPLEX, 0.42, 1)[0][0] + 18
        bar_m = LONG_BAR_M if self.scale < LONG_BAR_BELOW else SCALE_BAR_M
        wide = round(bar_m * self.scale)
        right = self.canvas.shape[1] - 12
        cv2.line(self.canvas, (right - wide, base - 3), (right, base - 3), DARK, 2)
        text(self.canvas, f'{bar_m} m', (right - wide - 46, base), 0.42, DARK)


def _overlap(a: tuple[int, int, int, int], b: tuple[int, int, int, int]) -> bool:
    return a[0] < b[2] and b[0] < a[2] and a[1] < b[3] and b[1] < a[3]
