"""Models of houses, trees, walls, hedges, hills and poles, built once per world in `map` and culled by distance.

Long items are made of segments, each drawn by its own distance, so that a car before one end of a wall and behind the
other is covered where it should be. Every segment has a near and a far form; the far one lacks windows and the like.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from raw2drive_ros.contracts.public import Float64
from raw2drive_ros.simulation.looks import PAINTS
from raw2drive_ros.simulation.shapes import Colour, Quad, Span, box, frustum, shape_of

SEGMENT_M, HILL_SEGMENT_M, STOREY_M, WINDOW_EVERY_M = 5.0, 10.0, 2.9, 2.6
# Scenery is drawn up to `FAR_M`, and with its details up to `NEAR_M`, from the middle of a square of `CELL_M`.
FAR_M, NEAR_M, CELL_M = 100.0, 40.0, 8.0
ROOFS = ((128.0, 58.0, 44.0), (96.0, 62.0, 50.0), (74.0, 76.0, 82.0), (110.0, 84.0, 66.0))
WINDOW, DOOR, TRUNK, POST = (58.0, 68.0, 82.0), (84.0, 58.0, 42.0), (92.0, 72.0, 54.0), (118.0, 118.0, 116.0)
# A window whose room is lit, by night.
WINDOW_LIT = (236.0, 196.0, 120.0)
LIT_SHARE = 0.3

Point2 = tuple[float, float]
Part = tuple[Point2, list[Quad], list[Quad]]


@dataclass(frozen=True, slots=True)
class PlacedQuads:
    """Quads of things, or of parts of them.

    vectors: (Q, 5, 3), paint: (Q, 5), see `shapes`. count: (N,) quads of each part. place_m: (N, 2). radius_m: (N,).
    """

    vectors: Float64
    paint: Float64
    count: NDArray[np.int64]
    place_m: Float64
    radius_m: Float64

    def __len__(self) -> int:
        return len(self.count)

    def chosen(self, rows: NDArray[np.bool_]) -> PlacedQuads:
        """Those parts for which `rows`, (N,), is true."""
        quads = np.repeat(rows, self.count)
        return PlacedQuads(
            self.vectors[quads], self.paint[quads], self.count[rows], self.place_m[rows], self.radius_m[rows]
        )

    def and_also(self, other: PlacedQuads) -> PlacedQuads:
        """These parts, followed by those of another."""
        return PlacedQuads(
            np.concatenate([self.vectors, other.vectors]),
            np.concatenate([self.paint, other.paint]),
            np.concatenate([self.count, other.count]),
            np.concatenate([self.place_m, other.place_m]),
            np.concatenate([self.radius_m, other.radius_m]),
        )


class Scenery:
    """The scenery of one world. night: some windows are lit."""

    def __init__(self, items: Iterable[Any], *, night: bool = False) -> None:
        parts = [_moved(item, part, night=night) for item in items for part in BUILDERS[item.kind](item)]
        self.near, self.far = (static_quads([(part[0], part[form]) for part in parts]) for form in (1, 2))
        self._cell: tuple[int, int] | None = None
        self._around = self.near

    def around(self, x_m: float, y_m: float) -> PlacedQuads:
        """What is drawn for an ego at this place of `map`; the same for all places of a cell of the grid."""
        cell = (math.floor(x_m / CELL_M), math.floor(y_m / CELL_M))
        if cell != self._cell:
            self._cell = cell
            middle = (np.array(cell) + 0.5) * CELL_M
            distance = np.hypot(*(self.near.place_m - middle).T)
            far = self.far.chosen((distance >= NEAR_M) & (distance < FAR_M))
            self._around = self.near.chosen(distance < NEAR_M).and_also(far)
        return self._around


def static_quads(parts: Sequence[tuple[Point2, list[Quad]]]) -> PlacedQuads:
    """(place, quads in `map`) of each part, packed."""
    if not parts:
        return PlacedQuads(np.zeros((0, 5, 3)), np.zeros((0, 5)), np.zeros(0, np.int64), np.zeros((0, 2)), np.zeros(0))
    places = np.array([place for place, _ in parts])
    count = np.array([len(quads) for _, quads in parts])
    shape = shape_of(quad for _, quads in parts for quad in quads)
    offsets = shape.corners_m[..., :2] - np.repeat(places, count, axis=0)[:, None]
    reach = np.hypot(offsets[..., 0], offsets[..., 1]).max(axis=1)
    return PlacedQuads(shape.vectors, shape.paint, count, places, np.maximum.reduceat(reach, np.cumsum(count) - count))


def _moved(item: Any, part: Part, *, night: bool) -> Part:
    """A part from the item's frame to `map`. By day no window is lit."""
    cos, sin = math.cos(item.yaw_rad), math.sin(item.yaw_rad)

    def there(x: float, y: float) -> Point2:
        return item.x_m + x * cos - y * sin, item.y_m + x * sin + y * cos

    def moved(quad: Quad) -> Quad:
        corners = [(*there(x, y), z) for x, y, z in quad.corners]
        dark = quad.emissive and not night
        return Quad(corners, WINDOW if dark else quad.colour, quad.emissive and night, counted=False)

    forms = [[moved(quad) for quad in form] for form in part[1:]]
    return there(*part[0]), forms[0], forms[1]


def _colour(item: Any) -> Colour:
    """RGB of an item, whose colour is RGB or an index into `looks.PAINTS`."""
    if isinstance(item.colour, int | np.integer):
        return tuple(float(part) for part in PAINTS[int(item.colour) % len(PAINTS)])
    return tuple(float(part) for part in item.colour[:3])


def _shaded(colour: Colour, by: float) -> Colour:
    return tuple(min(255.0, part * by) for part in colour)


def _pieces(length_m: float, longest_m: float) -> list[Span]:
    """A length around 0 in equal pieces."""
    count = max(1, math.ceil(length_m / longest_m))
    edges = np.linspace(-length_m / 2, length_m / 2, count + 1).tolist()
    return list(pairwise(edges))


def _wall(begin: Point2, end: Point2, z: Span, colour: Colour, *, emissive: bool = False) -> Quad:
    """An upright quad from `begin` to `end`, facing to the right of that way."""
    (x0, y0), (x1, y1) = begin, end
    return Quad([(x0, y0, z[0]), (x1, y1, z[0]), (x1, y1, z[1]), (x0, y0, z[1])], colour, emissive)


def _house(item: Any) -> list[Part]:
    """Walls in segments with windows, and a gabled or flat roof along the longer side."""
    half_l, half_w = item.length_m / 2, item.width_m / 2
    rng = np.random.default_rng(item.seed)
    colour = _colour(item)
    gabled = rng.random() < 0.7 and item.height_m < 12.0
    eaves = item.height_m * (0.68 if gabled else 1.0)
    corners = [(-half_l, -half_w), (half_l, -half_w), (half_l, half_w), (-half_l, half_w)]
    parts: list[Part] = []
    for side in range(4):
        a, b = corners[side], corners[(side + 1) % 4]
        length = math.dist(a, b)
        along = ((b[0] - a[0]) / length, (b[1] - a[1]) / length)
        out = (along[1] * 0.03, -along[0] * 0.03)

        def at(s: float, a: Point2 = a, along: Point2 = along, out: Point2 = (0.0, 0.0)) -> Point2:
            return a[0] + s * along[0] + out[0], a[1] + s * along[1] + out[1]

        for begin, end in _pieces(length, SEGMENT_M):
            begin, end = begin + length / 2, end + length / 2
            plain = [_wall(at(begin), at(end), (0.0, eaves), colour)]
            openings = [
                _wall(at(left, out=out), at(right, out=out), z, tone, emissive=lit)
                for (left, right), z, tone, lit in _openings((begin, end), eaves, rng)
            ]
            parts.append((at((begin + end) / 2), plain + openings, plain))
    roof = _gable(half_l, half_w, eaves, item.height_m, ROOFS[int(rng.integers(len(ROOFS)))], colour)
    if not gabled:
        roof = [Quad([(x, y, eaves) for x, y in corners], _shaded(colour, 0.7))]
    parts.append(((0.0, 0.0), roof, roof))
    return parts


def _openings(span: Span, height: float, rng: np.random.Generator) -> Iterable[tuple[Span, Span, Colour, bool]]:
    """(begin and end along the wall, bottom and top, colour, lit) of windows, and now and then of a door."""
    count = max(1, int((span[1] - span[0]) / WINDOW_EVERY_M))
    step = (span[1] - span[0]) / count
    for storey in range(max(1, int(height / STOREY_M))):
        for i in range(count):
            middle = span[0] + (i + 0.5) * step
            if storey == 0 and rng.random() < 0.2:
                yield (middle - 0.5, middle + 0.5), (0.0, 2.1), DOOR, False
                continue
            bottom = storey * STOREY_M + 0.95
            lit = bool(rng.random() < LIT_SHARE)
            yield (middle - 0.55, middle + 0.55), (bottom, bottom + 1.3), WINDOW_LIT if lit else WINDOW, lit


def _gable(half_l: float, half_w: float, eaves: float, top: float, roof: Colour, wall: Colour) -> list[Quad]:
    """Two slopes and two triangles; the ridge runs along the longer side."""
    if half_l < half_w:
        turned = _gable(half_w, half_l, eaves, top, roof, wall)
        return [quad._replace(corners=[(-y, x, z) for x, y, z in quad.corners]) for quad in turned]
    left = [(half_l, half_w, eaves), (-half_l, half_w, eaves), (-half_l, 0.0, top), (half_l, 0.0, top)]
    right = [(-half_l, -half_w, eaves), (half_l, -half_w, eaves), (half_l, 0.0, top), (-half_l, 0.0, top)]
    front = [(half_l, -half_w, eaves), (half_l, half_w, eaves), (half_l, 0.0, top), (half_l, 0.0, top)]
    back = [(-half_l, half_w, eaves), (-half_l, -half_w, eaves), (-half_l, 0.0, top), (-half_l, 0.0, top)]
    return [Quad(left, roof), Quad(right, roof), Quad(front, wall), Quad(back, wall)]


def _tree(item: Any) -> list[Part]:
    """A trunk, and a crown of two frusta: round, or pointed as of a conifer."""
    rng = np.random.default_rng(item.seed)
    crown = _shaded(_colour(item), float(rng.uniform(0.85, 1.12)))
    half, top = max(0.6, item.width_m / 2), item.height_m
    pointed = rng.random() < 0.3
    foot = top * (0.12 if pointed else 0.34)
    belly = foot + (top - foot) * (0.12 if pointed else 0.42)
    ends = 0.05 if pointed else 0.5 * half
    trunk = box((-0.18, 0.18), (-0.18, 0.18), (0.0, foot + 0.2), TRUNK)[:4]

    def square(size: float) -> Span:
        return -size, size

    low, wide, high = square(max(ends, 0.55 * half)), square(half), square(ends)
    lower = frustum(low, wide, low, wide, (foot, belly), _shaded(crown, 0.8), crown)[:4]
    upper = frustum(wide, high, wide, high, (belly, top), crown, crown)[:4]
    middle, narrow = square(0.85 * half), square(max(ends, 0.3 * half))
    plain = frustum(middle, narrow, middle, narrow, (foot, top), crown, crown)[:4]
    return [((0.0, 0.0), trunk + lower + upper, trunk[:4] + plain)]


def _barrier_of(colour_of: Callable[[Colour, float], Colour]) -> Callable[[Any], list[Part]]:
    """A builder of long boxes in segments, without the inner ends."""

    def build(item: Any) -> list[Part]:
        rng = np.random.default_rng(item.seed)
        half = item.width_m / 2
        pieces = _pieces(item.length_m, SEGMENT_M)
        parts: list[Part] = []
        for i, (begin, end) in enumerate(pieces):
            colour = colour_of(_colour(item), float(rng.uniform(-1.0, 1.0)))
            front, back, *sides = box((begin, end), (-half, half), (0.0, item.height_m), colour)
            quads = [*([back] if i == 0 else []), *([front] if i == len(pieces) - 1 else []), *sides]
            parts.append((((begin + end) / 2, 0.0), quads, quads))
        return parts

    return build


def _hill(item: Any) -> list[Part]:
    """A ridge with two slopes, whose crest rises and falls along its length."""
    rng = np.random.default_rng(item.seed)
    colour = _colour(item)
    half_l, half_w = item.length_m / 2, item.width_m / 2

    def crest(x: float) -> float:
        return float(item.height_m * math.cos(0.5 * math.pi * x / half_l) ** 0.7) if abs(x) < half_l - 1e-6 else 0.0

    parts: list[Part] = []
    for begin, end in _pieces(item.length_m, HILL_SEGMENT_M):
        z0, z1 = crest(begin), crest(end)
        tone = _shaded(colour, float(rng.uniform(0.92, 1.08)))
        right = Quad([(begin, -half_w, 0.0), (end, -half_w, 0.0), (end, 0.0, z1), (begin, 0.0, z0)], tone)
        left = Quad([(end, half_w, 0.0), (begin, half_w, 0.0), (begin, 0.0, z0), (end, 0.0, z1)], tone)
        parts.append((((begin + end) / 2, 0.0), [right, left], [right, left]))
    return parts


def _pole(item: Any) -> list[Part]:
    """A lamp post: a pole with an arm to its front."""
    half = min(0.12, max(0.05, item.width_m / 2))
    pole = box((-half, half), (-half, half), (0.0, item.height_m), POST)[:4]
    arm = box((0.0, 1.5), (-0.06, 0.06), (item.height_m - 0.15, item.height_m), POST)
    return [((0.0, 0.0), pole + arm, pole)]


BUILDERS: dict[str, Callable[[Any], list[Part]]] = {
    'house': _house,
    'tree': _tree,
    'wall': _barrier_of(lambda colour, _roll: colour),
    'hedge': _barrier_of(lambda colour, roll: _shaded(colour, 1.0 + 0.08 * roll)),
    'hill': _hill,
    'pole': _pole,
}
