"""Six pinhole cameras in numpy and OpenCV: textured ground, then quads from far to near, a box filter, noise and rain.

Geometry is one vectorised pass over all cameras; only drawing the visible quads is a Python loop.
"""

from __future__ import annotations

import math

import cv2
import numpy as np
from numpy.typing import NDArray

from raw2drive_ros.contracts.public import CameraCalibration, Float64, Image8
from raw2drive_ros.simulation.actors import PathVehicle
from raw2drive_ros.simulation.ground import GroundProjector, Rgb, far_ground, paint_ground
from raw2drive_ros.simulation.shapes import Shape, actor_shape, light_shape, stop_sign_shape
from raw2drive_ros.simulation.variation import NO_VARIATION, ImageEffects, Variation
from raw2drive_ros.simulation.weather import CLEAR, WEATHERS, Weather
from raw2drive_ros.simulation.world import World

SUPERSAMPLING = 2
NEAR_M = 0.15
VISIBLE_M = 80.0
HAZE_M = 180.0
BRAKE_LAMP_MPS2 = -1.0
SUN_HEIGHT, SUN_ACROSS = 0.9, 0.43
# Light on a surface: ambient, and direct from the sun or, diffuse, from clouds (on the sides, and more on top).
AMBIENT, DIRECT, CLOUD_SIDE, CLOUD_ABOVE = 0.55, 0.45, 0.4, 0.4
# Lamps are visible through so many times as much fog as other surfaces.
LAMP_REACH = 3.0
# Cars that appear smaller than this many pixels per metre have no wheels; quads of fewer pixels are left out.
DETAIL_PX_PER_M, LEAST_PX = 3.3, 0.35
# Rate at which flashing lights and walking legs change.
PHASE_HZ = 4.0
SHIFT = 4
# Limit of fixed-point coordinates, which have to fit into 32 bits.
REACH = 4000.0 * 2**SHIFT


class CameraRenderer:
    """Renders a world through a rig of cameras of one image size; `new_world` sets the world and keeps the tables."""

    def __init__(self, cameras: tuple[CameraCalibration, ...], supersampling: int = SUPERSAMPLING) -> None:
        self.cameras = cameras
        self.scale = supersampling
        self.width, self.height = cameras[0].width * supersampling, cameras[0].height * supersampling
        if any((c.width, c.height) != (cameras[0].width, cameras[0].height) for c in cameras):
            raise ValueError('CameraRenderer: the cameras of a rig have one image size')
        self.frames: Rgb = np.zeros((len(cameras), self.height, self.width, 4), np.uint8)
        self.focal = np.array([[c.intrinsics[0, 0], c.intrinsics[1, 1]] for c in cameras]) * supersampling
        self.centre = np.array([[c.intrinsics[0, 2], c.intrinsics[1, 2]] for c in cameras]) * supersampling
        # Cosine and sine of half the horizontal field of view.
        half = np.arctan2(np.maximum(self.centre[:, 0], self.width - self.centre[:, 0]), self.focal[:, 0])
        self.edge = np.cos(half)[:, None], np.sin(half)[:, None]
        self.detail_m = float(self.focal.max()) / supersampling / DETAIL_PX_PER_M
        self.nominal_ground = GroundProjector(cameras, supersampling)
        self._mount(cameras)
        self.effects = ImageEffects(cameras[0].width, cameras[0].height * len(cameras))
        self.world: World | None = None

    def _mount(self, cameras: tuple[CameraCalibration, ...]) -> None:
        self.mounted = cameras
        self.ground = self.nominal_ground if cameras is self.cameras else GroundProjector(cameras, self.scale)
        self.rotations = np.array([c.base_from_camera[:3, :3] for c in cameras])
        self.positions = np.array([c.base_from_camera[:3, 3] for c in cameras])

    def new_world(
        self,
        world: World,
        weather: Weather = WEATHERS[CLEAR],
        variation: Variation = NO_VARIATION,
        rng: np.random.Generator | None = None,
    ) -> None:
        """Render `world` from now on. rng: for noise and rain in every frame; default: one with a fixed seed."""
        self.world, self.weather, self.variation = world, weather, variation
        mounted = variation.mounted(self.cameras)
        if mounted is not self.mounted:
            self._mount(mounted)
        self.air = variation.tone_mapped(np.array(weather.sky_horizon))
        self.painted = paint_ground(world.road, weather, variation)
        self.ground.light(weather, variation)
        self.skies = [
            _sky(camera, self.scale, rows, weather, variation)
            for camera, rows in zip(mounted, self.ground.first_rows, strict=True)
        ]
        self.effects.load(weather, variation, rng or np.random.default_rng(0))

    def render(self) -> dict[str, Image8]:
        """Camera name -> (H, W, 3) uint8 RGB of the world as it is now."""
        if self.world is None:
            raise RuntimeError('CameraRenderer.render: call new_world first')
        pose = self.world.ego_history[0]
        for frame, sky in zip(self.frames, self.skies, strict=True):
            frame[: len(sky)] = sky
        self.ground.draw(self.frames, self.painted, pose)
        self._draw_boxes(pose)
        stack = self.frames.reshape(-1, self.width, 4)
        if self.scale > 1:
            # All image heights are multiples of the box filter, so it never mixes two cameras.
            stack = cv2.resize(stack, (self.width // self.scale, len(stack) // self.scale), None, 0, 0, cv2.INTER_AREA)
        images = self.effects.apply(cv2.cvtColor(stack, cv2.COLOR_RGBA2RGB)).reshape(
            len(self.cameras), -1, self.width // self.scale, 3
        )
        return {camera.name: image for camera, image in zip(self.cameras, images, strict=True)}

    def _things(self, pose: tuple[float, float, float]) -> tuple[list[Shape], Float64]:
        """(shapes, (N, 3) x, y, yaw in the ego frame) of actors, lights and signs within sight, from far to near."""
        assert self.world is not None
        world = self.world
        actors, poses = world.history[0]
        posts = [(light_shape(light.colour), light.pole_pose) for light in world.lights]
        posts += [(stop_sign_shape(), sign.pole_pose) for sign in world.stop_signs]
        if posts:
            poses = np.concatenate([poses.reshape(-1, 3), [place for _, place in posts]])
        if not len(poses):
            return [], np.zeros((0, 3))
        cos, sin = math.cos(pose[2]), math.sin(pose[2])
        local = poses - pose
        local[:, :2] = local[:, :2] @ np.array([[cos, -sin], [sin, cos]])
        distance = np.hypot(local[:, 0], local[:, 1])
        order = np.argsort(-distance, kind='stable')
        order = order[distance[order] < VISIBLE_M]
        phase = int(world.time_s * PHASE_HZ) % 2
        running = 'night' if self.weather.headlights else 'day'
        shapes = []
        for i, metres in zip(order.tolist(), distance[order].tolist(), strict=True):
            if i >= len(actors):
                shapes.append(posts[i - len(actors)][0])
                continue
            actor = actors[i]
            lamps = 'off'
            if isinstance(actor, PathVehicle):
                braking = actor.command_acceleration < BRAKE_LAMP_MPS2 or actor.speed < 0.05
                lamps = 'brake' if braking else running
            size = (round(actor.LENGTH, 1), round(actor.WIDTH, 1), round(actor.HEIGHT, 1))
            flashes = actor.body.endswith('emergency') or (actor.body == 'walker' and actor.speed > 0.0)
            shapes.append(
                actor_shape(
                    actor.body,
                    actor.colour,
                    size,
                    lamps,
                    phase if flashes else 0,
                    detailed=metres < self.detail_m,
                )
            )
        return shapes, local[order]

    def _draw_boxes(self, pose: tuple[float, float, float]) -> None:
        shapes, local = self._things(pose)
        if not shapes:
            return
        counts = np.array([len(shape.normals) for shape in shapes])
        thing = np.repeat(np.arange(len(shapes)), counts)
        cos, sin = np.cos(local[:, 2]), np.sin(local[:, 2])
        turn = np.zeros((len(shapes), 3, 3))
        turn[:, 0, 0] = turn[:, 1, 1] = cos
        turn[:, 0, 1], turn[:, 1, 0], turn[:, 2, 2] = sin, -sin, 1.0
        turn = turn[thing]
        points = np.concatenate([shape.corners_m for shape in shapes]) @ turn
        points[..., :2] += local[thing, None, :2]
        normals = (np.concatenate([shape.normals for shape in shapes])[:, None] @ turn)[:, 0]
        camera, quad = self._seen(shapes, local, counts, points, normals)
        if not len(quad):
            return
        # (quad, corner, axis) in optical frames.
        seen = (points[quad] - self.positions[camera, None]) @ self.rotations[camera]
        depth = seen[..., 2]
        pixels = seen[..., :2] / np.maximum(depth, NEAR_M)[..., None] * self.focal[camera, None]
        pixels += self.centre[camera, None]
        low, high = pixels.min(axis=1), pixels.max(axis=1)
        inside = ((high > 0.0) & (low < (self.width, self.height))).all(axis=1)
        large = (high - low).prod(axis=1) > LEAST_PX * self.scale * self.scale
        nearest = depth.min(axis=1)
        crossing = (nearest <= NEAR_M) & (depth.max(axis=1) > NEAR_M)
        drawn = np.flatnonzero(((nearest > NEAR_M) & inside & large) | crossing)
        camera, quad = camera[drawn], quad[drawn]
        paint = self._paint(shapes, local[thing[quad]], quad, normals[quad], pose).tolist()
        polygons = list(_fixed(pixels[drawn]))
        for i in np.flatnonzero(crossing[drawn]).tolist():
            polygons[i] = _fixed(self._clip_near(seen[drawn[i]], camera[i]))
        frames = list(self.frames)
        for index, polygon, colour in zip(camera.tolist(), polygons, paint, strict=True):
            cv2.fillConvexPoly(frames[index], polygon, colour, cv2.LINE_8, SHIFT)

    def _seen(
        self, shapes: list[Shape], local: Float64, counts: NDArray[np.int64], points: Float64, normals: Float64
    ) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """(camera, quad) indices of all quads that face a camera and belong to a shape within its field of view."""
        centre = local[:, :2] - self.positions[:, None, :2]
        depth = np.einsum('cnk,ck->cn', centre, self.rotations[:, :2, 2])
        across = np.abs(np.einsum('cnk,ck->cn', centre, self.rotations[:, :2, 0]))
        radius = np.array([shape.radius_m for shape in shapes])
        cos, sin = self.edge
        camera, thing = np.nonzero((across * cos - depth * sin < radius) & (depth > -radius))
        many = counts[thing]
        first = np.cumsum(counts)[thing] - many
        quad = np.arange(many.sum()) + np.repeat(first - (np.cumsum(many) - many), many)
        camera = np.repeat(camera, many)
        facing = np.einsum('qk,qk->q', normals[quad], points[quad, 0] - self.positions[camera]) < 0.0
        return camera[facing], quad[facing]

    def _paint(
        self,
        shapes: list[Shape],
        places: Float64,
        quad: NDArray[np.int64],
        normals: Float64,
        pose: tuple[float, float, float],
    ) -> Float64:
        """(K, 3) RGB of the quads `quad` in this weather, with haze by their distance from the ego."""
        weather = self.weather
        azimuth = self.variation.sun_azimuth_rad - pose[2]
        sun = np.array([SUN_ACROSS * math.cos(azimuth), SUN_ACROSS * math.sin(azimuth), SUN_HEIGHT])
        clouds = CLOUD_SIDE + CLOUD_ABOVE * normals[:, 2]
        direct = weather.sun * np.maximum(normals @ sun, 0.0) + (1.0 - weather.sun) * clouds
        light = weather.light * (AMBIENT + DIRECT * direct)
        if weather.headlights:
            light += weather.beam(places)
        emissive = np.concatenate([shape.emissive for shape in shapes])[quad]
        gain = np.where(emissive[:, None], 1.0, light[:, None] * weather.tint())
        colours = self.variation.tone_mapped(np.concatenate([shape.colours for shape in shapes])[quad] * gain)
        thickness = 1.0 / HAZE_M + np.where(emissive, 1.0 / LAMP_REACH, 1.0) / weather.fog_m
        clear = np.exp(-np.hypot(places[:, 0], places[:, 1]) * thickness)[:, None]
        return self.air + (colours - self.air) * clear

    def _clip_near(self, corners: Float64, camera: int) -> Float64:
        """Pixel positions of a quad that crosses the near plane, clipped at it."""
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


def _fixed(pixels: Float64) -> NDArray[np.int32]:
    """Pixel positions in OpenCV's fixed-point, centre-of-pixel convention."""
    fixed = np.minimum(np.maximum((pixels - 0.5) * 2**SHIFT, -REACH), REACH)
    return np.rint(fixed).astype(np.int32)


def _sky(camera: CameraCalibration, scale: int, rows: int, weather: Weather, variation: Variation) -> Rgb:
    """(rows, W, 4) uint8: a vertical gradient down to the horizon, then distant grass down to the drawn ground."""
    v = (np.arange(rows) + 0.5) / scale
    rise = (camera.intrinsics[1, 2] - v) / camera.intrinsics[1, 1]
    part = np.clip(rise / 0.6, 0.0, 1.0)[:, None]
    column = np.array(weather.sky_horizon) * (1 - part) + np.array(weather.sky_top) * part
    column = variation.tone_mapped(column)
    column[rise < 0] = far_ground(weather, variation)
    column = np.column_stack([column, np.zeros(rows)])
    return np.repeat(column[:, None], camera.width * scale, axis=1).astype(np.uint8)
