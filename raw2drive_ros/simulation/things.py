"""What stands around the ego within sight: the models of actors, lights, signs and scenery, in the ego's frame."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from raw2drive_ros.contracts.public import Float64
from raw2drive_ros.simulation.actor_shapes import actor_shape
from raw2drive_ros.simulation.actors import Actor, PathVehicle
from raw2drive_ros.simulation.scenery_shapes import PlacedQuads, Scenery, static_quads
from raw2drive_ros.simulation.shapes import COLOUR, CORNERS, COUNTED, EMISSIVE, NORMAL, Shape
from raw2drive_ros.simulation.signal_shapes import light_shape, sign_shape
from raw2drive_ros.simulation.world import World

VISIBLE_M = 80.0
BRAKE_LAMP_MPS2 = -1.0
# Rate at which flashing lights and walking legs change, and at which indicators blink.
PHASE_HZ, BLINKS_PER_S = 4.0, 1.5
# Numbers of things are bytes, and 0 is what is nobody's.
MAX_NUMBERED = 255
# A lamp or sign that stands this close to one of the ego's own, and looks the same way, is that one.
SAME_POLE_M, SAME_POLE_RAD = 0.6, 0.5

Pose = tuple[float, float, float]
Ints = NDArray[np.int64]


@dataclass(slots=True)
class Things:
    """Quads of all things within sight, and the things from far to near, all in the ego's frame.

    corners_m: (Q, 4, 3). normals, colours: (Q, 3). emissive: (Q,) bool. number: (Q,) of the thing whose visibility the
    quad counts for, 0 for none. rows: (K,) what the numbers 1..K stand for: a row of `World.actors`, or behind those
    the lights and then the stop signs of the ego. place_m: (N, 2). radius_m: (N,). first, count: (N,) quads of each
    thing. counted: (N,) bool, which things have a number. distance_m, quad_place_m: (Q,), (Q, 2) of a quad's thing.
    """

    corners_m: Float64
    normals: Float64
    colours: Float64
    emissive: NDArray[np.bool_]
    number: Ints
    rows: Ints
    place_m: Float64
    radius_m: Float64
    first: Ints
    count: Ints
    counted: NDArray[np.bool_]
    distance_m: Float64
    quad_place_m: Float64


def scenery_of(world: World, *, night: bool) -> Scenery:
    """The scenery of a world; empty for a world that has none."""
    return Scenery(getattr(world, 'scenery', ()), night=night)


def counted_things(world: World) -> tuple[int, int]:
    """(number of actors, number of lights and stop signs) whose pixels are counted."""
    return len(world.history[0][0]), len(world.lights) + len(world.stop_signs)


def things_in_sight(world: World, pose: Pose, scenery: Scenery, *, night: bool, detail_m: float) -> Things | None:
    """All actors, lights and signs within `VISIBLE_M` of the ego at `pose`, and the scenery; None without any.

    night: running lamps are lit. detail_m: cars that are further away have no wheels, side windows and shadows.
    """
    actors, poses = world.history[0]
    signals = [(light_shape(light.colour), light.pole_pose) for light in world.lights]
    signals += [(sign_shape('stop'), sign.pole_pose) for sign in world.stop_signs]
    counted = len(actors) + len(signals)
    signals += list(_others(world))
    poses = np.concatenate([poses.reshape(-1, 3), np.array([place for _, place in signals]).reshape(-1, 3)])
    cos, sin = math.cos(pose[2]), math.sin(pose[2])
    from_map = np.array([[cos, -sin], [sin, cos]])
    local = poses - pose
    local[:, :2] = local[:, :2] @ from_map
    distance = np.hypot(local[:, 0], local[:, 1])
    within = np.flatnonzero(distance < VISIBLE_M)
    near_first = within[np.argsort(distance[within], kind='stable')]
    rows = near_first[near_first < counted][:MAX_NUMBERED]
    numbers = np.zeros(len(poses), np.int64)
    numbers[rows] = np.arange(1, len(rows) + 1)
    shapes = [
        signals[i - len(actors)][0]
        if i >= len(actors)
        else _actor_shape(actors[i], world.time_s, night=night, detailed=metres < detail_m)
        for i, metres in zip(within.tolist(), distance[within].tolist(), strict=True)
    ]
    around = scenery.around(pose[0], pose[1])
    if not shapes and not len(around):
        return None
    moving = _placed(shapes, local[within])
    standing = _turned(around, pose, from_map)
    number = np.zeros(len(moving) + len(standing), np.int64)
    number[: len(moving)] = numbers[within]
    return _ordered(moving.and_also(standing), number, rows)


def _ordered(quads: PlacedQuads, number: Ints, rows: Ints) -> Things:
    """Things from far to near. number: (N,) of each thing, 0 for none."""
    distance = np.hypot(quads.place_m[:, 0], quads.place_m[:, 1])
    order = np.argsort(-distance, kind='stable')
    part = np.repeat(np.arange(len(quads)), quads.count)
    paint = quads.paint
    return Things(
        corners_m=quads.vectors[:, CORNERS],
        normals=quads.vectors[:, NORMAL],
        colours=paint[:, COLOUR],
        emissive=paint[:, EMISSIVE] > 0.0,
        number=number[part] * paint[:, COUNTED].astype(np.int64),
        rows=rows,
        place_m=quads.place_m[order],
        radius_m=quads.radius_m[order],
        first=(np.cumsum(quads.count) - quads.count)[order],
        count=quads.count[order],
        counted=number[order] > 0,
        distance_m=distance[part],
        quad_place_m=quads.place_m[part],
    )


def _placed(shapes: list[Shape], local: Float64) -> PlacedQuads:
    """The quads of shapes that stand at (N, 3) x, y, yaw in the ego's frame."""
    if not shapes:
        return static_quads([])
    count = np.array([len(shape.paint) for shape in shapes])
    place = np.repeat(local, count, axis=0)
    cos, sin = np.cos(place[:, 2:]), np.sin(place[:, 2:])
    model = np.concatenate([shape.vectors for shape in shapes])
    vectors = model.copy()
    x, y = model[..., 0], model[..., 1]
    vectors[..., 0] = x * cos - y * sin
    vectors[..., 1] = x * sin + y * cos
    vectors[:, CORNERS, :2] += place[:, None, :2]
    paint = np.concatenate([shape.paint for shape in shapes])
    return PlacedQuads(vectors, paint, count, local[:, :2], np.array([shape.radius_m for shape in shapes]))


def _turned(quads: PlacedQuads, pose: Pose, from_map: Float64) -> PlacedQuads:
    """Quads in `map` as the ego at `pose` sees them."""
    turn = np.eye(3)
    turn[:2, :2] = from_map
    vectors = (quads.vectors.reshape(-1, 3) @ turn).reshape(-1, 5, 3)
    vectors[:, CORNERS, :2] -= np.array(pose[:2]) @ from_map
    return PlacedQuads(vectors, quads.paint, quads.count, (quads.place_m - pose[:2]) @ from_map, quads.radius_m)


def _actor_shape(actor: Actor, time_s: float, *, night: bool, detailed: bool) -> Shape:
    lamps, indicator = 'off', ''
    if isinstance(actor, PathVehicle):
        lamps = 'brake' if is_braking(actor) else 'night' if night else 'day'
        indicator = getattr(actor, 'indicator', '')
        # Not all indicators of a scene blink at the same time.
        if indicator and (time_s * BLINKS_PER_S + 0.37 * getattr(actor, 'number', 0)) % 1.0 >= 0.5:
            indicator = ''
    size = (round(actor.LENGTH, 1), round(actor.WIDTH, 1), round(actor.HEIGHT, 1))
    flashes = actor.body.endswith('emergency') or (actor.body == 'walker' and actor.speed > 0.0)
    phase = int(time_s * PHASE_HZ) % 2 if flashes else 0
    return actor_shape(actor.body, actor.colour, size, lamps, phase, detailed=detailed, indicator=indicator)


def is_braking(actor: Any) -> bool:
    """Whether the brake lamps of a vehicle are lit."""
    braking = getattr(actor, 'braking', None)
    if braking is None:
        return bool(actor.command_acceleration < BRAKE_LAMP_MPS2 or actor.speed < 0.05)
    return bool(braking)


def _others(world: World) -> Iterable[tuple[Shape, Pose]]:
    """Lamps and signs of the other approaches, and those of the ego's that it does not have to obey."""
    own_lights = [light.pole_pose for light in world.lights]
    for lamp in getattr(world, 'lamps', None) or ():
        if not any(_same_pole(lamp.pole_pose, own) for own in own_lights):
            yield light_shape(lamp.colour), lamp.pole_pose
    own_signs = [sign.pole_pose for sign in world.stop_signs]
    for sign in getattr(world, 'signs', None) or ():
        if not any(_same_pole(sign.pole_pose, own) for own in own_signs):
            yield sign_shape(sign.kind), sign.pole_pose


def _same_pole(a: Pose, b: Pose) -> bool:
    turned = (a[2] - b[2] + math.pi) % (2.0 * math.pi) - math.pi
    return math.hypot(a[0] - b[0], a[1] - b[1]) < SAME_POLE_M and abs(turned) < SAME_POLE_RAD
