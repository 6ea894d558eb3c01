"""The ways along the road that the expert considers: lateral offsets from the route over the stretch ahead."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from raw2drive_ros.contracts.public import Float64
from raw2drive_ros.evaluation.expert_map import FORWARD, ONCOMING
from raw2drive_ros.evaluation.expert_situation import (
    AHEAD_M,
    CLEAR_M,
    CLEAR_SOFT_M,
    HALF_LENGTH_M,
    HALF_WIDTH_M,
    Situation,
    Zone,
    is_forward,
    lane_kind,
    lane_profile,
)

# Short of a wreck, so that there is room to steer out.
STAND_SHORT_M = 8.0
LEAST_SHIFT_M = 9.0
# A car further to the side than this is in another lane.
ANOTHER_LANE_M = 0.8
KEEP_FOR_M = (20.0, 45.0, 80.0)
WALL_SHORT_M = 4.0
EMERGENCY_BEHIND_M = 70.0
NEAR_SIDE_M = 1.3
IN_THE_WAY_COST = 30.0
# The route is lost where the own lane is farther from it than this many lanes.
LOST_LANES = 1.3


@dataclass(slots=True)
class Option:
    """offset: (G,) lateral offset from the route. stop_m: where the front has to stop, inf without. why: reason of
    the stop. cost: metres of progress that it has to be better by. oncoming: uses a lane of oncoming traffic."""

    name: str
    offset: Float64
    stop_m: float = math.inf
    why: str = ''
    cost: float = 0.0
    oncoming: bool = False
    begins_m: float = -math.inf

    @property
    def family(self) -> str:
        """Options of one family are the same intention."""
        return 'route' if self.name.startswith('aside') else self.name.split()[0]


def options(situation: Situation, blocked: list[Zone]) -> list[Option]:
    """The route itself first, then what else the road and the situation offer."""
    found = [_route(situation)]
    own = lane_profile(situation, 0)
    found += _own_lane(situation, own)
    blocked = [zone for zone in blocked if zone.end_m > situation.s - HALF_LENGTH_M]
    if blocked:
        found += _past(situation, blocked[0])
    hurried = _emergency_behind(situation)
    if blocked or hurried is not None or _slow_leader(situation):
        for side, name in ((1, 'left'), (-1, 'right')):
            found += _lane_beside(situation, side, name, hurried=hurried is not None)
    found += _small_shifts(situation)
    for option in found:
        _hold(situation, option, blocked)
        if (
            hurried is not None
            and abs(float(np.interp(situation.s + 35.0, situation.grid, option.offset)) - hurried) < 2.2
        ):
            option.cost += IN_THE_WAY_COST
    return found


def shift_m(situation: Situation, across_m: float) -> float:
    """Length (m) of a shift to the side by `across_m`."""
    seconds = 1.1 + 0.75 * math.sqrt(abs(across_m))
    return max(LEAST_SHIFT_M * min(1.0, abs(across_m) / 2.0 + 0.3), situation.speed * seconds)


def blend(situation: Situation, target: Float64, over_m: float) -> Float64:
    """(G,) from where the ego is, in its direction, to `target` within `over_m`."""
    along = situation.grid - situation.s
    u = np.minimum(np.maximum(along / over_m, 0.0), 1.0)
    onto = 3.0 * u**2 - 2.0 * u**3
    own = situation.d + situation.slope * along * (1.0 - u) ** 2
    return np.where(along < 0.0, situation.d, own + (target - situation.d) * onto)


def later(base: Float64, target: Float64, grid: Float64, start_m: float, over_m: float) -> Float64:
    """(G,) `base`, then `target` from `start_m + over_m` on."""
    u = np.minimum(np.maximum((grid - start_m) / max(over_m, 0.1), 0.0), 1.0)
    return base + (target - base) * (3.0 * u**2 - 2.0 * u**3)


def _route(situation: Situation) -> Option:
    target = np.zeros_like(situation.grid)
    return Option('route', blend(situation, target, shift_m(situation, situation.d)))


def _own_lane(situation: Situation, own: tuple[Float64, float] | None) -> list[Option]:
    """Stay in the lane where the route leaves it, and follow the route later, or where the ego is off it."""
    if own is None:
        return []
    profile, ends = own
    ahead = (situation.grid > situation.s) & (situation.grid < situation.s + 110.0)
    if np.abs(profile[ahead]).max() < ANOTHER_LANE_M:
        return []
    lost = ahead & (np.abs(profile) > LOST_LANES * situation.lanes.width_m)
    if lost.any():
        ends = min(ends, float(situation.grid[lost][0]))
    stay = blend(
        situation, profile, shift_m(situation, situation.d - float(np.interp(situation.s, situation.grid, profile)))
    )
    found = []
    if ends > situation.front_m + 2.0:
        found.append(Option('keep', stay, ends - WALL_SHORT_M, 'end of the lane', cost=10.0))
    for metres in KEEP_FOR_M:
        start = situation.s + metres
        over = max(18.0, 2.4 * situation.speed)
        if start + over > ends + 5.0:
            continue
        if float(np.abs(np.interp(start, situation.grid, profile))) < ANOTHER_LANE_M:
            continue
        found.append(
            Option(
                f'keep {metres:.0f}',
                later(stay, np.zeros_like(stay), situation.grid, start, over),
                ends - WALL_SHORT_M if start > ends - WALL_SHORT_M else math.inf,
                'end of the lane',
                cost=2.0 + 0.06 * metres,
            )
        )
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
        if across > room + 0.1:
            if kinds == {FORWARD}:
                across = max(across, width) if across > 1.4 else across
            elif ONCOMING in kinds and FORWARD not in kinds and side > 0:
                oncoming = True
            else:
                continue
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
        offset = blend(
            situation, target, max(min(shift_m(situation, across_m - situation.d), out_by - situation.s), 5.0)
        )
    else:
        straight = blend(situation, np.zeros_like(grid), shift_m(situation, situation.d))
        offset = later(straight, target, grid, start, over)
    if back_from > situation.s or oncoming:
        offset = later(offset, np.zeros_like(grid), grid, max(back_from, situation.s), max(12.0, 0.8 * over))
    name = f'pass {"left" if across_m > 0.0 else "right"}'
    cost = 2.0 if abs(across_m) < 0.5 * width else 3.0
    return Option(name, offset, cost=cost + 2.0 * oncoming, oncoming=oncoming, begins_m=start)


def _lane_beside(situation: Situation, side: int, name: str, *, hurried: bool) -> list[Option]:
    profile = lane_profile(situation, side)
    if profile is None:
        return []
    offset, ends = profile
    across = float(np.interp(situation.s, situation.grid, offset)) - situation.d
    if ends < situation.s + 40.0:
        return []
    away = float(np.abs(offset[situation.grid > situation.s]).mean()) > ANOTHER_LANE_M
    moved = blend(situation, offset, max(shift_m(situation, across), 14.0))
    return [Option(name, moved, ends - WALL_SHORT_M, 'end of the lane', cost=(0.0 if hurried else 5.0) * away)]


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
    if abs(situation.d) > ANOTHER_LANE_M + 0.7:
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
        moved = blend(situation, target, max(shift_m(situation, across - situation.d), 8.0))
        found.append(Option(f'aside {across:+.1f}', moved, cost=0.6 + 0.6 * abs(across)))
    return found


def _hold(situation: Situation, option: Option, blocked: list[Zone]) -> None:
    """An option that runs into a fixed obstacle has to stop well short of it."""
    for zone in blocked:
        at = float(np.interp(zone.begin_m, situation.grid, option.offset))
        if zone.begin_m > situation.s + AHEAD_M or zone.speed > 0.3:
            continue
        if zone.d_low - HALF_WIDTH_M - 0.2 < at < zone.d_high + HALF_WIDTH_M + 0.2:
            stop = zone.begin_m - STAND_SHORT_M
            if stop > situation.front_m - 1.0 and stop < option.stop_m:
                option.stop_m, option.why = stop, f'blocked by {zone.name}'
            return
