"""Scores of one drive and of many, after Bench2Drive (spec 4.1, 4.2); reimplemented from the formulas."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from raw2drive_ros.simulation.scenario import load_scenarios

COEFFICIENTS = {
    'collision_pedestrian': 0.50,
    'collision_vehicle': 0.60,
    'collision_static': 0.65,
    'red_light': 0.70,
    'yield_emergency': 0.70,
    'stop_sign': 0.80,
}
BOOTSTRAP_SAMPLES = 2000
ABILITIES = ('Merging', 'Overtaking', 'EmergencyBrake', 'GiveWay', 'TrafficSign')


@dataclass(frozen=True, slots=True)
class RouteResult:
    """One route's row. route_completion, driving_score: [0, 100]. infraction_score: [0, 1].
    infractions: name -> count, and the failure that ended the drive, if one did. signs_obeyed: through the
    first junction without running a light or a stop sign (the Traffic Sign ability's extra credit)."""

    id: str
    type: str
    seed: int
    route_completion: float
    infraction_score: float
    driving_score: float
    success: bool
    infractions: dict[str, int]
    signs_obeyed: bool = False

    def to_json(self) -> dict[str, Any]:
        return asdict(self)


def infraction_score(events: dict[str, int], outside_percent: float) -> float:
    """Product of the coefficients of all events, times the share of the way inside the route's lanes."""
    score = 1.0 - outside_percent / 100.0
    for name, count in events.items():
        score *= COEFFICIENTS.get(name, 1.0) ** count
    return score


def score_route(
    scenario: str,
    seed: int,
    completion: float,
    events: dict[str, int],
    failure: str,
    outside_percent: float,
    *,
    signs_obeyed: bool = False,
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
        signs_obeyed,
    )


def bootstrap(values: Sequence[float], seed: int = 0) -> dict[str, float]:
    """Mean and the 95 % percentile interval over routes."""
    data = np.asarray(values, np.float64)
    rng = np.random.default_rng(seed)
    means = data[rng.integers(0, len(data), (BOOTSTRAP_SAMPLES, len(data)))].mean(axis=1)
    low, high = np.percentile(means, [2.5, 97.5])
    return {'mean': float(data.mean()), 'low': float(low), 'high': float(high)}


def abilities_of(routes: Sequence[RouteResult]) -> dict[str, dict[str, float]]:
    """Success in percent per ability with its interval, and `mean` over the five, where all five are driven.

    A type counts for each of its abilities. For TrafficSign a failed route succeeds too when it got
    through its first junction and broke no light or stop sign (spec 4.6).
    """
    by_ability: dict[str, list[float]] = {name: [] for name in ABILITIES}
    known = load_scenarios()
    for route in routes:
        for ability in known[route.type].abilities if route.type in known else ():
            good = route.success or (ability == 'TrafficSign' and route.signs_obeyed)
            by_ability[ability].append(100.0 * good)
    found = {name: bootstrap(values) for name, values in by_ability.items() if values}
    if len(found) == len(ABILITIES):
        found['mean'] = {'mean': float(np.mean([v['mean'] for v in found.values()]))}
    return found


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
        'abilities': abilities_of(routes),
        'timing': timing,
    }
