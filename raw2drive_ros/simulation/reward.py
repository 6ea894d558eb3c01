"""Reward and terminal rules of one decision step, after Think2Drive, whose reward the paper reuses (appendix C.4).

Three terms differ, because they rewarded bad driving on our routes (docs/benchmark.md):

- The speed term is v*/v_base - |v - v*|/min(7.5, v_base), not 1 - |v - v*|/7.5: standing where the ego has to stand
  earns nothing, and standing on a free road never earns anything.
- v* depends on what is ahead in the ego's own corridor, so an ego that passes an obstacle does not have to stop for it.
- Deviation costs nothing on the detour around an obstacle.
- Pedestrians who stand beside the lane or walk away from it do not reduce v*: most of them want nothing.

Three terms are new: holding up an emergency vehicle costs `YIELD_COST` per step, way outside the lanes costs
`OUTSIDE_COST` per metre, which is more than it earns, and staying too long where the event is costs `RULE_COST` once.
Making others brake hard ends the drive, as a red light does.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from raw2drive_ros.contracts.public import Float64
from raw2drive_ros.simulation.actors import Walker
from raw2drive_ros.simulation.conduct import walks_towards
from raw2drive_ros.simulation.criteria import route_deviation_m
from raw2drive_ros.simulation.path import Query, project_groups
from raw2drive_ros.simulation.world import World
from raw2drive_ros.tables.rates import DECISION_HZ

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
# An emergency vehicle is held up if it is this close behind, and slower than its target speed by this much.
YIELD_COST, HELD_UP_M, HELD_UP_MPS = 1.0, 30.0, 2.0
OUTSIDE_COST, RULE_COST = 2.0, 10.0
RULES = ('scenario_timeout',)
FATAL = ('red_light', 'stop_sign', 'forced_braking')
VULNERABLE = ('walker', 'cyclist')
# Pedestrians with a larger lateral distance do not reduce v*.
BESIDE_M = 5.0
# Before an amber light v* is reduced only where this deceleration is enough to stop.
AMBER_MPS2 = 4.0

# Distances (m) at which the target speed reaches zero.
MARGIN_M = {'light': 4.0, 'stop': 2.5, 'vehicle': 8.0, 'cyclist': 5.0, 'walker': 5.0}
WEIGHTS = {'speed': 1.0, 'travel': 1.0, 'deviation': 2.0, 'steer': 0.5}


@dataclass(frozen=True, slots=True)
class Outcome:
    """reward: sum of `terms`, which are weighted. terminal, truncated: the episode ends. cause: why, or empty."""

    reward: float
    terms: dict[str, float]
    target_speed_mps: float
    terminal: bool
    truncated: bool
    cause: str


class RewardModel:
    """Computes the reward; holds what it needs from the previous steps. Make a new one for every episode."""

    def __init__(self, world: World) -> None:
        self.best_s_m = world.route_s_m
        self.last_steer = 0.0
        self.slow_s = 0.0
        self.contacts_seen = len(world.contacts)

    def step(
        self, world: World, infractions: list[str], outside_m: float = 0.0, vehicle_m: float | None = None
    ) -> Outcome:
        """Reward of the step that just ended. infractions: names of those that began in it. outside_m: its way outside
        the lanes. vehicle_m: `vehicle_ahead_m`, for who knows it already."""
        ego = world.ego
        free = free_share(world, vehicle_m)
        base = base_speed_mps(world)
        target = free * base
        advance = max(0.0, world.route_s_m - self.best_s_m)
        self.best_s_m = max(self.best_s_m, world.route_s_m)
        steer = ego.command.steer
        deviation = route_deviation_m(world)
        terms = {
            'speed': WEIGHTS['speed'] * (free - abs(ego.speed - target) / min(SPEED_SCALE_MPS, base)),
            'travel': WEIGHTS['travel'] * advance,
            'deviation': -WEIGHTS['deviation'] * deviation / DEVIATION_SCALE_M,
            'steer': -WEIGHTS['steer'] * abs(steer - self.last_steer),
            'yield': -YIELD_COST if holds_up_emergency(world) else 0.0,
            'lanes': -OUTSIDE_COST * outside_m,
            'rules': -RULE_COST * sum(name in RULES for name in infractions),
            'terminal': 0.0,
        }
        self.last_steer = steer
        self.slow_s = self.slow_s + 1.0 / DECISION_HZ if abs(ego.speed) < SLOW_SPEED_MPS else 0.0
        override, cause, truncated = self._end(world, deviation, infractions)
        if override is not None:
            terms = dict.fromkeys(terms, 0.0) | {'terminal': override}
        return Outcome(sum(terms.values()), terms, target, override is not None and not truncated, truncated, cause)

    def _end(self, world: World, deviation: float, infractions: list[str]) -> tuple[float | None, str, bool]:
        """(reward in place of the sum or None, cause, whether it is a truncation)."""
        new, self.contacts_seen = world.contacts[self.contacts_seen :], len(world.contacts)
        fatal = [i for i in infractions if i.startswith('collision') or i in FATAL]
        if fatal:
            # After an impact the ego is slower than it was.
            speed = max(abs(world.ego.speed), *(contact.ego_speed_mps for contact in new), 0.0)
            return -1.0 - speed, fatal[0], False
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
    """v_base: target speed on a free road, a share of the advised speed."""
    return SPEED_SHARE * world.speed_limit_at(world.route_s_m)


def target_speed_mps(world: World) -> float:
    """v*: v_base, reduced linearly to zero in front of the nearest hazard."""
    return free_share(world) * base_speed_mps(world)


def free_share(world: World, vehicle_m: float | None = None) -> float:
    """v* / v_base in [0, 1]: 1 on a free road, 0 right in front of the nearest hazard."""
    factor = 1.0
    front = world.front_s_m
    for light in world.lights:
        gap = light.line_s_m - front
        if light.colour == 'yellow' and gap < world.ego.speed**2 / (2.0 * AMBER_MPS2):
            continue
        if light.colour != 'green' and gap > -0.5:
            factor = min(factor, _ramp(gap, MARGIN_M['light']))
    for sign in world.stop_signs:
        if not sign.obeyed and sign.line_s_m > front - 0.5:
            factor = min(factor, _ramp(sign.line_s_m - front, MARGIN_M['stop']))
    vehicle_m = vehicle_ahead_m(world) if vehicle_m is None else vehicle_m
    factor = min(factor, _ramp(vehicle_m, MARGIN_M['vehicle']))
    for kind, distance in nearest_vulnerable_m(world).items():
        factor = min(factor, _ramp(distance, MARGIN_M[kind]))
    return factor


def vehicle_ahead_m(world: World) -> float:
    """Distance (m) along the route to the first vehicle or obstacle whose centre is within `ON_ROUTE_M` of the ego's
    corridor, which runs along the route at the ego's own lateral offset; inf without one."""
    return vehicles_ahead_m([world])[0]


def vehicles_ahead_m(worlds: Sequence[World]) -> list[float]:
    """`vehicle_ahead_m` of several worlds: the same as one after the other, in less time."""
    queries: dict[int, Query] = {}
    for i, world in enumerate(worlds):
        near = np.abs(world.positions[:-1] - world.ego.position).max(axis=1, initial=0.0) < SEARCH_M + 5
        rows = [row for row in np.flatnonzero(near).tolist() if world.actors[row].kind not in VULNERABLE]
        if rows:
            queries[i] = (world.route, world.positions[rows], world.route_s_m)
    found = [math.inf] * len(worlds)
    for i, places in zip(queries, project_groups([*queries.values()], SEARCH_M + 5)):
        found[i] = _first_in_corridor_m(worlds[i], *places)
    return found


def _first_in_corridor_m(world: World, stations_m: Float64, laterals_m: Float64) -> float:
    best = math.inf
    for s, lateral in zip(stations_m.tolist(), laterals_m.tolist(), strict=True):
        ahead = s - world.route_s_m
        if 0.0 < ahead < min(best, SEARCH_M) and abs(lateral - _corridor_m(world, s)) < ON_ROUTE_M:
            best = ahead
    return best


def holds_up_emergency(world: World) -> bool:
    """Whether an emergency vehicle is close behind in the ego's corridor and below its target speed."""
    for i, actor in enumerate(world.actors):
        if actor.kind != 'emergency' or actor.target_speed - actor.speed < HELD_UP_MPS:
            continue
        x, y = (float(v) for v in world.positions[i])
        s, lateral = world.route.project(x, y, world.route_s_m, HELD_UP_M + 10.0)
        if 0.0 < world.route_s_m - s < HELD_UP_M and abs(lateral - world.route_lateral_m) < ON_ROUTE_M:
            return True
    return False


def _corridor_m(world: World, s_m: float) -> float:
    """Lateral offset of the ego's corridor at `s_m`: the ego's own, limited to where it may drive there."""
    right, left = world.lateral_range_m(s_m)
    return min(max(world.route_lateral_m, right), left)


def nearest_vulnerable_m(world: World) -> dict[str, float]:
    """Kind -> Euclidean distance (m) to the nearest cyclist or pedestrian ahead of the ego who is in its lane, or
    walks towards it."""
    found: dict[str, float] = {}
    cos, sin = math.cos(world.ego.heading), math.sin(world.ego.heading)
    x, y = (float(v) for v in world.ego.position)
    for actor in world.actors:
        if actor.kind not in VULNERABLE:
            continue
        dx, dy = float(actor.position[0]) - x, float(actor.position[1]) - y
        ahead, aside = dx * cos + dy * sin, -dx * sin + dy * cos
        nearing = actor.speed > 0.0 and walks_towards(aside, actor.heading - world.ego.heading)
        limit = BESIDE_M if isinstance(actor, Walker) and nearing else ON_ROUTE_M
        if ahead < 0.0 or abs(aside) > limit:
            continue
        found[actor.kind] = min(found.get(actor.kind, math.inf), math.hypot(dx, dy))
    return found
