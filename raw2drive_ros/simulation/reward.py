"""Reward and terminal rules of one decision step: Think2Drive's, which the paper reuses (appendix C.4), but for three
things that paid for bad driving on our routes (docs/benchmark.md):

- The speed term is v*/v_base - |v - v*|/7.5, not 1 - |v - v*|/7.5: standing where one has to stand earns nothing.
- v* looks at what is ahead in the ego's own corridor, so that who passes an obstacle is not told to stop for it.
- Deviation is free on the stretch beside the route that leads past an obstacle.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from raw2drive_ros.simulation.actors import PathVehicle, StandingObject, Walker
from raw2drive_ros.simulation.criteria import beside_route_m
from raw2drive_ros.simulation.world import DECISION_HZ, World

RAMP_M = 12.5
SPEED_SHARE = 0.8
SPEED_SCALE_MPS = 7.5
DEVIATION_SCALE_M = 8.0
DEVIATION_LIMIT_M = 15.0
SLOW_SPEED_MPS = 1.0
SLOW_LIMIT_S = 100.0
ROUTE_END_M = 10.0
SEARCH_M = 50.0
ON_ROUTE_M = 2.0
# Walkers and cyclists further aside than this do not slow v*.
BESIDE_M = 5.0

# Distances (m) at which the target speed reaches zero.
MARGIN_M = {'light': 4.0, 'stop': 2.5, 'vehicle': 8.0, 'cyclist': 5.0, 'walker': 5.0}
WEIGHTS = {'speed': 1.0, 'travel': 1.0, 'deviation': 2.0, 'steer': 0.5}


@dataclass(frozen=True, slots=True)
class Outcome:
    """reward and its terms (already weighted; they sum to it); why the episode ended, if it did."""

    reward: float
    terms: dict[str, float]
    target_speed_mps: float
    terminal: bool
    truncated: bool
    cause: str


class RewardModel:
    """Keeps what the reward needs of the previous step."""

    def __init__(self, world: World) -> None:
        self.best_s_m = world.route_s_m
        self.last_steer = 0.0
        self.slow_s = 0.0

    def step(self, world: World, infractions: list[str]) -> Outcome:
        """Score the step that just ended. infractions: names of those that happened in it."""
        ego = world.ego
        free = free_share(world)
        target = free * base_speed_mps(world)
        advance = max(0.0, world.route_s_m - self.best_s_m)
        self.best_s_m = max(self.best_s_m, world.route_s_m)
        steer = ego.command.steer
        deviation = beside_route_m(world)
        terms = {
            'speed': WEIGHTS['speed'] * (free - abs(ego.speed - target) / SPEED_SCALE_MPS),
            'travel': WEIGHTS['travel'] * advance,
            'deviation': -WEIGHTS['deviation'] * deviation / DEVIATION_SCALE_M,
            'steer': -WEIGHTS['steer'] * abs(steer - self.last_steer),
            'terminal': 0.0,
        }
        self.last_steer = steer
        self.slow_s = self.slow_s + 1.0 / DECISION_HZ if abs(ego.speed) < SLOW_SPEED_MPS else 0.0
        override, cause, truncated = self._end(world, deviation, infractions)
        if override is not None:
            terms = dict.fromkeys(terms, 0.0) | {'terminal': override}
        return Outcome(sum(terms.values()), terms, target, override is not None and not truncated, truncated, cause)

    def _end(self, world: World, deviation: float, infractions: list[str]) -> tuple[float | None, str, bool]:
        """(reward that replaces the sum, cause, is it a truncation)."""
        fatal = [i for i in infractions if i.startswith('collision') or i in ('red_light', 'stop_sign')]
        if fatal:
            return -1.0 - abs(world.ego.speed), fatal[0], False
        if deviation > DEVIATION_LIMIT_M:
            return -1.0, 'route_deviation', False
        if self.slow_s > SLOW_LIMIT_S:
            return -1.0, 'blocked', False
        if world.goal_s_m - world.route_s_m < ROUTE_END_M:
            return 1.0, 'route_end', True
        return None, '', False


def _ramp(distance_m: float, margin_m: float) -> float:
    return min(max(distance_m - margin_m, 0.0), RAMP_M) / RAMP_M


def base_speed_mps(world: World) -> float:
    """Target speed of a free road: a share of its advised speed."""
    return SPEED_SHARE * world.speed_limit_at(world.route_s_m)


def target_speed_mps(world: World) -> float:
    """v*: the free road's, ramped down to zero before the nearest hazard."""
    return free_share(world) * base_speed_mps(world)


def free_share(world: World) -> float:
    """v* / v_base in [0, 1]: what the nearest hazard leaves of the free road's speed."""
    factor = 1.0
    front = world.front_s_m
    for light in world.lights:
        if light.colour != 'green' and light.line_s_m > front - 0.5:
            factor = min(factor, _ramp(light.line_s_m - front, MARGIN_M['light']))
    for sign in world.stop_signs:
        if not sign.obeyed and sign.line_s_m > front - 0.5:
            factor = min(factor, _ramp(sign.line_s_m - front, MARGIN_M['stop']))
    factor = min(factor, _ramp(vehicle_ahead_m(world), MARGIN_M['vehicle']))
    for kind, distance in nearest_vulnerable_m(world).items():
        factor = min(factor, _ramp(distance, MARGIN_M[kind]))
    return factor


def vehicle_ahead_m(world: World) -> float:
    """Distance along the route to the first vehicle or obstacle whose centre is within 2 m of the ego's corridor, which
    runs beside the route at the ego's own offset; or inf."""
    best = math.inf
    for i, actor in enumerate(world.actors):
        if isinstance(actor, Walker) or actor.kind == 'cyclist':
            continue
        delta = world.positions[i] - world.ego.position
        if abs(delta[0]) > SEARCH_M + 5 or abs(delta[1]) > SEARCH_M + 5:
            continue
        s, lateral = world.route.project(
            float(world.positions[i, 0]), float(world.positions[i, 1]), world.route_s_m, SEARCH_M + 5
        )
        ahead = s - world.route_s_m
        if abs(lateral - _corridor_m(world, s)) < ON_ROUTE_M and 0.0 < ahead < SEARCH_M:
            best = min(best, ahead)
    return best


def _corridor_m(world: World, s_m: float) -> float:
    """Lateral offset of the ego's corridor at `s_m`: its own, as far as the road there lets it keep that."""
    right, left = world.lateral_range_m(s_m)
    return min(max(world.route_lateral_m, right), left)


def nearest_vulnerable_m(world: World) -> dict[str, float]:
    """Euclidean distance to the nearest cyclist and walker that is ahead of the ego and not far aside."""
    found: dict[str, float] = {}
    cos, sin = math.cos(world.ego.heading), math.sin(world.ego.heading)
    for i, actor in enumerate(world.actors):
        if isinstance(actor, StandingObject) or (isinstance(actor, PathVehicle) and actor.kind != 'cyclist'):
            continue
        delta = world.positions[i] - world.ego.position
        aside = abs(-delta[0] * sin + delta[1] * cos)
        limit = BESIDE_M if isinstance(actor, Walker) else ON_ROUTE_M
        if delta[0] * cos + delta[1] * sin < 0.0 or aside > limit:
            continue
        distance = float(np.hypot(*delta))
        found[actor.kind] = min(found.get(actor.kind, math.inf), distance)
    return found
