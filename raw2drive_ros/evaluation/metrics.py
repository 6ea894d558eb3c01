"""Scores of one drive, as Bench2Drive defines them; reimplemented from the formulas."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np

from raw2drive_ros.simulation.route_id import RouteId

COEFFICIENTS = {
    'collision_pedestrian': 0.50,
    'collision_vehicle': 0.60,
    'collision_static': 0.65,
    'red_light': 0.70,
    'yield_emergency': 0.70,
    'scenario_timeout': 0.70,
    'forced_braking': 0.70,
    'stop_sign': 0.80,
}
BOOTSTRAP_SAMPLES = 2000
ABILITIES = ('Merging', 'Overtaking', 'EmergencyBrake', 'GiveWay', 'TrafficSign')
EFFICIENCY_LIMIT_PERCENT = 1000.0
NO_TRAFFIC_COMPAT_PERCENT = 100.0


@dataclass(frozen=True, slots=True)
class RouteResult:
    """One route's row. route_completion, driving_score: [0, 100]. infraction_score: [0, 1].
    infractions: name -> count, and the failure that ended the drive, if one did. signs_obeyed: through the first
    junction without running a light or a stop sign (the Traffic Sign ability's extra credit). reward: sum over the
    drive. efficiency: mean speed in percent of the traffic's; comfort: percent of comfortable segments; None where
    undefined. limit_s: time limit of the drive; None in older files, and where there was none. reference_s: the time
    of the driver that the limit was set from; None where it is not known. twin: the drive without the event.
    needless_stop_s: the longest time for which the ego stood without a reason; None in older files."""

    id: str
    type: str
    seed: int
    weather: str
    repetition: int
    route_completion: float
    infraction_score: float
    driving_score: float
    success: bool
    infractions: dict[str, int] = field(default_factory=dict)
    signs_obeyed: bool = False
    failure: str = ''
    duration_s: float = 0.0
    reward: float = 0.0
    efficiency: float | None = None
    comfort: float | None = None
    limit_s: float | None = None
    reference_s: float | None = None
    twin: bool = False
    needless_stop_s: float | None = None

    def to_json(self) -> dict[str, Any]:
        return asdict(self)


def infraction_score(events: dict[str, int], outside_percent: float) -> float:
    """Product of the coefficients of all events, times the share of the way inside the route's lanes."""
    score = 1.0 - outside_percent / 100.0
    for name, count in events.items():
        score *= COEFFICIENTS.get(name, 1.0) ** count
    return score


def efficiency_percent(percents: Sequence[float], *, bench2drive_compat: bool = False) -> float | None:
    """Mean of a route's speed checkpoints, values above 1000 % left out. Without traffic to compare with it is
    undefined (None); Bench2Drive then counts 100 % (`bench2drive_compat`)."""
    kept = [percent for percent in percents if percent <= EFFICIENCY_LIMIT_PERCENT]
    if not kept:
        return NO_TRAFFIC_COMPAT_PERCENT if bench2drive_compat else None
    return float(np.mean(kept))


def score_route(
    route: RouteId,
    completion: float,
    events: dict[str, int],
    failure: str,
    outside_percent: float,
    *,
    signs_obeyed: bool = False,
    duration_s: float = 0.0,
    reward: float = 0.0,
    efficiency: float | None = None,
    comfort: float | None = None,
    limit_s: float | None = None,
    needless_stop_s: float | None = None,
) -> RouteResult:
    """The row of one drive, rounded as it is stored. Success: the whole route, no infraction, no failure."""
    score = infraction_score(events, outside_percent)
    infractions = dict(events)
    if failure:
        infractions[failure] = 1
    if outside_percent > 0:
        infractions['outside_lanes'] = 1
    return RouteResult(
        str(route),
        route.type,
        route.seed,
        route.weather,
        route.repetition,
        round(completion, 4),
        round(score, 6),
        round(max(0.0, completion * score), 4),
        completion >= 100.0 and not infractions,
        infractions,
        signs_obeyed,
        failure,
        round(duration_s, 2),
        round(reward, 4),
        None if efficiency is None else round(efficiency, 3),
        None if comfort is None else round(comfort, 3),
        None if limit_s is None or math.isinf(limit_s) else round(limit_s, 2),
        twin=route.twin,
        needless_stop_s=None if needless_stop_s is None else round(needless_stop_s, 2),
    )


def failed_route(route: RouteId, reason: str) -> RouteResult:
    """The row of a drive that raised an error: score zero, with the reason."""
    return score_route(route, 0.0, {}, f'error: {reason}', 0.0)


def bootstrap(values: Sequence[float], seed: int = 0) -> dict[str, float]:
    """Mean and the 95 % percentile interval over routes."""
    data = np.asarray(values, np.float64)
    rng = np.random.default_rng(seed)
    means = data[rng.integers(0, len(data), (BOOTSTRAP_SAMPLES, len(data)))].mean(axis=1)
    low, high = np.percentile(means, [2.5, 97.5])
    return {'mean': float(data.mean()), 'low': float(low), 'high': float(high)}
