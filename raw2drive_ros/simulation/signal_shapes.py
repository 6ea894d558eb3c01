"""Models of traffic lights and signs, facing +x, standing at the origin; see `shapes`.

Only what tells the driver something counts for their visibility: the face of a light and the plate of a sign, from
the front.
"""

from __future__ import annotations

import math
from functools import cache

from raw2drive_ros.simulation.shapes import Colour, Point, Quad, Shape, box, plate, shape_of

LIGHT_COLOURS = {'red': (255.0, 40.0, 30.0), 'yellow': (255.0, 200.0, 30.0), 'green': (40.0, 255.0, 90.0)}
# A lens that is not lit: its glass keeps a little of its colour.
DARK_LENSES = {'red': (62.0, 34.0, 30.0), 'yellow': (62.0, 54.0, 26.0), 'green': (28.0, 54.0, 36.0)}
POST, HOUSING, PLATE_BACK = (112.0, 114.0, 116.0), (25.0, 25.0, 25.0), (135.0, 137.0, 140.0)
SIGN_RED, SIGN_WHITE = (205.0, 20.0, 28.0), (248.0, 248.0, 248.0)
# Heights of the middles of signs, and half the widths across flats of the octagon and across the triangle's top.
SIGN_Z_M, OCTAGON_M, TRIANGLE_M = 2.15, 0.45, 0.5
# Strokes of the letters of STOP: (left, right, bottom, top) in units of a letter's width and height.
LETTERS = (
    ((0.0, 1.0, 0.8, 1.0), (0.0, 0.3, 0.5, 0.8), (0.0, 1.0, 0.4, 0.6), (0.7, 1.0, 0.2, 0.5), (0.0, 1.0, 0.0, 0.2)),
    ((0.0, 1.0, 0.8, 1.0), (0.35, 0.65, 0.0, 0.8)),
    ((0.0, 1.0, 0.8, 1.0), (0.0, 1.0, 0.0, 0.2), (0.0, 0.3, 0.0, 1.0), (0.7, 1.0, 0.0, 1.0)),
    ((0.0, 0.3, 0.0, 1.0), (0.0, 1.0, 0.8, 1.0), (0.0, 1.0, 0.4, 0.55), (0.7, 1.0, 0.4, 1.0)),
)
LETTER_M, LETTER_GAP_M, LETTER_HEIGHT_M = 0.13, 0.05, 0.28


@cache
def light_shape(colour: str) -> Shape:
    """A traffic light on its pole, lens centres at 3.0, 3.4 and 3.8 m. colour: of the lens that is lit, '' for none."""
    quads = _uncounted(box((-0.08, 0.08), (-0.08, 0.08), (0.0, 2.7), POST))
    front, *others = box((-0.15, 0.15), (-0.38, 0.38), (2.7, 4.1), HOUSING)
    quads += [*_uncounted(others), front]
    for i, name in enumerate(('green', 'yellow', 'red')):
        lit = name == colour
        z = 2.8 + 0.4 * i
        lens = LIGHT_COLOURS[name] if lit else DARK_LENSES[name]
        quads.append(plate(0.17, (-0.28, 0.28), (z, z + 0.38), lens, front=True, emissive=lit))
    return shape_of(quads)


@cache
def sign_shape(kind: str) -> Shape:
    """A sign on its pole. kind: stop or yield. Raises KeyError."""
    return shape_of(_uncounted(box((-0.04, 0.04), (-0.04, 0.04), (0.0, SIGN_Z_M), POST)) + PLATES[kind]())


def _stop_plate() -> list[Quad]:
    """A red octagon with a white rim and white letters."""
    quads = _octagon(-0.05, OCTAGON_M, PLATE_BACK, front=False)
    quads += _octagon(0.05, OCTAGON_M, SIGN_WHITE, front=True)
    quads += _octagon(0.06, OCTAGON_M * 0.92, SIGN_RED, front=True)
    width = 4 * LETTER_M + 3 * LETTER_GAP_M
    bottom = SIGN_Z_M - LETTER_HEIGHT_M / 2
    for i, strokes in enumerate(LETTERS):
        # A reader in front of the plate has +y on the right.
        begin = -width / 2 + i * (LETTER_M + LETTER_GAP_M)
        for left, right, low, high in strokes:
            across = (begin + left * LETTER_M, begin + right * LETTER_M)
            z = (bottom + low * LETTER_HEIGHT_M, bottom + high * LETTER_HEIGHT_M)
            quads.append(plate(0.07, across, z, SIGN_WHITE, front=True))
    return quads


def _octagon(x: float, half: float, colour: Colour, *, front: bool) -> list[Quad]:
    """A regular octagon as three quads. half: half its width across flats."""
    cut = half * math.tan(math.pi / 8)
    z = SIGN_Z_M
    rows = (
        ((-cut, z - half), (cut, z - half), (half, z - cut), (-half, z - cut)),
        ((-half, z - cut), (half, z - cut), (half, z + cut), (-half, z + cut)),
        ((-half, z + cut), (half, z + cut), (cut, z + half), (-cut, z + half)),
    )
    return [_upright(x, row, colour, front=front) for row in rows]


def _yield_plate() -> list[Quad]:
    """A white triangle with a red rim that points down."""
    quads = [_triangle(-0.05, TRIANGLE_M, PLATE_BACK, front=False)]
    quads.append(_triangle(0.05, TRIANGLE_M, SIGN_RED, front=True))
    quads.append(_triangle(0.06, TRIANGLE_M * 0.62, SIGN_WHITE, front=True))
    return quads


def _triangle(x: float, half: float, colour: Colour, *, front: bool) -> Quad:
    """An equilateral triangle around the sign's middle as a quad, two of whose corners coincide."""
    top, tip = SIGN_Z_M + half / math.sqrt(3.0), SIGN_Z_M - 2.0 * half / math.sqrt(3.0)
    return _upright(x, ((0.0, tip), (half, top), (-half, top), (-half, top)), colour, front=front)


def _upright(x: float, corners: tuple[tuple[float, float], ...], colour: Colour, *, front: bool) -> Quad:
    """A quad in the plane `x` through (y, z) points, which run counter-clockwise for a reader in front of it."""
    points: list[Point] = [(x, y, z) for y, z in corners]
    if front:
        return Quad(points, colour)
    return Quad(points[::-1], colour, counted=False)


def _uncounted(quads: list[Quad]) -> list[Quad]:
    return [quad._replace(counted=False) for quad in quads]


PLATES = {'stop': _stop_plate, 'yield': _yield_plate}
