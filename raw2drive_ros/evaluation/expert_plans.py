"""Plans: an option for where to drive with a way to choose the speed; all plans are driven in thought at once."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from raw2drive_ros.contracts.public import Float64
from raw2drive_ros.evaluation.expert_caution import speed_caps
from raw2drive_ros.evaluation.expert_options import Option
from raw2drive_ros.evaluation.expert_situation import (
    GRID_M,
    HALF_LENGTH_M,
    HALF_WIDTH_M,
    Situation,
    conflict_stops,
    stop_line,
)

SHARES = (1.0, 0.75, 0.5, 0.3)
OTHER_SHARES = (1.0, 0.7, 0.4)
COMFORT_MPS2, BRISK_MPS2 = 2.2, 3.4
SLOWS_MPS2, LEAST_MPS2, BRAKE_MPS2 = -3.0, -8.0, -7.5
STOP_MPS2 = 2.0
JERK_UP_MPS3, JERK_DOWN_MPS3 = 4.5, 9.0
TIME_GAP_S, GAP_M, IDM_BRAKING_MPS2 = 0.9, 2.6, 3.0
FOLLOW_MARGIN_M = 0.3
MERGE_GAP_S, OPENS_MPS2 = 0.4, -1.5
ALIGNED_COS = 0.7
SLOW_MPS = 0.5
FOLLOWER_BRAKES_MPS2, BEHIND_SEEN_M = 4.0, 50.0
# Merging: speeds relative to the stream beside the ego, and how far ahead and behind it is looked at.
STREAM_PARTS, STREAM_M, RUNWAY_M = (0.8, 0.95, 1.1), 45.0, 100.0
FREE, LEADER, STOP, CAP = 0, 1, 2, 3

Ints = NDArray[np.int64]


@dataclass(frozen=True, slots=True)
class Plan:
    """option: index of the option. share: of the advised speed. stop_m: where the front stops, inf without. brisk:
    accelerates harder. brake: brakes hard at once. why: reason of the stop."""

    option: int
    share: float = 1.0
    stop_m: float = math.inf
    brisk: bool = False
    brake: bool = False
    why: str = ''


@dataclass(slots=True)
class Rollouts:
    """Arrays over plans (P) and times (T): arc length, lateral offset, its slope, speed, acceleration. lag: (P, N, T)
    how far each actor stays behind its forecast because the ego is in front of it; imposed: (P, N) the hardest braking
    that takes. first: (P,) what limited the first step (FREE, LEADER, STOP or CAP), leader: (P,) whom."""

    s: Float64
    d: Float64
    slope: Float64
    speed: Float64
    acceleration: Float64
    lag: Float64
    imposed: Float64
    first: Ints
    leader: Ints


def plans(situation: Situation, found: list[Option]) -> list[Plan]:
    """The candidates: shares of the advised speed on every option, and stops for whoever crosses on the route."""
    line, why = stop_line(situation)
    chosen: list[Plan] = []
    waits = conflict_stops(situation)
    stream = _stream_shares(situation)
    near = any(at - situation.front_m < 30.0 for at, _ in waits)
    for index, option in enumerate(found):
        stop, reason = (line, why) if line <= option.stop_m else (option.stop_m, option.why)
        shares = SHARES if index == 0 else OTHER_SHARES
        if stream and (index == 0 or option.family in ('keep', 'left', 'right')):
            shares = (*shares, *stream)
        if stream and option.why == 'end of the lane' and option.stop_m - situation.front_m < RUNWAY_M:
            # It must merge before the lane ends: whoever lets the stream overtake keeps room for a gap to come.
            shares = (0.6 * stream[0], 0.85 * stream[0])
        for share in shares:
            chosen.append(Plan(index, share, stop, why=reason))
        if option.family == 'route' and index:
            chosen.append(Plan(index, 0.0, stop, brake=True, why=reason))
        if index > 4 and not option.oncoming:
            continue
        if situation.speed < 0.7 * situation.advised_mps and (near or option.oncoming or index > 0):
            chosen.append(Plan(index, 1.0, stop, brisk=True, why=reason))
        if index > 2:
            continue
        chosen += [Plan(index, 1.0, at, why=f'let {name} pass') for at, name in waits if at < stop]
    chosen.append(Plan(0, 0.0, line, why=why))
    chosen.append(Plan(0, 0.0, line, brake=True, why=why))
    return chosen


def _stream_shares(situation: Situation) -> tuple[float, ...]:
    """Shares of the advised speed around the speed of the cars in the lanes beside the ego."""
    view = situation.forecast
    aside = np.abs(view.d[:, 0] - situation.d)
    beside = (aside > 1.8) & (aside < 5.0) & (np.abs(view.s[:, 0] - situation.s) < STREAM_M)
    beside &= (np.cos(view.turned[:, 0]) > ALIGNED_COS) & (view.speed[:, 0] > 2.0)
    if beside.sum() < 2:
        return ()
    speed = float(np.median(view.speed[beside, 0])) / max(situation.advised_mps, 1.0)
    return tuple(round(speed * part, 2) for part in STREAM_PARTS if speed * part < 0.97)


def roll_out(situation: Situation, found: list[Option], chosen: list[Plan], before_mps2: float) -> Rollouts:
    """Drive all plans over the times of the forecast. before_mps2: the ego's acceleration until now."""
    return _Rollout(situation, found, chosen, before_mps2).run()


class _Rollout:
    """The loop over time; everything else is prepared before it."""

    def __init__(self, situation: Situation, found: list[Option], chosen: list[Plan], before: float) -> None:
        self.situation = situation
        view = situation.forecast
        self.step_s = float(view.times_s[1])
        option = np.array([plan.option for plan in chosen])
        offsets = np.stack([o.offset for o in found])
        caps = speed_caps(situation, offsets)
        share = np.array([plan.share for plan in chosen])
        self.offset = offsets[option]
        self.rows = np.arange(len(chosen))
        self.capped = caps[option] < share[:, None] * situation.limit
        self.wanted = np.minimum(share[:, None] * situation.limit, caps[option])
        self.stop = np.array([plan.stop_m for plan in chosen])
        self.strength = np.where([plan.brisk for plan in chosen], BRISK_MPS2, COMFORT_MPS2)
        self.brake = np.array([plan.brake for plan in chosen])
        self.before = np.full(len(chosen), before)
        self._corridors()

    def _corridors(self) -> None:
        """(P, N, T) masks: who is in the way of which plan as somebody to follow, and whose way a plan may enter."""
        view, situation = self.situation.forecast, self.situation
        index = np.minimum(
            np.maximum(((view.s - situation.grid[0]) / GRID_M).astype(np.int64), 0), len(situation.grid) - 1
        )
        # Offset of each plan at each actor's place: (P, N, T).
        at = self.offset[:, index]
        beside = np.abs(view.d[None] - at) < view.half_d[None] + HALF_WIDTH_M + FOLLOW_MARGIN_M
        along = view.speed * np.cos(view.turned)
        follows = (np.cos(view.turned) > ALIGNED_COS) | (view.speed < SLOW_MPS)
        likely = view.weight[:, None] > 0.4
        leads = beside & (follows & likely)[None]
        # Only those who lead on any plan, and those who may come from behind, matter in the loop over time.
        self.leaders = np.flatnonzero(leads.any(axis=(0, 2)))
        self.leads = np.ascontiguousarray(leads[:, self.leaders].transpose(2, 0, 1))
        self.rear = (view.s - view.half_s)[self.leaders]
        self.along = np.maximum(along[self.leaders], 0.0)
        self.leader_d, self.leader_half = view.d[self.leaders], view.half_d[self.leaders] + HALF_WIDTH_M + 0.1
        aligned = (np.cos(view.turned) > ALIGNED_COS) & (view.speed > SLOW_MPS)
        behind = view.s[:, 0] < situation.s
        mine = np.abs(view.d[:, 0] - situation.d) < view.half_d[:, 0] + HALF_WIDTH_M
        behind &= view.s[:, 0] > situation.s - BEHIND_SEEN_M
        self.behind = np.flatnonzero(aligned.any(axis=1) & behind)
        self.may_follow = aligned[self.behind]
        self.was_mine = (mine & aligned[:, 0])[self.behind]
        self.nose = (view.s + view.half_s)[self.behind]
        self.behind_d, self.behind_half = view.d[self.behind], view.half_d[self.behind] + HALF_WIDTH_M + 0.1
        self.behind_speed = view.speed[self.behind]

    def run(self) -> Rollouts:
        view, situation = self.situation.forecast, self.situation
        count, actors, steps = len(self.rows), len(view.weight), len(view.times_s)
        s, v, a = np.full(count, situation.s), np.full(count, situation.speed), self.before
        lag, slower = (np.zeros((count, len(self.behind))) for _ in range(2))
        out = Rollouts(
            *(np.empty((count, steps)) for _ in range(5)),
            lag=np.zeros((count, actors, steps)),
            imposed=np.zeros((count, actors)),
            first=np.zeros(count, np.int64),
            leader=np.full(count, -1),
        )
        dt, watch = self.step_s, bool(len(self.behind))
        for k in range(steps):
            where = (s - situation.grid[0]) / GRID_M
            index = np.minimum(where.astype(np.int64), len(situation.grid) - 2)
            part = where - index
            low, high = self.offset[self.rows, index], self.offset[self.rows, index + 1]
            d = low + part * (high - low)
            out.s[:, k], out.d[:, k], out.slope[:, k], out.speed[:, k] = s, d, (high - low) / GRID_M, v
            wanted, leader, kind = self._acceleration(k, s, v, d, index)
            if k == 0:
                out.first, out.leader = kind, leader
            a = self._limited(wanted, a)
            out.acceleration[:, k] = a
            if watch:
                lag, slower = self._followers(k, s, v, d, lag, slower, out)
            new = np.maximum(v + a * dt, 0.0)
            s, v = s + 0.5 * (v + new) * dt, new
        return out

    def _acceleration(self, k: int, s: Float64, v: Float64, d: Float64, index: Ints) -> tuple[Float64, Ints, Ints]:
        """(wanted acceleration, leader, what limits it)."""
        ahead = np.minimum(index + 1 + (0.4 * v).astype(np.int64), self.wanted.shape[1] - 1)
        target = self.wanted[self.rows, ahead]
        free = np.minimum(np.maximum(1.5 * (target - v), SLOWS_MPS2), self.strength)
        kind = np.where(self.capped[self.rows, ahead], CAP, FREE)
        front = s + HALF_LENGTH_M
        wanted, leader = free, np.full(len(s), -1)
        if self.rear.size:
            gap = np.where(self.leads[k], self.rear[None, :, k] - front[:, None], np.inf)
            gap[gap < -2.0] = np.inf
            nearest = gap.argmin(axis=1)
            leader = self.leaders[nearest]
            room = np.maximum(gap[self.rows, nearest], 0.1)
            closing = v - self.along[nearest, k]
            beside = np.abs(self.leader_d[nearest, k] - d) < self.leader_half[nearest, k]
            # On the way into the next lane a smaller gap will do, and it is opened gently.
            headway = np.where(beside, TIME_GAP_S, MERGE_GAP_S)
            desired = GAP_M + np.maximum(
                v * headway + v * closing / (2.0 * np.sqrt(COMFORT_MPS2 * IDM_BRAKING_MPS2)), 0.0
            )
            floor = np.where((closing < 0.5) & (room > 1.5), OPENS_MPS2, np.where(beside, LEAST_MPS2, SLOWS_MPS2))
            follow = np.maximum(COMFORT_MPS2 * (1.0 - (desired / room) ** 2), floor)
            kind = np.where(follow < wanted, LEADER, kind)
            wanted = np.minimum(wanted, follow)
        room = self.stop - front
        needed = v * v / (2.0 * np.maximum(room, 0.15))
        rolling = 2.0 * (np.sqrt(2.0 * STOP_MPS2 * np.maximum(room - 0.2, 0.0)) - v)
        halt = np.where(needed > 0.9 * STOP_MPS2, -1.05 * needed, rolling)
        halt = np.where(room < 0.3, -3.0, halt)
        halt = np.where(room < -1.0, np.inf, np.maximum(halt, LEAST_MPS2))
        kind = np.where(halt < wanted, STOP, kind)
        return np.minimum(wanted, halt), leader, kind

    def _limited(self, wanted: Float64, before: Float64) -> Float64:
        """Acceleration within the jerk limits; hard braking is not limited."""
        up = before + JERK_UP_MPS3 * self.step_s
        down = np.where(wanted < -3.5, LEAST_MPS2, before - JERK_DOWN_MPS3 * self.step_s)
        limited = np.minimum(np.maximum(wanted, down), np.maximum(up, 0.0))
        return np.where(self.brake, BRAKE_MPS2, limited)

    def _followers(
        self, k: int, s: Float64, v: Float64, d: Float64, lag: Float64, slower: Float64, out: Rollouts
    ) -> tuple[Float64, Float64]:
        """Whoever comes from behind brakes for an ego that is in its lane."""
        out.lag[:, self.behind, k] = lag
        beside = np.abs(self.behind_d[None, :, k] - d[:, None]) < self.behind_half[None, :, k]
        gap = s[:, None] - HALF_LENGTH_M - (self.nose[None, :, k] - lag)
        speed = np.maximum(self.behind_speed[None, :, k] - slower, 0.0)
        closing = np.maximum(speed - v[:, None], 0.0)
        concerned = beside & self.may_follow[None, :, k] & (gap > -1.0)
        room = np.maximum(gap - 1.0 - 0.3 * closing, 0.3)
        needed = np.where(concerned, closing**2 / (2.0 * room) + 3.0 * np.maximum(1.0 - gap / 2.0, 0.0), 0.0)
        needed[:, self.was_mine] *= 0.0 if k < 1 else 0.5
        out.imposed[:, self.behind] = np.maximum(out.imposed[:, self.behind], needed)
        braking = np.where(needed > 1.0, np.minimum(1.3 * needed, FOLLOWER_BRAKES_MPS2), 0.0)
        slower = np.minimum(slower + braking * self.step_s, self.behind_speed[None, :, k])
        return lag + slower * self.step_s, slower
