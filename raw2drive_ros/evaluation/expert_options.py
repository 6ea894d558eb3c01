"""The ways along the road that the expert considers: lateral offsets from the route over the stretch ahead."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from raw2drive_ros.contracts.public import Float64
from raw2drive_ros.evaluation.expert_map import FORWARD, ONCOMING
from raw2drive_ros.evaluation.expert_shifts import LEAST_SHIFT_M, later, shift_m, shifted
from raw2drive_ros.evaluation.expert_situation import (
    AHEAD_M,
    CLEAR_M,
    CLEAR_SOFT_M,
    HALF_LENGTH_M,
    HALF_WIDTH_M,
    Anchor,
    Situation,
    Zone,
    is_forward,
    lane_kind,
    lane_profile,
)

# Short of a wreck, so that there is room to steer out.
STAND_SHORT_M = 8.0
# A car further to the side than this is in another lane.
ANOTHER_LANE_M = 0.8
KEEP_FOR_M = (20.0, 45.0, 80.0)
WALL_SHORT_M = 4.0
EMERGENCY_BEHIND_M = 70.0
RETURN_M = 1.5
NEAR_SIDE_M, NO_SHIFT_BEFORE_M = 1.3, 12.0
# Metres of progress per lane between the route and another lane, this far ahead.
LANE_COST, AWAY_AT_M = 4.0, 60.0
# The nearer the end of a lane, the more it costs to stay in it.
END_COST, END_WITHIN_M = 20.0, 130.0
# Beyond the middle of the lane's own room; and nobody faster than this is passed through the oncoming lane.
BESIDE_LANE_M, SLOWEST_MPS = 0.3, 2.6
IN_THE_WAY_COST, CUTS_IN_COST, BLOCKED_COST, LEAST_CLEAR_M = 30.0, 20.0, 12.0, 0.3
# The route is lost where the own lane is farther from it than this many lanes.
LOST_LANES = 1.3


@dataclass(slots=True)
class Option:
    """offset: (G,) lateral offset from the route. stop_m: where the front has to stop, inf without. why: reason of
    the stop. cost: metres of progress that it has to be better by. oncoming: uses a lane of oncoming traffic.
    about: whom it gets around. starts: it
    enters that lane, and the ego could still stay out of it. between_m: arc lengths
    between which it is beside the obstacle."""

    name: str
    offset: Float64
    stop_m: float = math.inf
    why: str = ''
    cost: float = 0.0
    oncoming: bool = False
    about: str = ''
    anchor: Anchor | None = None
    starts: bool = False
    between_m: tuple[float, float] = (-math.inf, math.inf)

    @property
    def family(self) -> str:
        """Options of one family are the same intention."""
        return 'route' if self.name.startswith('aside') else self.name.split()[0]


def options(situation: Situation, blocked: list[Zone]) -> list[Option]:
    """The route itself first, then what else the road and the situation offer."""
    found = [_route(situation)]
    hurried = _emergency_behind(situation)
    found += _lane(situation, 0, 'keep', hurried=hurried is not None)
    blocked = [zone for zone in blocked if zone.end_m > situation.s - HALF_LENGTH_M]
    if blocked:
        found += _past(situation, blocked[0])
    if blocked or hurried is not None or _slow_leader(situation):
        for side, name in ((1, 'left'), (-1, 'right')):
            found += _lane(situation, side, name, hurried=hurried is not None)
    found += _small_shifts(situation)
    for option in found:
        _hold(situation, option, blocked)
        if (
            hurried is not None
            and abs(float(np.interp(situation.s + 35.0, situation.grid, option.offset)) - hurried) < 2.2
        ):
            option.cost += IN_THE_WAY_COST
    return found


def _route(situation: Situation) -> Option:
    offset, anchor = shifted(situation, np.zeros_like(situation.grid), shift_m(situation, situation.d))
    return Option('route', offset, anchor=anchor)


def _lane(situation: Situation, side: int, name: str, *, hurried: bool) -> list[Option]:
    """Drive in the lane `side` lanes to the left of the ego's, for as long as it runs beside the route; in the own
    lane, which the route leaves, also for some metres only."""
    found = lane_profile(situation, side)
    if found is None:
        return []
    profile, ends = found
    ahead = (situation.grid > situation.s) & (situation.grid < situation.s + 110.0)
    if np.abs(profile[ahead]).max() < ANOTHER_LANE_M:
        return []
    lost = ahead & (np.abs(profile) > LOST_LANES * situation.lanes.width_m)
    lost &= np.abs(profile) > abs(situation.d) + 1.0
    if lost.any():
        ends = min(ends, float(situation.grid[lost][0]))
    across = float(np.interp(situation.s, situation.grid, profile)) - situation.d
    over = max(shift_m(situation, across), 12.0 if side else 0.0)
    stay, anchor = shifted(situation, profile, over)
    away = np.abs(np.interp(situation.s + AWAY_AT_M, situation.grid, profile)) / situation.lanes.width_m
    cost = 0.0 if hurried else LANE_COST * float(away)
    options = []
    if ends > situation.front_m + (2.0 if side == 0 else 40.0):
        cost += END_COST * min(max(1.0 - (ends - situation.s) / END_WITHIN_M, 0.0), 1.0)
        options.append(Option(name, stay, ends - WALL_SHORT_M, 'end of the lane', cost=cost, anchor=anchor))
    return options + (_returns(situation, profile, stay, ends, anchor) if side == 0 else [])


def _returns(situation: Situation, profile: Float64, stay: Float64, ends_m: float, anchor: Anchor) -> list[Option]:
    """Stay in the lane for some metres, then follow the route."""
    found = []
    for metres in KEEP_FOR_M:
        start, over = situation.s + metres, max(18.0, 2.4 * situation.speed)
        if start + over > ends_m + 5.0 or abs(float(np.interp(start, situation.grid, profile))) < ANOTHER_LANE_M:
            continue
        offset = later(stay, np.zeros_like(stay), situation.grid, start, over)
        found.append(Option(f'keep {metres:.0f}', offset, cost=1.5 + 0.05 * metres, anchor=anchor))
    return found


def _past(situation: Situation, zone: Zone) -> list[Option]:
    """Ways around what blocks the route: within the lane, or through the lane on its left or right."""
    clear = CLEAR_SOFT_M if zone.soft else CLEAR_M
    width = situation.lanes.width_m
    room = width / 2 - HALF_WIDTH_M
    found = []
    for side in (1, -1):
        edge = zone.d_high if side > 0 else -zone.d_low
        across = edge + HALF_WIDTH_M + clear
        if across > width + 1.2:
            continue
        kinds = {lane_kind(situation, s, side) for s in (zone.begin_m, 0.5 * (zone.begin_m + zone.end_m), zone.end_m)}
        oncoming = False
        if across > room + BESIDE_LANE_M:
            # Past it in a lane of the ego's direction is a lane change.
            if ONCOMING not in kinds or FORWARD in kinds or side < 0 or zone.speed > SLOWEST_MPS:
                continue
            oncoming = True
        found.append(_around(situation, zone, side * across, oncoming=oncoming))
    return found


def _around(situation: Situation, zone: Zone, across_m: float, *, oncoming: bool) -> Option:
    grid, width = situation.grid, situation.lanes.width_m
    begin, end = zone.begin_m, zone.end_m
    if zone.speed > 0.3:
        # It moves on while the ego passes it.
        closing = max(situation.advised_mps - zone.speed, 2.0)
        until = max(begin - situation.front_m, 0.0) / closing
        begin += zone.speed * max(until - 1.5, 0.0)
        end += zone.speed * (until + (end - begin + 14.0) / closing)
    out_by, back_from = begin - HALF_LENGTH_M - 1.0, end + HALF_LENGTH_M + 1.0
    over = max(LEAST_SHIFT_M, situation.advised_mps * (1.0 + 0.75 * math.sqrt(abs(across_m))))
    target = np.full_like(grid, across_m)
    start = out_by - over
    if start <= situation.s:
        over_now = max(min(shift_m(situation, across_m - situation.d), out_by - situation.s), 5.0)
        offset, anchor = shifted(situation, target, over_now)
    else:
        straight, anchor = shifted(situation, np.zeros_like(grid), shift_m(situation, situation.d))
        offset = later(straight, target, grid, start, over)
    if back_from > situation.s or oncoming:
        offset = later(offset, np.zeros_like(grid), grid, max(back_from, situation.s), max(12.0, 0.8 * over))
    starts = oncoming and situation.front_m < zone.begin_m - RETURN_M
    name = f'pass {"left" if across_m > 0.0 else "right"}'
    cost = 2.0 if abs(across_m) < 0.5 * width else 3.0
    return Option(
        name,
        offset,
        cost=cost + 2.0 * oncoming,
        oncoming=oncoming,
        about=zone.name,
        anchor=anchor,
        starts=starts,
        between_m=(out_by, back_from),
    )


def _emergency_behind(situation: Situation) -> float | None:
    """Lateral offset from the route of an emergency vehicle that comes from behind, or None."""
    view = situation.forecast
    for i, h in enumerate(view.hypotheses):
        if h.track.kind != 'emergency' or h.track.fixed:
            continue
        behind = situation.s - float(view.s[i, 0])
        if 0.0 < behind < EMERGENCY_BEHIND_M and abs(float(view.d[i, 0]) - situation.d) < 6.0:
            return float(view.d[i, 0])
    return None


def _slow_leader(situation: Situation) -> bool:
    """Whether somebody in the ego's lane drives much slower than it may, and there is another lane."""
    if not (is_forward(situation, situation.s, 1) or is_forward(situation, situation.s, -1)):
        return False
    view = situation.forecast
    ahead = view.s[:, 0] - situation.s
    slow = (
        (ahead > 0.0)
        & (ahead < 50.0)
        & (np.abs(view.d[:, 0] - situation.d) < 1.8)
        & (view.speed[:, 0] < 0.7 * situation.advised_mps)
        & (np.cos(view.turned[:, 0]) > 0.7)
    )
    return bool(slow.any())


def _small_shifts(situation: Situation) -> list[Option]:
    """A little to the left or right within the lane, where something is close to the ego's way."""
    view = situation.forecast
    span = situation.lanes.next_span(situation.s)
    if abs(situation.d) > ANOTHER_LANE_M + 0.7 or (span is not None and span[0] - situation.s < NO_SHIFT_BEFORE_M):
        # Corners of junctions are tight: no room beside the route.
        return []
    ahead = (view.s > situation.s - 3.0) & (view.s < situation.s + 50.0)
    gap = np.abs(view.d) - view.half_d - HALF_WIDTH_M
    near = ahead & (gap < NEAR_SIDE_M) & ((np.abs(np.sin(view.turned)) < 0.5) | (view.speed < 0.5))
    if not near.any():
        return []
    room = situation.lanes.width_m / 2 - HALF_WIDTH_M
    found = []
    for across in (0.6 * room, -0.6 * room, room, -room):
        target = np.full_like(situation.grid, across)
        moved, anchor = shifted(situation, target, max(shift_m(situation, across - situation.d), 8.0))
        found.append(Option(f'aside {across:+.1f}', moved, cost=0.6 + 0.6 * abs(across), anchor=anchor))
    return found


def _hold(situation: Situation, option: Option, blocked: list[Zone]) -> None:
    """An option that runs into a fixed obstacle has to stop well short of it."""
    for zone in blocked:
        if zone.begin_m > situation.s + AHEAD_M or zone.speed > 0.3:
            continue
        beside = (situation.grid > zone.begin_m - HALF_LENGTH_M) & (situation.grid < zone.end_m + HALF_LENGTH_M)
        at = option.offset[beside & (situation.grid > situation.s)]
        reach = HALF_WIDTH_M + LEAST_CLEAR_M
        if not ((at > zone.d_low - reach) & (at < zone.d_high + reach)).any():
            continue
        stop = zone.begin_m - STAND_SHORT_M
        if stop > situation.front_m - 1.0:
            option.cost += BLOCKED_COST
            if stop < option.stop_m:
                option.stop_m, option.why = stop, f'blocked by {zone.name}'
        elif abs(situation.d) > 1.0:
            # It is past the point where it could stop: cutting in front of the obstacle is no way.
            option.cost += CUTS_IN_COST
        return
