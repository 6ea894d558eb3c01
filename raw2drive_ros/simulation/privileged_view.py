"""The privileged frame of a world: masks, ego vector and, where visibility is computed, what the cameras have shown.

An actor, light or sign counts as seen for `SEEN_WITHIN_S` after the cameras have last shown enough of it. Masks of past
moments hold what counted as seen then: what appears now is not drawn in the past. A light keeps the colour in which it
was last seen. Signs do not move: once seen, they stay in the signals until the ego has passed them.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from raw2drive_ros.contracts.privileged import ACTOR_DTYPE, PASSED_M, PIXEL_FIELDS, ActorRows, PrivilegedFrame
from raw2drive_ros.simulation.actors import Actor
from raw2drive_ros.simulation.bev import CLASS_OF, BevRenderer
from raw2drive_ros.simulation.world import World
from raw2drive_ros.tables.actor_classes import ACTOR_CLASSES, ACTOR_RANGE_M
from raw2drive_ros.tables.bev_channels import HISTORY_TICKS
from raw2drive_ros.tables.vector_layout import SIGNAL_FIELDS, SIGNAL_RANGE_M

SEEN_WITHIN_S = 2.0
INDICATOR = {'left': 1, '': 0, 'right': -1}
CLASS_NUMBER = {kind: ACTOR_CLASSES.index(name) for kind, name in CLASS_OF.items()}
# (length, width, height, z of the centre) of the lamps of a light and the plate of a sign, as `shapes` draws them.
LAMPS_M = (0.3, 0.76, 1.4, 3.4)
PLATE_M = (0.06, 0.9, 0.9, 2.15)


class Visibility(Protocol):
    """How well the cameras show what is in a world, now and before; see `simulation.visibility`."""

    def pixels(self, actor: Actor) -> NDArray[np.integer]:
        """(6,) pixels of an actor in each camera, in the order of `topics.CAMERAS`."""

    def seconds_since_seen(self, actor: Actor) -> float:
        """0 while an actor is seen, inf if it never was."""

    def light_seen_s(self, index: int) -> float:
        """The same for `world.lights[index]`."""

    def sign_seen_s(self, index: int) -> float:
        """The same for `world.stop_signs[index]`."""


@dataclass(frozen=True, slots=True)
class _Moment:
    """What counted as seen at a decision tick: numbers of actors, and per light its colour ('': not seen)."""

    physics_ticks: int
    actors: frozenset[int]
    lights: tuple[str, ...]
    signs: tuple[bool, ...]


class SeenHistory:
    """A `bev.Seen`. `update` once per decision tick, after the visibility."""

    def __init__(self) -> None:
        self.moments: deque[_Moment] = deque(maxlen=HISTORY_TICKS[-1] + 1)
        # By identity; the actor is kept, so that its identity is not given to another one.
        self.numbers: dict[int, tuple[Actor, int]] = {}
        self.last_colours: tuple[str, ...] = ()
        self.at: list[_Moment] = []

    def update(self, world: World, visibility: Visibility) -> None:
        actors = frozenset(
            self.number(actor) for actor in world.actors if visibility.seconds_since_seen(actor) <= SEEN_WITHIN_S
        )
        since = [visibility.light_seen_s(index) for index in range(len(world.lights))]
        before = self.last_colours or ('',) * len(since)
        self.last_colours = tuple(
            light.colour if seen_s == 0.0 else colour
            for light, seen_s, colour in zip(world.lights, since, before, strict=True)
        )
        lights = tuple(
            colour if seen_s <= SEEN_WITHIN_S else '' for seen_s, colour in zip(since, self.last_colours, strict=True)
        )
        signs = tuple(visibility.sign_seen_s(index) <= SEEN_WITHIN_S for index in range(len(world.stop_signs)))
        self.moments.appendleft(_Moment(world.physics_ticks, actors, lights, signs))
        self.at = [self._before(world.physics_ticks - age) for age in HISTORY_TICKS]

    def number(self, actor: Actor) -> int:
        """The actor's own number or, where it has none, that of its first appearance."""
        own = getattr(actor, 'number', None)
        if own is not None:
            return int(own)
        return self.numbers.setdefault(id(actor), (actor, len(self.numbers)))[1]

    def actor(self, actor: Actor, moment: int) -> bool:
        return self.number(actor) in self.at[moment].actors

    def light(self, index: int, moment: int) -> str:
        return self.at[moment].lights[index]

    def sign(self, index: int, moment: int) -> bool:
        return self.at[moment].signs[index]

    def _before(self, physics_ticks: int) -> _Moment:
        """The newest moment that is not later; at the beginning of an episode, its first one."""
        return next((m for m in self.moments if m.physics_ticks <= physics_ticks), self.moments[-1])


class PrivilegedView:
    """Makes the privileged frames of one world; make a new one for every episode."""

    def __init__(self, world: World, bev: BevRenderer) -> None:
        self.world, self.bev = world, bev
        self.seen = SeenHistory()

    def frame(self, stamp_ns: int, visibility: Visibility | None = None) -> PrivilegedFrame:
        """The world as it is now. visibility: brought up to date before; without it only masks and ego vector are
        made."""
        bev = self.bev.render()
        if visibility is None:
            return PrivilegedFrame(stamp_ns, bev, ego_vector(self.world))
        self.seen.update(self.world, visibility)
        return PrivilegedFrame(
            stamp_ns,
            bev,
            ego_vector(self.world),
            self.bev.render_seen(bev, self.seen),
            actor_rows(self.world, self.seen, visibility),
            signals_vector(self.world, self.seen, visibility),
        )


def ego_vector(world: World) -> NDArray[np.float32]:
    """(7,) in the order of `EGO_FIELDS`; offset and heading error are those of the vehicle's centre from the route."""
    ego = world.ego
    error = math.remainder(ego.heading - world.route.pose(world.route_s_m)[2], 2.0 * math.pi)
    vector = (ego.speed, ego.steer, ego.throttle, ego.brake, ego.yaw_rate, world.route_lateral_m, error)
    return np.array(vector, np.float32)


def actor_rows(world: World, seen: SeenHistory, visibility: Visibility) -> ActorRows:
    """(N,) rows of `ACTOR_DTYPE` in `base_link`: the actors within `ACTOR_RANGE_M`, then the lights and signs that
    govern the ego from here on. Velocities are those over ground."""
    actors, poses = world.history[0]
    near = np.flatnonzero(np.hypot(*(poses[:, :2] - world.ego.position).T) < ACTOR_RANGE_M).tolist() if actors else []
    signals = _governing(world)
    rows = np.zeros(len(near) + len(signals), ACTOR_DTYPE)
    places = [poses[index] for index in near]
    for row, index in zip(rows, near, strict=False):
        actor = actors[index]
        row['class'], row['number'] = CLASS_NUMBER[actor.kind], seen.number(actor)
        row['length_m'], row['width_m'], row['height_m'] = actor.LENGTH, actor.WIDTH, actor.HEIGHT
        row['z'], row['vx_mps'] = actor.HEIGHT / 2, actor.speed
        row['braking'] = bool(getattr(actor, 'braking', False))
        row['indicator'] = INDICATOR[getattr(actor, 'indicator', '')]
        row['since_seen_s'] = visibility.seconds_since_seen(actor)
        for name, pixels in zip(PIXEL_FIELDS, visibility.pixels(actor), strict=True):
            row[name] = pixels
    for row, (kind, index, pose, box) in zip(rows[len(near) :], signals, strict=True):
        row['class'], row['number'] = ACTOR_CLASSES.index(kind), index
        row['length_m'], row['width_m'], row['height_m'], row['z'] = box
        is_light = kind.startswith('light')
        row['since_seen_s'] = visibility.light_seen_s(index) if is_light else visibility.sign_seen_s(index)
        places.append(np.array(pose))
    if places:
        _place(rows, np.array(places), world.ego_history[0])
    return rows


def _place(rows: ActorRows, poses: NDArray[np.float64], ego: tuple[float, float, float]) -> None:
    """Fill in position, yaw and velocity from (N, 3) poses in `map`; `vx_mps` holds the speed so far."""
    cos, sin = math.cos(ego[2]), math.sin(ego[2])
    dx, dy = poses[:, 0] - ego[0], poses[:, 1] - ego[1]
    rows['x'], rows['y'] = cos * dx + sin * dy, cos * dy - sin * dx
    yaw = np.remainder(poses[:, 2] - ego[2] + math.pi, 2.0 * math.pi) - math.pi
    speed = rows['vx_mps'].copy()
    rows['yaw_rad'], rows['vx_mps'], rows['vy_mps'] = yaw, speed * np.cos(yaw), speed * np.sin(yaw)


def _governing(world: World) -> list[tuple[str, int, tuple[float, float, float], tuple[float, ...]]]:
    """(class, index, pose of its pole in `map`, box) of the ego's lights and signs, in range and not passed."""
    x, y, _ = world.ego_history[0]
    lights = [(f'light_{light.colour}', i, light, LAMPS_M) for i, light in enumerate(world.lights)]
    signs = [('stop_sign', i, sign, PLATE_M) for i, sign in enumerate(world.stop_signs)]
    return [
        (kind, index, post.pole_pose, box)
        for kind, index, post, box in (*lights, *signs)
        if _ahead_m(world, post.line_s_m) >= -PASSED_M
        and math.hypot(post.pole_pose[0] - x, post.pole_pose[1] - y) < ACTOR_RANGE_M
    ]


def _ahead_m(world: World, line_s_m: float) -> float:
    """Distance from the front bumper to a line of the route, negative behind it."""
    return line_s_m - world.front_s_m


def signals_vector(world: World, seen: SeenHistory, visibility: Visibility) -> NDArray[np.float32]:
    """(11,) in the order of `SIGNAL_FIELDS`: the next light and the next stop sign on the route that were seen, the
    sign also after it was obeyed. Distances are from the front bumper to the line."""
    values = dict.fromkeys(SIGNAL_FIELDS, 0.0)
    values |= {name: SIGNAL_RANGE_M for name in SIGNAL_FIELDS if name.endswith('distance_m')}
    values['speed_limit_mps'] = world.scene.layout.speed_limit_mps
    lights = [(light.line_s_m, seen.light(index, 0)) for index, light in enumerate(world.lights)]
    distance, colour = _next(world, [(line_s_m, colour) for line_s_m, colour in lights if colour]) or (
        SIGNAL_RANGE_M,
        'none',
    )
    values[f'light_{colour}'], values['light_distance_m'] = 1.0, distance
    signs = [
        (sign.line_s_m, 'obeyed' if sign.obeyed else '')
        for index, sign in enumerate(world.stop_signs)
        if math.isfinite(visibility.sign_seen_s(index))
    ]
    if (sign := _next(world, signs)) is not None:
        values |= {'stop_sign': 1.0, 'stop_sign_distance_m': sign[0], 'stop_sign_obeyed': float(bool(sign[1]))}
    return np.array([values[name] for name in SIGNAL_FIELDS], np.float32)


def _next(world: World, lines: list[tuple[float, str]]) -> tuple[float, str] | None:
    """(distance from the front bumper, what) of the next of (line on the route, what) that is not passed, in range."""
    ahead = [(_ahead_m(world, line_s_m), what) for line_s_m, what in lines]
    return min((entry for entry in ahead if -PASSED_M <= entry[0] < SIGNAL_RANGE_M), default=None)
