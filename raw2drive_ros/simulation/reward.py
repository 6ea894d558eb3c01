"""Reward and terminal rules of one decision step: Think2Drive's, which the paper reuses (appendix C.4), but for three
things that paid for bad driving on our routes (docs/benchmark.md):

- The speed term is v*/v_base - |v - v*|/7.5, not 1 - |v - v*|/7.5: standing where one has to stand earns nothing.
- v* looks at what is ahead in the ego's own corridor, so that who passes an obstacle is not told to stop for it.
- Deviation is free on the stretch beside the route that leads past an obstacle.

and one that it has no word for: holding up an emergency vehicle costs `YIELD_COST` a step.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from raw2drive_ros.rates import DECISION_HZ
from raw2drive_ros.simulation.actors import Walker
from raw2drive_ros.simulation.criteria import beside_route_m
from raw2drive_ros.simulation.world import World

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
# An emergency vehicle this near behind, slower than it wants to be by so much, is held up.
YIELD_COST, HELD_UP_M, HELD_UP_MPS = 1.0, 30.0, 2.0
VULNERABLE = ('walker', 'cyclist')
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
            'yield': -YIELD_COST if holds_up_emergency(world) else 0.0,
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
    near = np.abs(world.positions[:-1] - world.ego.position).max(axis=1, initial=0.0) < SEARCH_M + 5
    rows = [i for i in np.flatnonzero(near) if world.actors[i].kind not in VULNERABLE]
    if not rows:
        return math.inf
    stations, laterals = world.route.project_many(world.positions[rows], world.route_s_m, SEARCH_M + 5)
    best = math.inf
    for s, lateral in zip(stations.tolist(), laterals.tolist(), strict=True):
        ahead = s - world.route_s_m
        if 0.0 < ahead < min(best, SEARCH_M) and abs(lateral - _corridor_m(world, s)) < ON_ROUTE_M:
            best = ahead
    return best


def holds_up_emergency(world: World) -> bool:
    """Is an emergency vehicle close behind in the ego's corridor, and slower than it wants to be?"""
    for i, actor in enumerate(world.actors):
        if actor.kind != 'emergency' or actor.target_speed - actor.speed < HELD_UP_MPS:
            continue
        x, y = (float(v) for v in world.positions[i])
        s, lateral = world.route.project(x, y, world.route_s_m, HELD_UP_M + 10.0)
        if 0.0 < world.route_s_m - s < HELD_UP_M and abs(lateral - world.route_lateral_m) < ON_ROUTE_M:
            return True
    return False


def _corridor_m(world: World, s_m: float) -> float:
    """Lateral offset of the ego's corridor at `s_m`: its own, as far as the road there lets it keep that."""
    right, left = world.lateral_range_m(s_m)
    return min(max(world.route_lateral_m, right), left)


def nearest_vulnerable_m(world: World) -> dict[str, float]:
    """Euclidean distance to the nearest cyclist and walker that is ahead of the ego and not far aside."""
    found: dict[str, float] = {}
    cos, sin = math.cos(world.ego.heading), math.sin(world.ego.heading)
    x, y = (float(v) for v in world.ego.position)
    for actor in world.actors:
        if actor.kind not in VULNERABLE:
            continue
        dx, dy = float(actor.position[0]) - x, float(actor.position[1]) - y
        limit = BESIDE_M if isinstance(actor, Walker) else ON_ROUTE_M
        if dx * cos + dy * sin < 0.0 or abs(-dx * sin + dy * cos) > limit:
            continue
        found[actor.kind] = min(found.get(actor.kind, math.inf), math.hypot(dx, dy))
    return found
