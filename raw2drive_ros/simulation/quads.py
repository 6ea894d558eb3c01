"""The projection of quads into all cameras of a rig, from far to near: painter and id buffer share it."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from raw2drive_ros.contracts.public import CameraCalibration, Float64
from raw2drive_ros.simulation.things import Things

NEAR_M = 0.15
# Quads of fewer pixels are left out.
LEAST_PX = 0.35
SHIFT = 4
# Limit of fixed-point coordinates, which have to fit into 32 bits.
REACH = 4000.0 * 2**SHIFT

Ints = NDArray[np.int64]


@dataclass(slots=True)
class Drawing:
    """Polygons in the order in which they are drawn: camera by camera, and from far to near.

    camera, quad: (K,) indices into the rig and into `Things`. polygons: K arrays of fixed-point corners. low, high:
    (K, 2) extent in pixels (column, row); the whole image where a quad reaches behind the camera.
    """

    camera: Ints
    quad: Ints
    polygons: list[NDArray[np.int32]]
    low: Float64
    high: Float64


class QuadProjector:
    """Pinhole cameras of one image size. scale: rendered pixels per image pixel, along each axis."""

    def __init__(self, cameras: tuple[CameraCalibration, ...], scale: int) -> None:
        if any((c.width, c.height) != (cameras[0].width, cameras[0].height) for c in cameras):
            raise ValueError('QuadProjector: the cameras of a rig have one image size')
        self.scale = scale
        self.width, self.height = cameras[0].width * scale, cameras[0].height * scale
        self.focal = np.array([[c.intrinsics[0, 0], c.intrinsics[1, 1]] for c in cameras]) * scale
        self.centre = np.array([[c.intrinsics[0, 2], c.intrinsics[1, 2]] for c in cameras]) * scale
        # Cosine and sine of half the horizontal field of view.
        half = np.arctan2(np.maximum(self.centre[:, 0], self.width - self.centre[:, 0]), self.focal[:, 0])
        self.edge = np.cos(half)[:, None], np.sin(half)[:, None]
        self.mount(cameras)

    def mount(self, cameras: tuple[CameraCalibration, ...]) -> None:
        """Put the cameras where they actually are."""
        self.rotations = np.array([c.base_from_camera[:3, :3] for c in cameras])
        self.positions = np.array([c.base_from_camera[:3, 3] for c in cameras])
        # From the ego's frame, relative to the camera, to (column x depth, row x depth, depth).
        self.projections = self.rotations.copy()
        self.projections[:, :, :2] *= self.focal[:, None]
        self.projections[:, :, :2] += self.rotations[:, :, 2:] * self.centre[:, None]

    def project(self, things: Things) -> Drawing | None:
        """The polygons that face a camera and lie within its image; None if there are none."""
        camera, quad = self._facing(things)
        if not len(quad):
            return None
        corners = things.corners_m[quad]
        # (quad, corner, axis): column and row times depth, and depth.
        seen = np.empty_like(corners)
        bounds = np.searchsorted(camera, np.arange(len(self.rotations) + 1)).tolist()
        for index, (begin, end) in enumerate(pairwise(bounds)):
            if begin < end:
                part = corners[begin:end].reshape(-1, 3) - self.positions[index]
                np.matmul(part, self.projections[index], out=seen[begin:end].reshape(-1, 3))
        depth = seen[..., 2]
        pixels = seen[..., :2] / np.maximum(depth, NEAR_M)[..., None]
        low, high = _least(pixels), -_least(-pixels)
        inside = ((high > 0.0) & (low < (self.width, self.height))).all(axis=1)
        extent = high - low
        large = extent[:, 0] * extent[:, 1] > LEAST_PX * self.scale * self.scale
        nearest = _least(depth)
        crossing = (nearest <= NEAR_M) & (-_least(-depth) > NEAR_M)
        drawn = np.flatnonzero(((nearest > NEAR_M) & inside & large) | crossing)
        polygons = list(_fixed(pixels[drawn]))
        low, high = low[drawn], high[drawn]
        for i in np.flatnonzero(crossing[drawn]).tolist():
            polygons[i] = _fixed(_clip_near(seen[drawn[i]]))
            low[i], high[i] = 0.0, (self.width, self.height)
        return Drawing(camera[drawn], quad[drawn], polygons, low, high)

    def _facing(self, things: Things) -> tuple[Ints, Ints]:
        """(camera, quad) indices of all quads that face a camera and belong to a thing within its field of view."""
        centre = things.place_m - self.positions[:, None, :2]
        depth = np.einsum('cnk,ck->cn', centre, self.rotations[:, :2, 2])
        across = np.abs(np.einsum('cnk,ck->cn', centre, self.rotations[:, :2, 0]))
        cos, sin = self.edge
        camera, thing = np.nonzero((across * cos - depth * sin < things.radius_m) & (depth > -things.radius_m))
        many = things.count[thing]
        ends = np.cumsum(many)
        if not len(ends):
            return camera, camera
        quad = np.arange(ends[-1]) + np.repeat(things.first[thing] - (ends - many), many)
        camera = np.repeat(camera, many)
        to_quad = things.corners_m[quad, 0] - self.positions[camera]
        facing = np.einsum('qk,qk->q', things.normals[quad], to_quad) < 0.0
        return camera[facing], quad[facing]


def _least(values: Float64) -> Float64:
    """The minimum over the four corners, axis 1; faster than `min`."""
    least: Float64 = np.minimum(np.minimum(values[:, 0], values[:, 1]), np.minimum(values[:, 2], values[:, 3]))
    return least


def _clip_near(corners: Float64) -> Float64:
    """Pixel positions of a quad that crosses the near plane, clipped at it. corners: (4, 3), see `project`."""
    kept = []
    for i in range(4):
        a, b = corners[i], corners[(i + 1) % 4]
        if a[2] > NEAR_M:
            kept.append(a)
        if (a[2] > NEAR_M) != (b[2] > NEAR_M):
            part = (NEAR_M - a[2]) / (b[2] - a[2])
            kept.append(a + part * (b - a))
    points = np.array(kept)
    pixels: Float64 = points[:, :2] / points[:, 2:]
    return pixels


def _fixed(pixels: Float64) -> NDArray[np.int32]:
    """Pixel positions in OpenCV's fixed-point, centre-of-pixel convention."""
    fixed = np.minimum(np.maximum((pixels - 0.5) * 2**SHIFT, -REACH), REACH)
    return np.rint(fixed).astype(np.int32)
