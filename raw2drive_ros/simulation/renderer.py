"""Six pinhole cameras in numpy and OpenCV: textured ground, then boxes far to near, then a box filter.

All geometry of all cameras is one vectorised pass; only the visible quads reach a Python loop.
"""

from __future__ import annotations

import math

import cv2
import numpy as np
from numpy.typing import NDArray

from raw2drive_ros.contract import CameraCalibration, Float64, Image8
from raw2drive_ros.simulation.actors import PathVehicle
from raw2drive_ros.simulation.ground import GroundProjector, Rgb, paint_ground
from raw2drive_ros.simulation.shapes import Shape, actor_shape, light_shape, stop_sign_shape
from raw2drive_ros.simulation.world import World

SUPERSAMPLING = 2
NEAR_M = 0.15
VISIBLE_M = 80.0
HAZE_M = 180.0
BRAKE_LAMP_MPS2 = -1.0
SUN = np.array([0.35, 0.25, 0.9])
SKY_TOP, SKY_HORIZON = np.array([110.0, 155.0, 215.0]), np.array([200.0, 212.0, 222.0])
SHIFT = 4


class CameraRenderer:
    """Renders one world through a rig; `new_world` swaps the world and keeps the rig's tables."""

    def __init__(self, cameras: tuple[CameraCalibration, ...], supersampling: int = SUPERSAMPLING) -> None:
        self.cameras = cameras
        self.scale = supersampling
        self.ground = GroundProjector(cameras, supersampling)
        self.skies = [_sky(camera, supersampling) for camera in cameras]
        self.rotations = np.array([c.base_from_camera[:3, :3] for c in cameras])
        self.positions = np.array([c.base_from_camera[:3, 3] for c in cameras])
        self.focal = np.array([[c.intrinsics[0, 0], c.intrinsics[1, 1]] for c in cameras]) * supersampling
        self.centre = np.array([[c.intrinsics[0, 2], c.intrinsics[1, 2]] for c in cameras]) * supersampling
        self.pyramid: list[Rgb] = []
        self.origin: Float64 = np.zeros(2)
        self.world: World | None = None

    def new_world(self, world: World) -> None:
        self.world = world
        self.pyramid, self.origin = paint_ground(world.road)

    def render(self) -> dict[str, Image8]:
        """Camera name -> (H, W, 3) uint8 RGB of the world as it is now."""
        if self.world is None:
            raise RuntimeError('CameraRenderer.render: call new_world first')
        pose = self.world.ego_history[0]
        frames = [sky.copy() for sky in self.skies]
        self.ground.draw(frames, self.pyramid, self.origin, pose)
        self._draw_boxes(frames, pose)
        images = {}
        for camera, frame in zip(self.cameras, frames, strict=True):
            if self.scale > 1:
                size = (camera.width, camera.height)
                frame = cv2.resize(frame, size, interpolation=cv2.INTER_AREA)
            images[camera.name] = frame
        return images

    def _shapes(self, pose: tuple[float, float, float]) -> list[tuple[Shape, float, float, float]]:
        """(shape, x, y, yaw in the ego frame), far to near."""
        assert self.world is not None
        things: list[tuple[Shape, float, float, float]] = []
        for actor in self.world.actors:
            braking = isinstance(actor, PathVehicle) and (
                actor.command_acceleration < BRAKE_LAMP_MPS2 or (actor.speed < 0.05)
            )
            x, y = float(actor.position[0]), float(actor.position[1])
            things.append((actor_shape(actor.kind, actor.colour, braking), x, y, actor.heading))
        for light in self.world.lights:
            things.append((light_shape(light.colour), *light.pole_pose))
        for sign in self.world.stop_signs:
            things.append((stop_sign_shape(), *sign.pole_pose))
        ego_x, ego_y, ego_yaw = pose
        cos, sin = math.cos(ego_yaw), math.sin(ego_yaw)
        local = []
        for shape, x, y, yaw in things:
            dx, dy = x - ego_x, y - ego_y
            ahead, left = dx * cos + dy * sin, -dx * sin + dy * cos
            if ahead * ahead + left * left < VISIBLE_M**2:
                local.append((shape, ahead, left, yaw - ego_yaw))
        local.sort(key=lambda item: -(item[1] ** 2 + item[2] ** 2))
        return local

    def _draw_boxes(self, frames: list[Rgb], pose: tuple[float, float, float]) -> None:
        things = self._shapes(pose)
        if not things:
            return
        corners, normals, colours = [], [], []
        for shape, x, y, yaw in things:
            cos, sin = math.cos(yaw), math.sin(yaw)
            turn = np.array([[cos, sin, 0.0], [-sin, cos, 0.0], [0.0, 0.0, 1.0]])
            corners.append(shape.corners_m @ turn + (x, y, 0.0))
            rotated = shape.normals @ turn
            light = np.where(shape.emissive, 1.0, 0.55 + 0.45 * np.clip(rotated @ SUN, 0.0, 1.0))
            haze = 1.0 - math.exp(-math.hypot(x, y) / HAZE_M)
            colours.append((shape.colours * light[:, None]) * (1 - haze) + SKY_HORIZON * haze)
            normals.append(rotated)
        points, facing, paint = np.concatenate(corners), np.concatenate(normals), np.concatenate(colours)
        # (camera, quad, corner, axis) in optical frames.
        seen = np.einsum('cji,cqkj->cqki', self.rotations, points[None] - self.positions[:, None, None])
        towards = np.einsum('qj,cqj->cq', facing, points[None, :, 0] - self.positions[:, None]) < 0
        depth = seen[..., 2]
        in_front = depth.min(axis=2) > NEAR_M
        crossing = ~in_front & (depth.max(axis=2) > NEAR_M)
        safe = np.maximum(depth, NEAR_M)
        pixels = seen[..., :2] / safe[..., None] * self.focal[:, None, None] + self.centre[:, None, None]
        low, high = pixels.min(axis=2), pixels.max(axis=2)
        for index, (camera, frame) in enumerate(zip(self.cameras, frames, strict=True)):
            size = np.array([camera.width, camera.height]) * self.scale
            inside = (high[index] > 0).all(axis=1) & (low[index] < size).all(axis=1)
            for quad in np.flatnonzero(towards[index] & ((in_front[index] & inside) | crossing[index])):
                polygon = pixels[index, quad]
                if crossing[index, quad]:
                    polygon = self._clip_near(seen[index, quad], index)
                _fill(frame, polygon, paint[quad])

    def _clip_near(self, corners: Float64, camera: int) -> Float64:
        """Pixels of a quad that crosses the near plane, cut at the plane."""
        kept = []
        for i in range(4):
            a, b = corners[i], corners[(i + 1) % 4]
            if a[2] > NEAR_M:
                kept.append(a)
            if (a[2] > NEAR_M) != (b[2] > NEAR_M):
                part = (NEAR_M - a[2]) / (b[2] - a[2])
                kept.append(a + part * (b - a))
        points = np.array(kept)
        return points[:, :2] / points[:, 2:] * self.focal[camera] + self.centre[camera]


def _fill(frame: Rgb, polygon: Float64, colour: Float64) -> None:
    fixed = np.round(np.clip(polygon - 0.5, -4000, 4000) * 2**SHIFT).astype(np.int32)
    cv2.fillConvexPoly(frame, fixed, colour.tolist(), shift=SHIFT)


def _sky(camera: CameraCalibration, scale: int) -> NDArray[np.uint8]:
    """A vertical gradient down to the horizon, grass below it (the ground is drawn over most of it)."""
    height, width = camera.height * scale, camera.width * scale
    v = (np.arange(height) + 0.5) / scale
    rise = (camera.intrinsics[1, 2] - v) / camera.intrinsics[1, 1]
    part = np.clip(rise / 0.6, 0.0, 1.0)[:, None]
    column = SKY_HORIZON * (1 - part) + SKY_TOP * part
    column[rise < 0] = (86, 110, 62)
    return np.repeat(column[:, None], width, axis=1).astype(np.uint8)
