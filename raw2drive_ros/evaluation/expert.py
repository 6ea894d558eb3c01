"""A privileged expert without learning: it tries speeds and offsets in a twin of the simulation and takes the best.

It bounds what is solvable on a route: the twin holds every trigger and every intention, which no fair
driver knows. Pure pursuit steers; the plan is a share of the speed limit and a lateral offset, kept for
`REPLAN_TICKS` decisions.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass

import numpy as np

from raw2drive_ros.contract import Control
from raw2drive_ros.evaluation.following import pedals, pursuit_steer
from raw2drive_ros.simulation.actors import StandingObject, Walker, boxes_overlap, corners_m, first_on_path
from raw2drive_ros.simulation.world import DECISION_HZ, SUBSTEPS, World

REPLAN_TICKS = 4
HORIZON_S = 9.0
MARGIN_M = 0.35
HARD_BRAKING_MPS2 = -3.5
STOP_BEFORE_M = 1.0
ZONE_SIGHT_M = 14.0
PASS_LIMIT_S = 18.0
SPEED_SHARES = (0.95, 0.65, 0.4, 0.2, 0.0)
OFFSETS_M = (0.0, -0.7, 0.7)
LOOK_AHEAD_S = 0.8
IDM_TIME_GAP_S = 1.0
IDM_GAP_M = 3.0
SIGHT_M = 45.0


@dataclass(frozen=True, slots=True)
class Plan:
    """share: of the speed limit. offset_m: to the left of the route. hold: wait before the oncoming lane."""

    share: float
    offset_m: float = 0.0
    hold: bool = False


class Expert:
    """control(world) -> Control. Deterministic."""

    def __init__(self) -> None:
        self.plan = Plan(SPEED_SHARES[0])
        self.age = REPLAN_TICKS

    def control(self, world: World) -> Control:
        self.age += 1
        if self.age >= REPLAN_TICKS:
            self.plan = choose(world, self.plan)
            self.age = 0
        return follow(world, self.plan)


def choose(world: World, current: Plan) -> Plan:
    """The plan whose simulated future is best.

    The oncoming lane is entered only on a plan that nobody has to brake for, seen through to its end:
    otherwise two cars would stand nose to nose.
    """
    zone = oncoming_zone(world)
    before = zone is not None and world.front_s_m < zone[0]
    if zone is not None and before and world.front_s_m > zone[0] - ZONE_SIGHT_M:
        for share in SPEED_SHARES[:3]:
            if rehearse(world, Plan(share), until_s_m=zone[1])[1]:
                return Plan(share)
    best, best_score = Plan(0.0, hold=before), -math.inf
    for offset in OFFSETS_M:
        for share in SPEED_SHARES:
            plan = Plan(share, offset, before)
            score, clean = rehearse(world, plan)
            if plan == current:
                score += 0.5
            if score > best_score:
                best, best_score = plan, score
            if clean:
                # Slower plans with the same offset cannot gain anything over a clean faster one.
                break
        if best_score > 0.0:
            break
    return best


def oncoming_zone(world: World) -> tuple[float, float] | None:
    """(start, end) on the route of the next stretch that uses the oncoming lane, or None."""
    changes = world.scene.route.changes
    for out, back in itertools.pairwise(changes):
        end = back.s_m + back.over_m
        if out.to_lane < 0 and world.route_s_m < end:
            return out.s_m, end
    return None


def rehearse(world: World, plan: Plan, until_s_m: float | None = None) -> tuple[float, bool]:
    """(score, clean) of driving `plan` in a twin. Score: metres of progress minus penalties.

    For `HORIZON_S`, or, where that is given, until the route's arc length `until_s_m` is reached; not to
    reach it within `PASS_LIMIT_S` is not clean.
    """
    twin = world.fork()
    start_s_m = twin.route_s_m
    penalty = 0.0
    horizon_s = HORIZON_S if until_s_m is None else PASS_LIMIT_S
    for tick in range(round(horizon_s * DECISION_HZ)):
        if until_s_m is not None and twin.route_s_m >= until_s_m:
            return twin.route_s_m - start_s_m - penalty, penalty == 0.0
        control = follow(twin, plan)
        for _ in range(SUBSTEPS):
            twin.step(control)
        if hits(twin):
            # Later is better: it leaves time for another plan.
            penalty += 200.0 - tick
            break
        if _forces_others(twin):
            penalty += 1.5
        penalty += 0.4 * max(0.0, abs(twin.route_lateral_m - plan.offset_m) - 1.2)
        if twin.goal_s_m - twin.route_s_m < 9.0:
            return 500.0 - 2.0 * tick - penalty, penalty == 0.0
    clean = penalty == 0.0 and until_s_m is None
    return twin.route_s_m - start_s_m - penalty - 0.5 * abs(plan.offset_m), clean


def hits(world: World, margin_m: float = MARGIN_M) -> bool:
    """Does the ego, grown by a margin, touch anything?"""
    ego = world.ego
    near = np.abs(world.positions[:-1] - ego.position).max(axis=1) < 7.0
    if not near.any():
        return False
    x, y = float(ego.position[0]), float(ego.position[1])
    own = corners_m(x, y, ego.heading, ego.LENGTH + margin_m, ego.WIDTH + margin_m)
    for index in np.flatnonzero(near):
        actor = world.actors[int(index)]
        place = (float(actor.position[0]), float(actor.position[1]))
        if boxes_overlap(own, corners_m(*place, actor.heading, actor.LENGTH, actor.WIDTH)):
            return True
    return False


def _forces_others(world: World) -> bool:
    """Does somebody near have to brake hard for the ego?"""
    for actor in world.actors:
        if isinstance(actor, StandingObject | Walker) or actor.command_acceleration > HARD_BRAKING_MPS2:
            continue
        if np.abs(actor.position - world.ego.position).max() < 20.0 and actor.speed > 0.5:
            return True
    return False


def follow(world: World, plan: Plan) -> Control:
    """Pure pursuit on the route, IDM behind what is on it, stops at lights and signs."""
    speed = max(world.ego.speed, 0.0)
    wanted = plan.share * world.speed_limit_at(world.route_s_m)
    acceleration = min(_idm(world, speed, wanted), _stopping(world, speed, plan))
    return pedals(world, acceleration, pursuit_steer(world, LOOK_AHEAD_S, plan.offset_m))


def _stopping(world: World, speed: float, plan: Plan) -> float:
    """Acceleration that stops the front bumper 1 m before the next stop line, once that needs more than a little."""
    gap = _stop_line_m(world)
    zone = oncoming_zone(world) if plan.hold else None
    if zone is not None and zone[0] > world.front_s_m - 0.5:
        gap = min(gap, zone[0] - world.front_s_m)
    if gap == math.inf:
        return gap
    room = gap - STOP_BEFORE_M
    if room < 0.3:
        return -3.0 if speed > 0.05 else 0.0
    needed = speed * speed / (2.0 * room)
    if needed > 1.2:
        return -1.15 * needed
    # Slow enough already: roll on, but never faster than what can stop.
    return 2.0 * (math.sqrt(2.0 * 1.2 * room) - speed)


def _stop_line_m(world: World) -> float:
    """Free distance to the next line that the ego has to stop at, or inf."""
    front, best = world.front_s_m, math.inf
    for light in world.lights:
        gap = light.line_s_m - front
        if light.colour != 'green' and gap > -0.3 and gap > world.ego.speed**2 / 14.0 - 1.0:
            best = min(best, gap)
    for sign in world.stop_signs:
        if not sign.obeyed and sign.line_s_m > front - 0.3:
            best = min(best, sign.line_s_m - front)
    return best


def _idm(world: World, speed: float, wanted: float) -> float:
    """IDM acceleration towards `wanted`, behind the first thing whose box reaches into the ego's corridor."""
    free = 3.0 * (1.0 - speed / wanted) if wanted > 0.1 else -4.0 if speed > 0.1 else 0.0
    free = max(free, -5.0)
    gap, closing = leader(world)
    if gap > SIGHT_M:
        return min(free, 3.0)
    desired = IDM_GAP_M + max(0.0, speed * IDM_TIME_GAP_S + speed * closing / (2.0 * math.sqrt(3.0 * 4.0)))
    return max(min(free, 3.0 * (1.0 - (desired / max(gap, 0.1)) ** 2)), -8.0)


def leader(world: World) -> tuple[float, float]:
    """(free gap, closing speed) to the first thing in the ego's corridor along the route, or (inf, 0)."""
    # From 1 m ahead: what stands beside the ego's centre is no leader.
    window = world.route.window(world.route_s_m + 1.0, SIGHT_M)
    gap, closing = first_on_path(world, world.ego, window, 0.2, SIGHT_M)
    return gap + 1.0, closing
