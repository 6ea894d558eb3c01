"""Low-polygon bodies: each kind of thing as a list of coloured quads in its own frame.

A quad list is drawn in order, so that later quads (lamps, windows) lie over earlier ones.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np

from raw2drive_ros.contract import Float64
from raw2drive_ros.simulation.actors import SIZES_M

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
    ],
    np.float64,
)
GLASS = (35.0, 45.0, 60.0)
BRAKE_LIT, BRAKE_DARK = (255.0, 30.0, 20.0), (110.0, 15.0, 15.0)
HEADLAMP = (235.0, 235.0, 210.0)
LIGHT_COLOURS = {'red': (255.0, 40.0, 30.0), 'yellow': (255.0, 200.0, 30.0), 'green': (40.0, 255.0, 90.0)}
DARK_LENS = (45.0, 45.0, 40.0)


@dataclass(frozen=True, slots=True)
class Shape:
    """corners_m: (Q, 4, 3). colours: (Q, 3) RGB 0..255. normals: (Q, 3). emissive: (Q,) bool, not shaded."""

    corners_m: Float64
    colours: Float64
    normals: Float64
    emissive: np.ndarray


Quad = tuple[list[tuple[float, float, float]], tuple[float, ...], bool]


def _box(
    x: tuple[float, float], y: tuple[float, float], z: tuple[float, float], colour: tuple[float, ...]
) -> list[Quad]:
    """Front, back, left, right, top."""
    (x0, x1), (y0, y1), (z0, z1) = x, y, z
    return [
        ([(x1, y0, z0), (x1, y1, z0), (x1, y1, z1), (x1, y0, z1)], colour, False),
        ([(x0, y1, z0), (x0, y0, z0), (x0, y0, z1), (x0, y1, z1)], colour, False),
        ([(x1, y1, z0), (x0, y1, z0), (x0, y1, z1), (x1, y1, z1)], colour, False),
        ([(x0, y0, z0), (x1, y0, z0), (x1, y0, z1), (x0, y0, z1)], colour, False),
        ([(x1, y0, z1), (x1, y1, z1), (x0, y1, z1), (x0, y0, z1)], colour, False),
    ]


def _plate(x: float, y: tuple[float, float], z: tuple[float, float], colour: tuple[float, ...], front: bool) -> Quad:
    """A small upright quad that faces forward or backward and shines by itself."""
    y0, y1 = y if front else y[::-1]
    return ([(x, y0, z[0]), (x, y1, z[0]), (x, y1, z[1]), (x, y0, z[1])], colour, True)


def _shape(quads: list[Quad]) -> Shape:
    corners = np.array([q[0] for q in quads], np.float64)
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 1])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    return Shape(corners, np.array([q[1] for q in quads], np.float64), normals, np.array([q[2] for q in quads]))


@cache
def actor_shape(kind: str, colour: int, braking: bool) -> Shape:
    """The body of an actor kind; `colour` indexes `PALETTE`; `braking` lights the brake lamps."""
    length, width, height = SIZES_M[kind]
    half_l, half_w = length / 2, width / 2
    paint = tuple(PALETTE[colour % len(PALETTE)])
    if kind in ('car', 'parked', 'van', 'parked_van', 'emergency', 'parked_emergency'):
        tall = kind not in ('car', 'parked')
        if kind.endswith('emergency'):
            paint = (240.0, 240.0, 235.0)
        waist = height * (0.75 if tall else 0.6)
        quads = _box((-half_l, half_l), (-half_w, half_w), (0.25, waist), paint)
        cabin = (-half_l * 0.98, half_l * 0.55) if tall else (-half_l * 0.75, half_l * 0.35)
        quads += _box(cabin, (-half_w * 0.88, half_w * 0.88), (waist, height), paint if tall else GLASS)
        lamp = BRAKE_LIT if braking else BRAKE_DARK
        lamps_z = (waist - 0.35, waist - 0.08)
        for side in (-1, 1):
            y = sorted((side * half_w * 0.55, side * half_w * 0.98))
            quads.append(_plate(-half_l - 0.02, (y[0], y[1]), lamps_z, lamp, front=False))
            quads.append(_plate(half_l + 0.02, (y[0], y[1]), lamps_z, HEADLAMP, front=True))
        if kind.endswith('emergency'):
            quads += _box((-0.3, 0.3), (-half_w * 0.8, 0.0), (height, height + 0.25), (20.0, 60.0, 255.0))
            quads += _box((-0.3, 0.3), (0.0, half_w * 0.8), (height, height + 0.25), (255.0, 30.0, 30.0))
            quads += _box((-half_l, half_l), (-half_w - 0.01, half_w + 0.01), (0.8, 1.1), (210.0, 40.0, 30.0))
        return _shape(quads)
    if kind == 'walker':
        trousers = (50.0, 50.0, 80.0)
        quads = _box((-0.12, 0.12), (-0.2, 0.2), (0.0, 0.85), trousers)
        quads += _box((-0.16, 0.16), (-0.28, 0.28), (0.85, 1.45), paint)
        quads += _box((-0.12, 0.12), (-0.12, 0.12), (1.45, 1.75), (205.0, 160.0, 130.0))
        return _shape(quads)
    if kind == 'cyclist':
        quads = _box((-0.9, 0.9), (-0.05, 0.05), (0.0, 0.65), (30.0, 30.0, 30.0))
        quads += _box((-0.3, 0.2), (-0.22, 0.22), (0.65, 1.4), paint)
        quads += _box((0.0, 0.25), (-0.12, 0.12), (1.4, 1.7), (230.0, 230.0, 90.0))
        return _shape(quads)
    if kind == 'cone':
        quads = _box((-0.22, 0.22), (-0.22, 0.22), (0.0, 0.1), (40.0, 40.0, 40.0))
        quads += _box((-0.14, 0.14), (-0.14, 0.14), (0.1, 0.5), (255.0, 110.0, 20.0))
        quads += _box((-0.07, 0.07), (-0.07, 0.07), (0.5, 0.8), (250.0, 250.0, 250.0))
        return _shape(quads)
    if kind == 'door':
        return _shape(_box((-half_l, half_l), (-half_w, half_w), (0.3, height), paint))
    if kind == 'barrier':
        quads = _box((-half_l, half_l), (-half_w, half_w), (0.0, 0.6), (230.0, 225.0, 220.0))
        quads += _box((-half_l, half_l), (-half_w, half_w), (0.6, height), (220.0, 60.0, 30.0))
        return _shape(quads)
    raise KeyError(f'no shape for kind {kind!r}')


@cache
def light_shape(colour: str) -> Shape:
    """A traffic light on its pole, facing +x, lens centres at 3.0, 3.4 and 3.8 m."""
    quads = _box((-0.08, 0.08), (-0.08, 0.08), (0.0, 2.7), (70.0, 70.0, 70.0))
    quads += _box((-0.15, 0.15), (-0.35, 0.35), (2.7, 4.1), (25.0, 25.0, 25.0))
    for i, name in enumerate(('green', 'yellow', 'red')):
        lens = LIGHT_COLOURS[name] if name == colour else DARK_LENS
        z = 2.8 + 0.4 * i
        quads.append(_plate(0.17, (-0.25, 0.25), (z, z + 0.36), lens, front=True))
    return _shape(quads)


@cache
def stop_sign_shape() -> Shape:
    """A stop sign on its pole, facing +x: a red plate with a white band."""
    quads = _box((-0.05, 0.05), (-0.05, 0.05), (0.0, 1.7), (120.0, 120.0, 120.0))
    quads += _box((-0.03, 0.03), (-0.45, 0.45), (1.7, 2.6), (200.0, 20.0, 25.0))
    quads.append(_plate(0.05, (-0.36, 0.36), (2.05, 2.25), (250.0, 250.0, 250.0), front=True))
    return _shape(quads)
