"""Low-polygon models: the body of each kind of actor as a list of coloured quads, in the actor's frame.

Quads are drawn in the order of the list, so later ones (lamps, windows) cover earlier ones.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache, lru_cache

import numpy as np

from raw2drive_ros.contracts.public import Float64

PALETTE = np.array(
    [
        (178, 34, 34),
        (30, 70, 150),
        (225, 225, 225),
        (40, 40, 45),
        (120, 125, 130),
        (20, 100, 60),
        (200, 160, 40),
        (90, 50, 110),
        (175, 180, 188),
        (235, 120, 35),
        (110, 160, 205),
        (105, 70, 45),
        (190, 175, 145),
        (20, 45, 75),
    ],
    np.float64,
)
GLASS, TYRE, SHADE = (35.0, 45.0, 60.0), (22.0, 22.0, 24.0), (40.0, 40.0, 43.0)
SKIN, TROUSERS = (205.0, 160.0, 130.0), (50.0, 50.0, 80.0)
TAIL_COLOURS = {'off': (110.0, 15.0, 15.0), 'day': (110.0, 15.0, 15.0), 'night': (150.0, 12.0, 10.0)}
BRAKE_LIT, HEADLAMP, HEADLAMP_OFF = (255.0, 40.0, 25.0), (255.0, 252.0, 225.0), (170.0, 170.0, 165.0)
LIGHT_COLOURS = {'red': (255.0, 40.0, 30.0), 'yellow': (255.0, 200.0, 30.0), 'green': (40.0, 255.0, 90.0)}
DARK_LENS = (45.0, 45.0, 40.0)
# Flashing lights: (left, right) in either phase.
FLASH = (((20.0, 60.0, 255.0), (90.0, 15.0, 15.0)), ((10.0, 20.0, 90.0), (255.0, 30.0, 30.0)))
WHEEL_RADIUS_M, SKIRT_M = 0.33, 0.28


@dataclass(frozen=True, slots=True)
class Cabin:
    """The glazed upper part of a car. waist: height of its lower edge as a share of the car's height. foot, roof:
    (back, front) of its lower and upper edge as shares of half the car's length. bed: a loading bed behind it."""

    waist: float
    foot: tuple[float, float]
    roof: tuple[float, float]
    bed: bool = False


CABINS = {
    'sedan': Cabin(0.62, (-0.76, 0.42), (-0.45, 0.1)),
    'hatchback': Cabin(0.6, (-0.96, 0.46), (-0.76, 0.12)),
    'suv': Cabin(0.58, (-0.96, 0.5), (-0.88, 0.2)),
    'pickup': Cabin(0.56, (-0.16, 0.5), (-0.1, 0.2), bed=True),
}
# Actors without an explicit body.
CABINS |= {'car': CABINS['sedan'], 'parked': CABINS['sedan']}


@dataclass(frozen=True, slots=True, eq=False)
class Shape:
    """corners_m: (Q, 4, 3). colours: (Q, 3) RGB 0..255. normals: (Q, 3). emissive: (Q,) bool, not
    affected by the light. radius_m: of the circle around the origin that encloses the shape, seen from above."""

    corners_m: Float64
    colours: Float64
    normals: Float64
    emissive: np.ndarray
    radius_m: float


Span = tuple[float, float]
Colour = tuple[float, ...]
Quad = tuple[list[tuple[float, float, float]], Colour, bool]


def _box(x: Span, y: Span, z: Span, colour: Colour, *, emissive: bool = False) -> list[Quad]:
    """A box without a bottom: front, back, left, right, top."""
    return _frustum(x, x, y, y, z, colour, colour, emissive=emissive)


def _frustum(
    x: Span, x_top: Span, y: Span, y_top: Span, z: Span, colour: Colour, top_colour: Colour, *, emissive: bool = False
) -> list[Quad]:
    """A box whose top is another rectangle than its base: front, back, left, right, top."""
    (x0, x1), (y0, y1), (z0, z1), (u0, u1), (v0, v1) = x, y, z, x_top, y_top
    return [
        ([(x1, y0, z0), (x1, y1, z0), (u1, v1, z1), (u1, v0, z1)], colour, emissive),
        ([(x0, y1, z0), (x0, y0, z0), (u0, v0, z1), (u0, v1, z1)], colour, emissive),
        ([(x1, y1, z0), (x0, y1, z0), (u0, v1, z1), (u1, v1, z1)], colour, emissive),
        ([(x0, y0, z0), (x1, y0, z0), (u1, v0, z1), (u0, v0, z1)], colour, emissive),
        ([(u1, v0, z1), (u1, v1, z1), (u0, v1, z1), (u0, v0, z1)], top_colour, emissive),
    ]


def _plate(x: float, y: Span, z: Span, colour: Colour, *, front: bool, emissive: bool = False) -> Quad:
    """A small upright quad that faces forward or backward."""
    y0, y1 = y if front else y[::-1]
    return ([(x, y0, z[0]), (x, y1, z[0]), (x, y1, z[1]), (x, y0, z[1])], colour, emissive)


def _side_plates(x: Span, half_w: float, z: Span, colour: Colour) -> list[Quad]:
    """One quad that faces left, and one that faces right."""
    (x0, x1), (z0, z1), y = x, z, half_w
    return [
        ([(x1, y, z0), (x0, y, z0), (x0, y, z1), (x1, y, z1)], colour, False),
        ([(x0, -y, z0), (x1, -y, z0), (x1, -y, z1), (x0, -y, z1)], colour, False),
    ]


def _floor(x: Span, y: Span, z: float, colour: Colour) -> Quad:
    """A quad that faces up."""
    return ([(x[1], y[0], z), (x[1], y[1], z), (x[0], y[1], z), (x[0], y[0], z)], colour, False)


def _shape(quads: list[Quad]) -> Shape:
    corners = np.array([q[0] for q in quads], np.float64)
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 1])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    radius = float(np.hypot(corners[..., 0], corners[..., 1]).max())
    return Shape(corners, np.array([q[1] for q in quads], np.float64), normals, np.array([q[2] for q in quads]), radius)


@lru_cache(maxsize=8192)
def actor_shape(
    body: str, colour: int, size_m: tuple[float, float, float], lamps: str, phase: int, *, detailed: bool
) -> Shape:
    """A body of (length, width, height) `size_m`. colour: index into `PALETTE`. lamps: 'off', 'day', 'night' or
    'brake'. phase: 0 or 1, of flashing lights and of walking legs. detailed: with wheels, side windows and shadow."""
    length, width, height = size_m
    half_l, half_w = length / 2, width / 2
    paint = tuple(PALETTE[colour % len(PALETTE)])
    if body in CABINS:
        return _shape(_car(CABINS[body], half_l, half_w, height, paint, lamps, detailed=detailed))
    if body in ('van', 'parked_van'):
        return _shape(_van(half_l, half_w, height, paint, lamps, detailed=detailed))
    if body in ('emergency', 'parked_emergency'):
        return _shape(
            _van(half_l, half_w, height, (240.0, 240.0, 235.0), lamps, detailed=detailed)
            + _emergency(half_l, half_w, height, phase)
        )
    if body == 'walker':
        return _shape(_walker(paint, phase))
    if body == 'cyclist':
        return _shape(_cyclist(paint))
    if body == 'cone':
        quads = _box((-0.22, 0.22), (-0.22, 0.22), (0.0, 0.1), (40.0, 40.0, 40.0))
        quads += _box((-0.14, 0.14), (-0.14, 0.14), (0.1, 0.5), (255.0, 110.0, 20.0))
        quads += _box((-0.07, 0.07), (-0.07, 0.07), (0.5, 0.8), (250.0, 250.0, 250.0))
        return _shape(quads)
    if body == 'door':
        return _shape(_box((-half_l, half_l), (-half_w, half_w), (0.3, height), paint))
    if body == 'barrier':
        quads = _box((-half_l, half_l), (-half_w, half_w), (0.0, 0.6), (230.0, 225.0, 220.0))
        quads += _box((-half_l, half_l), (-half_w, half_w), (0.6, height), (220.0, 60.0, 30.0))
        return _shape(quads)
    raise KeyError(f'no shape for body {body!r}')


def _car(
    cabin: Cabin, half_l: float, half_w: float, height: float, paint: Colour, lamps: str, *, detailed: bool
) -> list[Quad]:
    waist = height * cabin.waist
    along, across = (-half_l, half_l), (-half_w, half_w)
    quads = _under(half_l, half_w) if detailed else []
    quads += _box(along, across, (SKIRT_M, waist), paint)
    if cabin.bed:
        quads.append(_floor((-half_l * 0.95, half_l * cabin.foot[0]), (-half_w * 0.85, half_w * 0.85), waist, SHADE))
    if detailed:
        quads += _wheels(half_l, half_w)
    foot, roof = ((half_l * back, half_l * front) for back, front in (cabin.foot, cabin.roof))
    narrow, narrower = (-half_w * 0.92, half_w * 0.92), (-half_w * 0.76, half_w * 0.76)
    quads += _frustum(foot, roof, narrow, narrower, (waist, height), GLASS, paint)
    quads += _lamps(half_l, half_w, (waist - 0.32, waist - 0.08), lamps)
    if lamps == 'brake':
        quads.append(
            _plate(foot[0] - 0.04, (-0.35, 0.35), (waist + 0.02, waist + 0.14), BRAKE_LIT, front=False, emissive=True)
        )
    return quads


def _van(half_l: float, half_w: float, height: float, paint: Colour, lamps: str, *, detailed: bool) -> list[Quad]:
    glass_z = (height * 0.55, height * 0.88)
    quads = _under(half_l, half_w) if detailed else []
    quads += _box((-half_l, half_l), (-half_w, half_w), (SKIRT_M, height), paint)
    quads.append(_plate(half_l + 0.01, (-half_w * 0.88, half_w * 0.88), glass_z, GLASS, front=True))
    quads.append(_plate(-half_l - 0.01, (-half_w * 0.75, half_w * 0.75), glass_z, GLASS, front=False))
    if detailed:
        quads += _side_plates((half_l * 0.45, half_l * 0.9), half_w + 0.01, glass_z, GLASS)
        quads += _wheels(half_l, half_w)
    quads += _lamps(half_l, half_w, (0.75, 1.05), lamps)
    if lamps == 'brake':
        quads.append(
            _plate(-half_l - 0.02, (-0.35, 0.35), (height - 0.2, height - 0.06), BRAKE_LIT, front=False, emissive=True)
        )
    return quads


def _under(half_l: float, half_w: float) -> list[Quad]:
    """The dark area below a car."""
    return [_floor((-half_l - 0.05, half_l + 0.05), (-half_w - 0.05, half_w + 0.05), 0.01, SHADE)]


def _wheels(half_l: float, half_w: float) -> list[Quad]:
    quads = []
    for x in (-half_l * 0.62, half_l * 0.62):
        along = (x - WHEEL_RADIUS_M, x + WHEEL_RADIUS_M)
        quads += _side_plates(along, half_w + 0.01, (0.0, 2 * WHEEL_RADIUS_M), TYRE)
    return quads


def _lamps(half_l: float, half_w: float, z: Span, lamps: str) -> list[Quad]:
    braking, off = lamps == 'brake', lamps == 'off'
    tail = BRAKE_LIT if braking else TAIL_COLOURS[lamps]
    quads = []
    for y in ((-half_w * 0.98, -half_w * 0.55), (half_w * 0.55, half_w * 0.98)):
        quads.append(_plate(-half_l - 0.02, y, z, tail, front=False, emissive=lamps in ('night', 'brake')))
        quads.append(_plate(half_l + 0.02, y, z, HEADLAMP_OFF if off else HEADLAMP, front=True, emissive=not off))
    return quads


def _emergency(half_l: float, half_w: float, height: float, phase: int) -> list[Quad]:
    """A stripe around the body, and two lights on the roof that flash alternately."""
    stripe = (210.0, 40.0, 30.0)
    quads = _side_plates((-half_l, half_l), half_w + 0.02, (1.1, 1.4), stripe)
    quads.append(_plate(-half_l - 0.02, (-half_w, half_w), (1.1, 1.3), stripe, front=False))
    left, right = FLASH[phase]
    quads += _box((-0.3, 0.3), (-half_w * 0.8, 0.0), (height, height + 0.25), right, emissive=True)
    quads += _box((-0.3, 0.3), (0.0, half_w * 0.8), (height, height + 0.25), left, emissive=True)
    return quads


def _walker(paint: Colour, phase: int) -> list[Quad]:
    stride = 0.16 if phase else -0.16
    quads = _box((stride - 0.1, stride + 0.1), (0.03, 0.19), (0.0, 0.85), TROUSERS)
    quads += _box((-stride - 0.1, -stride + 0.1), (-0.19, -0.03), (0.0, 0.85), TROUSERS)
    quads += _box((-0.16, 0.16), (-0.28, 0.28), (0.85, 1.45), paint)
    quads += _box((-0.12, 0.12), (-0.12, 0.12), (1.45, 1.75), SKIN)
    return quads


def _cyclist(paint: Colour) -> list[Quad]:
    quads = _box((-0.9, -0.25), (-0.04, 0.04), (0.0, 0.65), TYRE)
    quads += _box((0.25, 0.9), (-0.04, 0.04), (0.0, 0.65), TYRE)
    quads += _box((-0.2, 0.15), (-0.16, 0.16), (0.3, 0.9), TROUSERS)
    quads += _box((-0.3, 0.2), (-0.22, 0.22), (0.85, 1.4), paint)
    quads += _box((0.0, 0.25), (-0.12, 0.12), (1.4, 1.7), (230.0, 230.0, 90.0))
    return quads


@cache
def light_shape(colour: str) -> Shape:
    """A traffic light on its pole, facing +x, lens centres at 3.0, 3.4 and 3.8 m."""
    quads = _box((-0.08, 0.08), (-0.08, 0.08), (0.0, 2.7), (70.0, 70.0, 70.0))
    quads += _box((-0.15, 0.15), (-0.38, 0.38), (2.7, 4.1), (25.0, 25.0, 25.0))
    for i, name in enumerate(('green', 'yellow', 'red')):
        lit = name == colour
        z = 2.8 + 0.4 * i
        quads.append(
            _plate(
                0.17, (-0.28, 0.28), (z, z + 0.38), LIGHT_COLOURS[name] if lit else DARK_LENS, front=True, emissive=lit
            )
        )
    return _shape(quads)


@cache
def stop_sign_shape() -> Shape:
    """A stop sign on its pole, facing +x: a red plate with a white band."""
    quads = _box((-0.05, 0.05), (-0.05, 0.05), (0.0, 1.7), (120.0, 120.0, 120.0))
    quads += _box((-0.03, 0.03), (-0.45, 0.45), (1.7, 2.6), (200.0, 20.0, 25.0))
    quads.append(_plate(0.05, (-0.36, 0.36), (2.05, 2.25), (250.0, 250.0, 250.0), front=True))
    return _shape(quads)
