"""The oracle, a driver without learning: it simulates several speeds and lateral offsets, and drives by the best.

It is the bound of what can be solved on a route, and no example to learn from: its rollouts use a fork of the world with
all triggers and intentions, which no driver could observe. A plan is a share of the speed limit and a lateral offset,
kept for `REPLAN_TICKS` decisions; pure pursuit steers. The driver that plans on what it has seen is `expert.py`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from raw2drive_ros.contracts.public import Control
from raw2drive_ros.evaluation.following import (
    SIGHT_M,
    idm_acceleration,
    leader,
    pedals,
    pursuit_steer,
    stop_line_m,
    stopping,
)
from raw2drive_ros.simulation.actors import StandingObject, Walker, boxes_overlap, corners_m
from raw2drive_ros.simulation.criteria import LANE_TOLERANCE_M, route_deviation_m
from raw2drive_ros.simulation.world import World
from raw2drive_ros.tables.rates import DECISION_HZ, SUBSTEPS

REPLAN_TICKS = 4
HORIZON_S = 9.0
MARGIN_M = 0.35
HARD_BRAKING_MPS2 = -3.5
ZONE_SIGHT_M = 14.0
PASS_LIMIT_S = 18.0
SPEED_SHARES = (0.95, 0.65, 0.4, 0.2, 0.0)
OFFSETS_M = (0.0, -0.7, 0.7)
IN_LANE_AFTER_M = 10.0
# The ego counts as outside its lane from so little before the edge of where it may drive.
EDGE_SLACK_M = 0.1
OFF_ROAD_PENALTY = 3.0


@dataclass(frozen=True, slots=True)
class Plan:
    """share: of the speed limit. offset_m: to the left of the route or detour. hold: wait at the start of a detour."""

    share: float
    offset_m: float = 0.0
    hold: bool = False


class OracleDriver:
    """`control(world)` returns a `Control`; deterministic. stride: of the forks for rollouts, see `World.fork`."""

    def __init__(self, stride: int = 1) -> None:
        self.stride = stride
        self.plan = Plan(SPEED_SHARES[0])
        self.age = REPLAN_TICKS

    def control(self, world: World) -> Control:
        self.age += 1
        if self.age >= REPLAN_TICKS:
            self.plan = choose(world, self.plan, self.stride)
            self.age = 0
        return follow(world, self.plan)


def choose(world: World, current: Plan, stride: int = 1) -> Plan:
    """The plan with the best rollout.

    A detour is started only with a plan that makes nobody brake until its end; otherwise the ego and an oncoming car
    could block each other.
    """
    zone = detour_zone(world)
    before = zone is not None and world.front_s_m < zone[0]
    if zone is not None and before and world.front_s_m > zone[0] - ZONE_SIGHT_M:
        for share in SPEED_SHARES[:3]:
            if roll_out(world, Plan(share), zone[1], stride)[1]:
                return Plan(share)
    best, best_score = Plan(0.0, hold=before), -math.inf
    for offset in OFFSETS_M:
        for share in SPEED_SHARES:
            plan = Plan(share, offset, before)
            score, clean = roll_out(world, plan, None, stride)
            if plan == current:
                score += 0.5
            if score > best_score:
                best, best_score = plan, score
            if clean:
                # With the same offset a slower plan cannot beat a faster one without penalties.
                break
        if best_score > 0.0:
            break
    return best


def detour_zone(world: World) -> tuple[float, float] | None:
    """(start, end) arc lengths on the route of the next detour through another lane, or None.

    For a lane in the ego's direction the end is that of the lane change into it; for the oncoming lane that of the lane
    change back.
    """
    changes = world.scene.route.detour
    for i, out in enumerate(changes):
        back = changes[i + 1] if i + 1 < len(changes) else None
        oncoming = out.to_lane < 0 and back is not None
        end = back.s_m + back.over_m if oncoming and back is not None else out.s_m + out.over_m + IN_LANE_AFTER_M
        if world.route_s_m < end and (out.to_lane != world.scene.route.lane):
            return out.s_m, end
    return None


def roll_out(world: World, plan: Plan, until_s_m: float | None = None, stride: int = 1) -> tuple[float, bool]:
    """(score, clean) of a rollout of `plan` in a fork. score: metres of progress minus penalties. clean: no penalty.

    It lasts `HORIZON_S` or, with `until_s_m`, until the ego reaches that arc length of the route; a rollout that does
    not reach it within `PASS_LIMIT_S` is not clean.
    """
    fork = world.fork(stride)
    start_s_m = fork.route_s_m
    edge_m = world.scene.layout.lane_width_m / 2 + LANE_TOLERANCE_M - EDGE_SLACK_M
    penalty = 0.0
    horizon_s = HORIZON_S if until_s_m is None else PASS_LIMIT_S
    for tick in range(round(horizon_s * DECISION_HZ)):
        if until_s_m is not None and fork.route_s_m >= until_s_m:
            return fork.route_s_m - start_s_m - penalty, penalty == 0.0
        control = follow(fork, plan)
        for _ in range(SUBSTEPS // stride):
            fork.step(control)
        if hits(fork):
            # A later collision costs less: it leaves time for another plan.
            penalty += 200.0 - tick
            break
        if _forces_hard_braking(fork):
            penalty += 1.5
        aside = abs(fork.route_lateral_m - fork.detour_offset_m(fork.route_s_m) - plan.offset_m)
        penalty += 0.4 * max(0.0, aside - 1.2) + (OFF_ROAD_PENALTY if route_deviation_m(fork) > edge_m else 0.0)
        if fork.goal_s_m - fork.route_s_m < 9.0:
            return 500.0 - 2.0 * tick - penalty, penalty == 0.0
    clean = penalty == 0.0 and until_s_m is None
    return fork.route_s_m - start_s_m - penalty - 0.5 * abs(plan.offset_m), clean


def hits(world: World, margin_m: float = MARGIN_M) -> bool:
    """Whether the ego, enlarged by a margin, overlaps an actor."""
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


def _forces_hard_braking(world: World) -> bool:
    """Whether a vehicle near the ego brakes hard."""
    for actor in world.actors:
        if isinstance(actor, StandingObject | Walker) or actor.command_acceleration > HARD_BRAKING_MPS2:
            continue
        if np.abs(actor.position - world.ego.position).max() < 20.0 and actor.speed > 0.5:
            return True
    return False


def follow(world: World, plan: Plan) -> Control:
    """Pure pursuit on the route or detour, IDM behind the leading actor, stops at lights and signs."""
    speed = max(world.ego.speed, 0.0)
    wanted = plan.share * world.speed_limit_at(world.route_s_m)
    # From 1 m ahead on: an actor beside the ego's centre is not ahead of it.
    gap, closing = leader(world, world.detour_window(world.route_s_m + 1.0, SIGHT_M))
    line = stop_line_m(world)
    zone = detour_zone(world) if plan.hold else None
    if zone is not None and zone[0] > world.front_s_m - 0.5:
        line = min(line, zone[0] - world.front_s_m)
    acceleration = min(idm_acceleration(speed, wanted, gap, closing), stopping(speed, line))
    return pedals(world, acceleration, pursuit_steer(world, offset_m=plan.offset_m, along_detour=True))
