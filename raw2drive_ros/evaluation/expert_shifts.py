"""Shifts to the side: from where the ego is, in the direction in which it drives, to another lateral offset.

A shift that has begun is kept: planned anew at every decision it would never end.
"""

from __future__ import annotations

import math

import numpy as np

from raw2drive_ros.contracts.public import Float64
from raw2drive_ros.evaluation.expert_situation import Anchor, Situation

LEAST_SHIFT_M = 9.0
# The shift is planned anew where the ego is farther off it than this, or heads for another place.
OFF_SHIFT_M, SAME_TARGET_M, COMPARED_AHEAD_M = 0.45, 0.35, 20.0


def shift_m(situation: Situation, across_m: float) -> float:
    """Length (m) of a shift to the side by `across_m`."""
    seconds = 1.0 + 0.75 * math.sqrt(abs(across_m))
    return max(LEAST_SHIFT_M * min(1.0, abs(across_m) / 2.0 + 0.3), situation.speed * seconds)


def shifted(situation: Situation, target: Float64, over_m: float) -> tuple[Float64, Anchor]:
    """((G,) lateral offsets that lead to `target` within `over_m`, where this shift began)."""
    kept = _kept(situation, target)
    if kept is not None:
        return _offsets(kept, situation.grid, target), kept
    new = Anchor(situation.s, situation.d, situation.slope, over_m, situation.grid, target)
    return _offsets(new, situation.grid, target), new


def _kept(situation: Situation, target: Float64) -> Anchor | None:
    """The shift that the ego is in, if it leads to the same place."""
    anchor = situation.anchor
    if anchor is None or situation.s > anchor.s_m + anchor.over_m:
        return None
    ahead = situation.s + COMPARED_AHEAD_M
    before = float(np.interp(ahead, anchor.stations, anchor.target))
    if abs(float(np.interp(ahead, situation.grid, target)) - before) > SAME_TARGET_M:
        return None
    here = float(np.interp(situation.s, situation.grid, _offsets(anchor, situation.grid, target)))
    return anchor if abs(here - situation.d) < OFF_SHIFT_M else None


def _offsets(anchor: Anchor, grid: Float64, target: Float64) -> Float64:
    along = grid - anchor.s_m
    u = np.minimum(np.maximum(along / max(anchor.over_m, 0.1), 0.0), 1.0)
    onto = 3.0 * u**2 - 2.0 * u**3
    own = anchor.d_m + anchor.slope * along * (1.0 - u) ** 2
    return np.where(along < 0.0, anchor.d_m, own + (target - anchor.d_m) * onto)


def later(base: Float64, target: Float64, grid: Float64, start_m: float, over_m: float) -> Float64:
    """(G,) `base`, then `target` from `start_m + over_m` on."""
    u = np.minimum(np.maximum((grid - start_m) / max(over_m, 0.1), 0.0), 1.0)
    return base + (target - base) * (3.0 * u**2 - 2.0 * u**3)
