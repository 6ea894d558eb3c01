"""Statistics of results files: means over routes, two drivers compared on the same routes, flaky routes.

The unit of every interval is the ROUTE (type, seed): repetitions of one route are not independent, so they are
averaged first. A wanted route without a row counts as zero.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from typing import Any

import numpy as np

from raw2drive_ros.contracts.errors import ResultsError
from raw2drive_ros.evaluation.metrics import ABILITIES, RouteResult, bootstrap
from raw2drive_ros.evaluation.results import OPTIONAL, Results, Row, id_of
from raw2drive_ros.simulation.route_id import RouteId
from raw2drive_ros.simulation.scenario import load_scenarios

Unit = tuple[str, int]
# Score -> its value for one drive, in percent. The scores named in `OPTIONAL` are apart: undefined values of those are
# left out and do not count as zero.
SCORES: dict[str, Callable[[Row], float]] = {
    'driving_score': lambda row: row['driving_score'],
    'success_rate': lambda row: 100.0 * row['success'],
    'route_completion': lambda row: row['route_completion'],
}
FLIPS = 10_000
SIGNIFICANT = 0.05


def _units(pairs: Iterable[tuple[RouteId, float | None]]) -> dict[Unit, float]:
    """The mean of the defined values of each route."""
    found: dict[Unit, list[float]] = {}
    for route, value in pairs:
        if value is not None:
            found.setdefault((route.type, route.seed), []).append(value)
    return {unit: float(np.mean(values)) for unit, values in found.items()}


def estimate(pairs: Iterable[tuple[RouteId, float | None]]) -> dict[str, float] | None:
    """mean, and its 95 % interval low ... high over `routes` routes; None when no value is defined."""
    units = list(_units(pairs).values())
    return bootstrap(units) | {'routes': len(units)} if units else None


def summary(results: Results) -> dict[str, Any]:
    """Estimates of every score. `defined`: in how many drives efficiency and comfort have a value."""
    rows = results.by_id()
    found: dict[str, Any] = {
        name: estimate((route, value(row) if row else 0.0) for route, row in rows.items())
        for name, value in SCORES.items()
    }
    for name in OPTIONAL:
        found[name] = estimate((route, row.get(name) if row else None) for route, row in rows.items())
    defined = {name: sum(row.get(name) is not None for row in results.rows) for name in OPTIONAL}
    reward = estimate((id_of(row), row['reward']) for row in results.rows)
    return found | {'reward': reward, 'defined': defined, 'wanted': len(rows), 'driven': len(results.rows)}


def by_type(results: Results) -> dict[str, dict[str, float]]:
    """Scenario type -> drives wanted, successes, mean driving score (missing drives are zero)."""
    found: dict[str, list[Row | None]] = {}
    for route, row in results.by_id().items():
        found.setdefault(route.type, []).append(row)
    return {
        name: {
            'drives': len(rows),
            'successes': sum(row['success'] for row in rows if row),
            'driving_score': sum(row['driving_score'] for row in rows if row) / len(rows),
        }
        for name, rows in sorted(found.items())
    }


def by_ability(results: Results) -> dict[str, dict[str, float]]:
    """Estimates of the success rate per ability, and `mean` over the five where all are driven; the rule is
    Bench2Drive's: for TrafficSign a failed drive counts too when it obeyed its signs."""
    known = load_scenarios()
    found: dict[str, dict[str, float]] = {}
    for ability in ABILITIES:
        value = estimate(
            (route, 100.0 * bool(row and (row['success'] or (ability == 'TrafficSign' and row['signs_obeyed']))))
            for route, row in results.by_id().items()
            if route.type in known and ability in known[route.type].abilities
        )
        if value is not None:
            found[ability] = value
    if len(found) == len(ABILITIES):
        found['mean'] = {'mean': float(np.mean([value['mean'] for value in found.values()]))}
    return found


def flaky(results: Results) -> list[dict[str, Any]]:
    """Routes whose finished repetitions disagree on success."""
    found: dict[Unit, list[bool]] = {}
    for row in results.rows:
        route = id_of(row)
        found.setdefault((route.type, route.seed), []).append(row['success'])
    return [
        {'type': kind, 'seed': seed, 'successes': sum(values), 'drives': len(values)}
        for (kind, seed), values in found.items()
        if 0 < sum(values) < len(values)
    ]


def infractions(results: Results) -> dict[str, int]:
    """Infraction or failure -> how often, most frequent first; an error's text is left out."""
    found: dict[str, int] = {}
    for row in results.rows:
        failure = row['failure'].partition(':')[0]
        counts = (
            row['infractions'] if failure in row['infractions'] or not failure else {**row['infractions'], failure: 1}
        )
        for name, count in counts.items():
            found[name] = found.get(name, 0) + count
    return dict(sorted(found.items(), key=lambda entry: (-entry[1], entry[0])))


def compare(a: Results, b: Results) -> dict[str, Any]:
    """Is A better than B on the routes that both should drive? Per score: the paired difference A - B as an
    estimate, the p-value of a sign-flip permutation test, and a verdict yes, no or undecided.

    Raises ResultsError when suite or version differ, or when there is no common route.
    """
    for name in ('suite', 'version'):
        if a.header[name] != b.header[name]:
            raise ResultsError(
                f'{a.driver} has {name} {a.header[name]!r} and {b.driver} {b.header[name]!r}: not comparable'
            )
    rows_a, rows_b = a.by_id(), b.by_id()
    common = [route for route in rows_a if route in rows_b]
    if not common:
        raise ResultsError(f'{a.driver} and {b.driver} have no route in common')
    found: dict[str, Any] = {'common': len(common), 'not_common': len(set(rows_a) ^ set(rows_b))}
    for name in ('driving_score', 'success_rate'):
        value = SCORES[name]
        units = _units(
            (route, (value(ra) if (ra := rows_a[route]) else 0.0) - (value(rb) if (rb := rows_b[route]) else 0.0))
            for route in common
        )
        differences = list(units.values())
        interval, p = bootstrap(differences), sign_flip_p(differences)
        found[name] = {**interval, 'routes': len(units), 'p': p, 'verdict': verdict(interval, p)}
    return found


def sign_flip_p(differences: Sequence[float], seed: int = 0) -> float:
    """Two-sided: how often does a mean with random signs get as far from zero as the observed one?"""
    data = np.asarray(differences, np.float64)
    signs = np.random.default_rng(seed).choice((-1.0, 1.0), (FLIPS, len(data)))
    means = np.abs(signs @ data)
    return float((1 + np.sum(means >= abs(data.sum()) - 1e-9)) / (1 + FLIPS))


def verdict(interval: dict[str, float], p: float) -> str:
    """yes: A is better. Interval and test have to agree, because the interval of few routes is too narrow."""
    if p >= SIGNIFICANT or interval['low'] <= 0.0 <= interval['high']:
        return 'undecided'
    return 'yes' if interval['low'] > 0.0 else 'no'


def summarise(
    driver: str,
    suite: str,
    version: str,
    routes: Sequence[RouteId],
    rows: Sequence[RouteResult],
    timing: dict[str, Any],
) -> dict[str, Any]:
    """Results as one dictionary for JSON. Routes without a row count as zero and are listed under `missing`."""
    header = {'driver': driver, 'suite': suite, 'version': version}
    results = Results(header | {'routes': [str(route) for route in routes]}, [row.to_json() for row in rows])
    return {
        **header,
        'routes': [row for row in results.by_id().values() if row is not None],
        'missing': [str(route) for route in results.missing],
        'summary': summary(results),
        'abilities': by_ability(results),
        'flaky': flaky(results),
        'timing': timing,
    }


def timing_of(tick_ms: list[float], lost: int = 0) -> dict[str, Any]:
    """p50 and p99 of the tick times (ms), and the ticks per second that their mean allows."""
    if not tick_ms:
        return {'tick_ms': {'p50': None, 'p99': None}, 'ticks_per_s': None, 'messages_lost': lost}
    p50, p99 = np.percentile(tick_ms, [50, 99])
    rate = 1000.0 / float(np.mean(tick_ms))
    return {
        'tick_ms': {'p50': round(float(p50), 3), 'p99': round(float(p99), 3)},
        'ticks_per_s': round(rate, 1),
        'messages_lost': lost,
    }
