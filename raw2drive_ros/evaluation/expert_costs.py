"""What a plan is worth: metres of progress, less what may happen to the ego and what it does to others."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from raw2drive_ros.contracts.public import Float64
from raw2drive_ros.evaluation.expert_belief import SOFT
from raw2drive_ros.evaluation.expert_map import poses_at
from raw2drive_ros.evaluation.expert_options import Option
from raw2drive_ros.evaluation.expert_plans import HALF_LENGTH_M, HALF_WIDTH_M, Plan, Rollouts
from raw2drive_ros.evaluation.expert_prediction import LIKELY
from raw2drive_ros.evaluation.expert_situation import GRID_M, Situation

COLLISION, CLOSE, IMPOSED, HARSH = 400.0, 28.0, 14.0, 0.5
# Of the others' boxes: to the front and back per m/s, and to the sides.
LONGER_S, LONGER_M, WIDER_M, WIDER_SOFT_M, TOUCH_M = 0.6, 0.4, 0.25, 0.6, 0.12
ACROSS_SIN = 0.3
# To pass closely in front of or behind somebody who crosses is worse than to pass closely beside somebody.
CROSSING_FACTOR = 3.0
IMPOSED_FREE_MPS2, IMPOSED_MOST_MPS2 = 2.0, 2.8
HARSH_MPS2 = 2.6
# A feared hypothesis counts when stopping for it takes more than this.
FEARED_MPS2 = 3.2
STANDING_MPS = 0.3
NEAR_M = 9.0
OFFSET_COST, START_COST, IN_JUNCTION_COST = 0.25, 60.0, 25.0
SIDEWAYS, SIDEWAYS_MPS2, UNDRIVABLE, UNDRIVABLE_MPS2 = 2.0, 2.5, 150.0, 6.5
# To change one's mind costs this much per metre between the old way and the new one, so far ahead.
CHANGE_COST, CHANGE_AHEAD_M, CHANGE_AHEAD_S = 2.0, 6.0, 2.0

Ints = NDArray[np.int64]


@dataclass(slots=True)
class Verdict:
    """score: (P,) metres. worst: (P,) index of the hypothesis that costs most, -1 without. clean: (P,) bool."""

    score: Float64
    worst: Ints
    clean: NDArray[np.bool_]
    collides: NDArray[np.bool_]


def judge(
    situation: Situation,
    found: list[Option],
    chosen: list[Plan],
    driven: Rollouts,
    before: tuple[Float64, Float64] | None,
) -> Verdict:
    """The worth of every plan. before: (stations, offsets) of the way chosen before, or None."""
    view = situation.forecast
    horizon = float(view.times_s[-1])
    # Both how far and how soon: before a red light the end is the same for all.
    way = driven.s - situation.s
    progress = 0.6 * way[:, -1] + 0.8 * way.mean(axis=1) + 0.6 * driven.speed[:, -1]
    hit, near = contacts(situation, driven)
    late = 1.0 - 0.5 * view.times_s / horizon
    counted = _counted(situation, view.weight)
    cost = np.zeros((len(chosen), len(view.weight)))
    if hit.size:
        worst_hit = (hit * late).max(axis=2)
        worst_near = (near * late).max(axis=2)
        cost = COLLISION * worst_hit * counted + CLOSE * worst_near * counted
        imposed = np.maximum(driven.imposed - IMPOSED_FREE_MPS2, 0.0)
        imposed += 2.0 * np.maximum(driven.imposed - IMPOSED_MOST_MPS2, 0.0)
        cost += IMPOSED * imposed * np.minimum(counted * 2.0, 1.0)
    step_s = float(view.times_s[1])
    harsh = HARSH * (np.maximum(-driven.acceleration - HARSH_MPS2, 0.0) ** 2).sum(axis=1) * step_s
    sideways = _sideways(situation, found, chosen, driven)
    harsh += SIDEWAYS * (np.maximum(sideways - SIDEWAYS_MPS2, 0.0) ** 2).sum(axis=1) * step_s
    harsh += UNDRIVABLE * (sideways.max(axis=1) > UNDRIVABLE_MPS2)
    own = np.array([option.cost + _change(situation, option, before) for option in found])
    own = own[[plan.option for plan in chosen]]
    own += OFFSET_COST * np.abs(driven.d).mean(axis=1)
    score = progress - harsh - own - (cost.max(axis=1) + 0.1 * cost.sum(axis=1) if cost.size else 0.0)
    peak = cost.max(axis=1) if cost.size else np.zeros(len(chosen))
    # Into the lane of oncoming traffic only where nothing speaks against it; on the way there is no use in hesitating.
    score = score - IN_JUNCTION_COST * _stops_inside(situation, driven)
    score = score - START_COST * _starts_badly(found, chosen, driven, peak)
    worst = np.where(peak > 0.0, cost.argmax(axis=1), -1) if cost.size else np.full(len(chosen), -1)
    return Verdict(score, worst, peak < 3.0, peak > 0.4 * COLLISION)


def _change(situation: Situation, option: Option, before: tuple[Float64, Float64] | None) -> float:
    """Cost of another way than the one that was chosen before: (stations, lateral offsets)."""
    if before is None:
        return 0.0
    ahead = situation.s + CHANGE_AHEAD_M + CHANGE_AHEAD_S * situation.speed * np.array((0.5, 1.0))
    return CHANGE_COST * float(
        np.abs(np.interp(ahead, situation.grid, option.offset) - np.interp(ahead, *before)).max()
    )


def _stops_inside(situation: Situation, driven: Rollouts) -> NDArray[np.bool_]:
    """(P,) whether a plan that need not ends with standing in a junction."""
    front = driven.s[:, -1] + HALF_LENGTH_M
    inside = np.zeros(len(front), bool)
    for enter, leave, _ in situation.lanes.spans:
        if situation.front_m < enter + 0.5:
            inside |= (front > enter + 0.3) & (front < leave + 2.0 * HALF_LENGTH_M)
    return inside & (driven.speed[:, -1] < 1.0)


def _starts_badly(found: list[Option], chosen: list[Plan], driven: Rollouts, peak: Float64) -> NDArray[np.bool_]:
    """(P,) whether a plan enters the lane of oncoming traffic and is not clean, or does not come out of it again."""
    starts = np.array([found[plan.option].starts for plan in chosen])
    enters, leaves = np.array([found[plan.option].between_m for plan in chosen]).T
    stays = (driven.s[:, -1] > enters) & (driven.s[:, -1] < leaves)
    return starts & ((peak > 3.0) | stays)


def _sideways(situation: Situation, found: list[Option], chosen: list[Plan], driven: Rollouts) -> Float64:
    """(P, T) lateral acceleration (m/s2) that the shifts of the options take, beside that of the route's own bends."""
    offsets = np.stack([option.offset for option in found])
    bend = np.abs(np.gradient(np.gradient(offsets, GRID_M, axis=1), GRID_M, axis=1))
    index = np.minimum(((driven.s - situation.grid[0]) / GRID_M).astype(np.int64), len(situation.grid) - 1)
    option = np.array([plan.option for plan in chosen])
    return bend[option[:, None], index] * driven.speed**2


def _counted(situation: Situation, weight: Float64) -> Float64:
    """(N,) weight of each hypothesis. A feared one counts fully once stopping for it takes real braking, before not."""
    view = situation.forecast
    inside = (np.abs(view.d) < view.half_d + HALF_WIDTH_M + 0.3) & (view.s > situation.front_m - 1.0)
    at = np.where(inside, view.s - view.half_s, np.inf).min(axis=1, initial=np.inf)
    room = np.maximum(at - 2.0 - situation.front_m - 0.25 * situation.speed, 0.2)
    needed = situation.speed**2 / (2.0 * room)
    feared = (needed > FEARED_MPS2).astype(float)
    return np.where(weight >= LIKELY, np.minimum(weight + 0.3, 1.0), np.where(weight > 0.05, 0.7 * feared, 0.0))


def contacts(situation: Situation, driven: Rollouts) -> tuple[NDArray[np.bool_], Float64]:
    """(P, N, T) whether boxes touch, and how much of the margins is used: 0 or up to 1."""
    view = situation.forecast
    shape = (*driven.s.shape[:1], *view.s.shape)
    hit, near = np.zeros(shape, bool), np.zeros(shape)
    if not view.weight.size:
        return hit, near
    x, y, yaw = poses_at(situation.world.route, driven.s, driven.d)
    yaw = yaw + np.arctan(driven.slope)
    lag = driven.lag
    dx = view.x[None] - lag * np.cos(view.yaw)[None] - x[:, None]
    dy = view.y[None] - lag * np.sin(view.yaw)[None] - y[:, None]
    reach = (view.length / 2 + NEAR_M)[None, :, None]
    pairs = np.nonzero((dx * dx + dy * dy < reach * reach) & (driven.speed > STANDING_MPS)[:, None])
    if not len(pairs[0]):
        return hit, near
    plan, other, time = pairs
    own_yaw = yaw[plan, time]
    relative = view.yaw[other, time] - own_yaw
    cos, sin = np.cos(own_yaw), np.sin(own_yaw)
    px, py = dx[pairs], dy[pairs]
    along, across = px * cos + py * sin, -px * sin + py * cos
    half_length, half_width = view.length[other] / 2, view.width[other] / 2
    soft = np.array([h.track.kind in SOFT for h in view.hypotheses])[other]
    wider = np.where(soft, WIDER_SOFT_M, WIDER_M)
    # Ahead of and behind those who cross the ego's way or come towards it.
    crossing = (np.abs(np.sin(relative)) > ACROSS_SIN) | (np.cos(relative) < 0.0)
    speed = view.speed[other, time]
    longer = np.where(crossing, LONGER_M + LONGER_S * speed, LONGER_M) * (speed > STANDING_MPS)
    hit[pairs] = _overlap(along, across, relative, half_length + TOUCH_M, half_width + TOUCH_M)
    pace = np.minimum(driven.speed[plan, time] / 4.0, 1.0)
    near[pairs] = (
        pace
        * np.where(crossing, CROSSING_FACTOR, 1.0)
        * _overlap(along, across, relative, half_length + longer, half_width + wider)
    )
    return hit, near


def _overlap(along: Float64, across: Float64, relative: Float64, length: Float64, width: Float64) -> NDArray[np.bool_]:
    """Whether the ego's box overlaps boxes of half extents (length, width) at (along, across), turned by `relative`."""
    cos, sin = np.abs(np.cos(relative)), np.abs(np.sin(relative))
    apart = np.abs(along) > HALF_LENGTH_M + length * cos + width * sin
    apart |= np.abs(across) > HALF_WIDTH_M + length * sin + width * cos
    turned_cos, turned_sin = np.cos(relative), np.sin(relative)
    own_along = np.abs(along * turned_cos + across * turned_sin)
    own_across = np.abs(-along * turned_sin + across * turned_cos)
    apart |= own_along > length + HALF_LENGTH_M * cos + HALF_WIDTH_M * sin
    apart |= own_across > width + HALF_LENGTH_M * sin + HALF_WIDTH_M * cos
    return ~apart
