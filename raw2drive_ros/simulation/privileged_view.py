"""The privileged frame of a world: masks, ego vector and, where visibility is computed, what the cameras have shown.

An actor, light or sign counts as seen for `SEEN_WITHIN_S` after the cameras have last shown enough of it. Masks of past
moments hold what counted as seen then: what appears now is not drawn in the past. A light keeps the colour in which it
was last seen. Signs do not move: once seen, they stay in the signals until the ego has passed them. Yield signs, which
visibility does not count, are known from `YIELD_SIGN_M` on.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from raw2drive_ros.contracts.privileged import ACTOR_DTYPE, PASSED_M, ActorRows, PrivilegedFrame
from raw2drive_ros.contracts.public import Float64
from raw2drive_ros.simulation.actors import Actor
from raw2drive_ros.simulation.bev import CLASS_OF, BevRenderer
from raw2drive_ros.simulation.world import World
from raw2drive_ros.tables.actor_classes import ACTOR_CLASSES, ACTOR_RANGE_M
from raw2drive_ros.tables.bev_channels import HISTORY_TICKS
from raw2drive_ros.tables.rates import SUBSTEPS
from raw2drive_ros.tables.vector_layout import SIGNAL_FIELDS, SIGNAL_RANGE_M

SEEN_WITHIN_S = 2.0
INDICATOR = {'left': 1, '': 0, 'right': -1}
CLASS_NUMBER = {kind: ACTOR_CLASSES.index(name) for kind, name in CLASS_OF.items()}
# (length, width, height, z of the centre) of the lamps of a light and the plate of a sign, as `shapes` draws them.
LAMPS_M = (0.3, 0.76, 1.4, 3.4)
PLATE_M = (0.06, 0.9, 0.9, 2.15)
# Visibility does not count yield signs: as what a map holds, they are known from this distance to their line on.
YIELD_SIGN_M = 50.0


class Visibility(Protocol):
    """How well the cameras show what is in a world, now and before; see `simulation.visibility`."""

    def pixels(self, actor: Actor) -> NDArray[np.integer]:
        """(6,) pixels of an actor in each camera, in the order of `topics.CAMERAS`."""

    def seconds_since_seen(self, actor: Actor) -> float:
        """0 while an actor is seen, inf if it never was."""

    def signal_pixels(self) -> NDArray[np.integer]:
        """(lights and stop signs, 6) pixels of `world.lights` and then of `world.stop_signs`."""

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
        self.moments: deque[_Moment] = deque(maxlen=HISTORY_TICKS[-1] // SUBSTEPS + 2)
        self.last_colours: tuple[str, ...] = ()
        self.at: list[_Moment] = []

    def update(self, world: World, visibility: Visibility) -> None:
        since_seen_s = visibility.seconds_since_seen
        actors = frozenset(actor.number for actor in world.actors if since_seen_s(actor) <= SEEN_WITHIN_S)
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

    def actor(self, actor: Actor, moment: int) -> bool:
        return actor.number in self.at[moment].actors

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
            actor_rows(self.world, visibility),
            signals_vector(self.world, self.seen, visibility),
        )


def ego_vector(world: World) -> NDArray[np.float32]:
    """(7,) in the order of `EGO_FIELDS`; offset and heading error are those of the vehicle's centre from the route."""
    ego = world.ego
    error = math.remainder(ego.heading - world.route.pose(world.route_s_m)[2], 2.0 * math.pi)
    vector = (ego.speed, ego.steer, ego.throttle, ego.brake, ego.yaw_rate, world.route_lateral_m, error)
    return np.array(vector, np.float32)


def actor_rows(world: World, visibility: Visibility) -> ActorRows:
    """(N,) rows of `ACTOR_DTYPE` in `base_link`: the actors within `ACTOR_RANGE_M`, then the lights and signs that
    govern the ego from here on. Velocities are those over ground."""
    actors, poses = world.history[0]
    signals = _governing(world)
    poles = np.array([pose for _, _, pose, _ in signals]).reshape(-1, 3)
    places = _in_base(np.concatenate([poses.reshape(-1, 3), poles]), world.ego_history[0])
    rows = [
        _actor_row(actor, place, visibility)
        for actor, place in zip(actors, places, strict=False)
        if math.hypot(place[0], place[1]) < ACTOR_RANGE_M
    ]
    rows += [
        _signal_row(world, kind, index, place, box, visibility)
        for (kind, index, _, box), place in zip(signals, places[len(actors) :], strict=True)
    ]
    # A list of tuples becomes rows three times as fast as columns or fields are filled one by one.
    return np.array(rows, ACTOR_DTYPE)


def _in_base(poses: Float64, ego: tuple[float, float, float]) -> list[list[float]]:
    """(N, 3) poses in `map` -> x, y, yaw of each in `base_link`."""
    cos, sin = math.cos(ego[2]), math.sin(ego[2])
    dx, dy = poses[:, 0] - ego[0], poses[:, 1] - ego[1]
    yaw = np.remainder(poses[:, 2] - ego[2] + math.pi, 2.0 * math.pi) - math.pi
    found: list[list[float]] = np.stack([cos * dx + sin * dy, cos * dy - sin * dx, yaw], axis=1).tolist()
    return found


def _actor_row(actor: Actor, place: list[float], visibility: Visibility) -> tuple[float, ...]:
    """In the order of `ACTOR_DTYPE`."""
    x, y, yaw = place
    return (
        *(x, y, actor.HEIGHT / 2, yaw, actor.LENGTH, actor.WIDTH, actor.HEIGHT),
        *(actor.speed * math.cos(yaw), actor.speed * math.sin(yaw), visibility.seconds_since_seen(actor), actor.number),
        *visibility.pixels(actor).tolist(),
        *(CLASS_NUMBER[actor.kind], getattr(actor, 'braking', False), INDICATOR[getattr(actor, 'indicator', '')]),
    )


def _signal_row(
    world: World, kind: str, index: int, place: list[float], box: tuple[float, ...], visibility: Visibility
) -> tuple[float, ...]:
    """In the order of `ACTOR_DTYPE`."""
    x, y, yaw = place
    length, width, height, z = box
    is_light = kind.startswith('light')
    since_s = visibility.light_seen_s(index) if is_light else visibility.sign_seen_s(index)
    pixels = visibility.signal_pixels()[index if is_light else len(world.lights) + index].tolist()
    return (x, y, z, yaw, length, width, height, 0.0, 0.0, since_s, index, *pixels, ACTOR_CLASSES.index(kind), 0, 0)


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
    if (give_way := _next(world, _yield_lines(world))) is not None and give_way[0] < YIELD_SIGN_M:
        values |= {'yield_sign': 1.0, 'yield_sign_distance_m': give_way[0]}
    return np.array([values[name] for name in SIGNAL_FIELDS], np.float32)


def _yield_lines(world: World) -> list[tuple[float, str]]:
    """(stop line on the route, '') of the junctions at which the ego has a yield sign."""
    return [
        (world.ego_crossings[sign.junction].stop_s_m, '')
        for sign in world.signs
        if sign.kind == 'yield' and sign.arm == 'back' and sign.junction in world.ego_crossings
    ]


def _next(world: World, lines: list[tuple[float, str]]) -> tuple[float, str] | None:
    """(distance from the front bumper, what) of the next of (line on the route, what) that is not passed, in range."""
    ahead = [(_ahead_m(world, line_s_m), what) for line_s_m, what in lines]
    return min((entry for entry in ahead if -PASSED_M <= entry[0] < SIGNAL_RANGE_M), default=None)
