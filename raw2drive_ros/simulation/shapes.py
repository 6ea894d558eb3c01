"""Parts of low-polygon models: coloured quads, and the boxes, frusta and plates that bodies are made of.

A model is a list of quads in the frame of its thing (x ahead, y left, z up). Quads are drawn in the order of the list,
so later ones (lamps, windows) cover earlier ones.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from raw2drive_ros.contracts.public import Float64

Span = tuple[float, float]
Colour = tuple[float, ...]
Point = tuple[float, float, float]
# Rows of a quad's vectors: four corners, and the normal. Columns of its paint: RGB, emissive, counted.
CORNERS, NORMAL = slice(0, 4), 4
COLOUR, EMISSIVE, COUNTED = slice(0, 3), 3, 4


class Quad(NamedTuple):
    """corners: four points, counter-clockwise as seen from the side that shows. colour: RGB, 0..255. emissive: not
    affected by the light. counted: its pixels count for the visibility of the thing (a car's shadow does not)."""

    corners: Sequence[Point]
    colour: Colour
    emissive: bool = False
    counted: bool = True


@dataclass(frozen=True, eq=False)
class Shape:
    """vectors: (Q, 5, 3) corners and normals, paint: (Q, 5) of the quads, see `CORNERS` and so on. radius_m: of the
    circle around the origin that encloses the shape, seen from above."""

    vectors: Float64
    paint: Float64
    radius_m: float

    @property
    def corners_m(self) -> Float64:
        """(Q, 4, 3)."""
        return self.vectors[:, CORNERS]

    @property
    def normals(self) -> Float64:
        """(Q, 3) unit vectors."""
        return self.vectors[:, NORMAL]


def shape_of(quads: Iterable[Quad]) -> Shape:
    """The packed form of a list of quads."""
    quads = list(quads)
    corners = np.array([quad.corners for quad in quads], np.float64)
    # By the diagonals, so that two corners may coincide (triangles).
    normals = np.cross(corners[:, 2] - corners[:, 0], corners[:, 3] - corners[:, 1])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    vectors = np.concatenate([corners, normals[:, None]], axis=1)
    paint = np.array([(*quad.colour[:3], quad.emissive, quad.counted) for quad in quads], np.float64)
    return Shape(vectors, paint, float(np.hypot(corners[..., 0], corners[..., 1]).max()))


def box(x: Span, y: Span, z: Span, colour: Colour, *, emissive: bool = False) -> list[Quad]:
    """A box without a bottom: front, back, left, right, top."""
    return frustum(x, x, y, y, z, colour, colour, emissive=emissive)


def frustum(
    x: Span, x_top: Span, y: Span, y_top: Span, z: Span, colour: Colour, top_colour: Colour, *, emissive: bool = False
) -> list[Quad]:
    """A box whose top is another rectangle than its base: front, back, left, right, top."""
    (x0, x1), (y0, y1), (z0, z1), (u0, u1), (v0, v1) = x, y, z, x_top, y_top
    return [
        Quad([(x1, y0, z0), (x1, y1, z0), (u1, v1, z1), (u1, v0, z1)], colour, emissive),
        Quad([(x0, y1, z0), (x0, y0, z0), (u0, v0, z1), (u0, v1, z1)], colour, emissive),
        Quad([(x1, y1, z0), (x0, y1, z0), (u0, v1, z1), (u1, v1, z1)], colour, emissive),
        Quad([(x0, y0, z0), (x1, y0, z0), (u1, v0, z1), (u0, v0, z1)], colour, emissive),
        Quad([(u1, v0, z1), (u1, v1, z1), (u0, v1, z1), (u0, v0, z1)], top_colour, emissive),
    ]


def plate(x: float, y: Span, z: Span, colour: Colour, *, front: bool, emissive: bool = False) -> Quad:
    """A small upright quad that faces forward or backward."""
    y0, y1 = y if front else y[::-1]
    return Quad([(x, y0, z[0]), (x, y1, z[0]), (x, y1, z[1]), (x, y0, z[1])], colour, emissive)


def side_plates(x: Span, half_w: float, z: Span, colour: Colour, *, emissive: bool = False) -> tuple[Quad, Quad]:
    """One quad that faces left, and one that faces right."""
    (x0, x1), (z0, z1), y = x, z, half_w
    return (
        Quad([(x1, y, z0), (x0, y, z0), (x0, y, z1), (x1, y, z1)], colour, emissive),
        Quad([(x0, -y, z0), (x1, -y, z0), (x1, -y, z1), (x0, -y, z1)], colour, emissive),
    )


def floor(x: Span, y: Span, z: float, colour: Colour, *, counted: bool = True) -> Quad:
    """A quad that faces up."""
    return Quad([(x[1], y[0], z), (x[1], y[1], z), (x[0], y[1], z), (x[0], y[0], z)], colour, counted=counted)
