"""Scores of one drive and of many, after Bench2Drive (spec 4.1, 4.2); reimplemented from the formulas."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

COEFFICIENTS = {
    'collision_pedestrian': 0.50,
    'collision_vehicle': 0.60,
    'collision_static': 0.65,
    'red_light': 0.70,
    'yield_emergency': 0.70,
    'stop_sign': 0.80,
}
BOOTSTRAP_SAMPLES = 2000


@dataclass(frozen=True, slots=True)
class RouteResult:
    """One route's row. route_completion, driving_score: [0, 100]. infraction_score: [0, 1].
    infractions: name -> count, and the failure that ended the drive, if one did."""

    id: str
    type: str
    seed: int
    route_completion: float
    infraction_score: float
    driving_score: float
    success: bool
    infractions: dict[str, int]

    def to_json(self) -> dict[str, Any]:
        return asdict(self)


def infraction_score(events: dict[str, int], outside_percent: float) -> float:
    """Product of the coefficients of all events, times the share of the way inside the route's lanes."""
    score = 1.0 - outside_percent / 100.0
    for name, count in events.items():
        score *= COEFFICIENTS.get(name, 1.0) ** count
    return score


def score_route(
    scenario: str, seed: int, completion: float, events: dict[str, int], failure: str, outside_percent: float
) -> RouteResult:
    """Success: the whole route, no infraction, no failure."""
    score = infraction_score(events, outside_percent)
    infractions = dict(events)
    if failure:
        infractions[failure] = 1
    if outside_percent > 0:
        infractions['outside_lanes'] = 1
    return RouteResult(
        f'{scenario}/{seed}',
        scenario,
        seed,
        round(completion, 4),
        round(score, 6),
        round(max(0.0, completion * score), 4),
        completion >= 100.0 and not infractions,
        infractions,
    )


def bootstrap(values: Sequence[float], seed: int = 0) -> dict[str, float]:
    """Mean and the 95 % percentile interval over routes."""
    data = np.asarray(values, np.float64)
    rng = np.random.default_rng(seed)
    means = data[rng.integers(0, len(data), (BOOTSTRAP_SAMPLES, len(data)))].mean(axis=1)
    low, high = np.percentile(means, [2.5, 97.5])
    return {'mean': float(data.mean()), 'low': float(low), 'high': float(high)}


def summarise(
    driver: str, suite: str, version: str, routes: Sequence[RouteResult], timing: dict[str, Any]
) -> dict[str, Any]:
    """The one form of results for machines."""
    return {
        'driver': driver,
        'suite': suite,
        'version': version,
        'routes': [route.to_json() for route in routes],
        'summary': {
            'driving_score': bootstrap([r.driving_score for r in routes]),
            'success_rate': bootstrap([100.0 * r.success for r in routes]),
            'route_completion': bootstrap([r.route_completion for r in routes]),
        },
        'timing': timing,
    }
