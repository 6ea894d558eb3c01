"""Defensive speeds: past people who might step out, and past cars and walls that somebody may come out from behind.

The ego may be so fast that it can still stop once somebody starts towards its lane: with a time `tau` until that person
is in the way and braking `b` after a reaction time `r`, that is v <= 2 b (tau - r).
"""

from __future__ import annotations

import math

import numpy as np

from raw2drive_ros.contracts.public import Float64
from raw2drive_ros.evaluation.expert_belief import STANDING_MPS
from raw2drive_ros.evaluation.expert_situation import HALF_LENGTH_M, HALF_WIDTH_M, Situation

STEP_OUT_MPS = 1.7
BRAKES_MPS2, REACTION_S = 7.0, 0.3
LEAST_MPS, LEAST_HIDDEN_MPS = 3.5, 6.0
WATCHED_M = 70.0
# Of a walker seen standing: towards the road within this angle of the way across.
FACING_COS = 0.5
ASIDE_M = 5.0
SEEN_EARLY_M = {True: 0.2, False: 0.6}
TALL_M = 1.9
# Speed between cones, which grows with the clearance.
NARROW_MPS, NARROW_M = 3.5, 1.1
APPROACH_MPS2 = 2.5


def speed_caps(situation: Situation, offsets: Float64) -> Float64:
    """(O, G) highest speed on each option (O, G) at each station of the grid; inf where nothing calls for caution."""
    grid = situation.grid
    caps = np.full(offsets.shape, np.inf)
    view = situation.forecast
    seen: set[int] = set()
    for i, h in enumerate(view.hypotheses):
        track = h.track
        s, d = float(view.s[i, 0]), float(view.d[i, 0])
        if track.number in seen or not -4.0 < s - situation.s < WATCHED_M or abs(d) > ASIDE_M + 2.0:
            continue
        seen.add(track.number)
        half = float(view.half_d[i, 0])
        index = min(max(round(s - grid[0]), 0), len(grid) - 1)
        clear = np.abs(d - offsets[:, index]) - half - HALF_WIDTH_M
        if track.kind in ('walker', 'cyclist') and track.speed < STANDING_MPS:
            if _faces_road(float(view.turned[i, 0]), d):
                speed = _speed(clear / STEP_OUT_MPS, LEAST_MPS)
                _apply(caps, grid, speed, clear, s - HALF_LENGTH_M, s + 1.0)
        elif track.fixed and track.kind not in ('barrier', 'cone', 'door', 'board'):
            early = SEEN_EARLY_M[track.height_m > TALL_M]
            speed = _speed((clear + early) / STEP_OUT_MPS, LEAST_HIDDEN_MPS)
            far = s + float(view.half_s[i, 0])
            _apply(caps, grid, speed, clear, far - HALF_LENGTH_M - 2.0, far + 0.5)
        elif track.fixed:
            half_s = float(view.half_s[i, 0])
            _apply(caps, grid, NARROW_MPS + 4.0 * clear, clear, s - half_s - HALF_LENGTH_M, s + half_s, NARROW_M)
    return _approached(caps, grid)


def _speed(tau_s: Float64, least_mps: float) -> Float64:
    return np.maximum(2.0 * BRAKES_MPS2 * (tau_s - REACTION_S), least_mps)


def _faces_road(turned_rad: float, d_m: float) -> bool:
    return math.sin(turned_rad) * math.copysign(1.0, -d_m) > FACING_COS


def _apply(
    caps: Float64,
    grid: Float64,
    speed: Float64,
    clear: Float64,
    begin_m: float,
    end_m: float,
    within_m: float = ASIDE_M,
) -> None:
    """Cap the options that pass on the side (clear > 0); in the way it is no question of caution."""
    low, high = np.searchsorted(grid, (begin_m, end_m))
    if high <= low:
        return
    for row in np.flatnonzero((clear > 0.0) & (clear < within_m)).tolist():
        caps[row, low:high] = np.minimum(caps[row, low:high], speed[row])


def _approached(caps: Float64, grid: Float64) -> Float64:
    """The caps with the braking distance before them."""
    if not np.isfinite(caps).any():
        return caps
    step = float(grid[1] - grid[0])
    squares = caps**2
    for i in range(caps.shape[1] - 2, -1, -1):
        np.minimum(squares[:, i], squares[:, i + 1] + 2.0 * APPROACH_MPS2 * step, out=squares[:, i])
    return np.sqrt(squares)
