"""Statistics of results files: means over routes, two drivers compared on the same routes, flaky routes.

The unit of every interval is the ROUTE (type, seed): repetitions of one route are not independent, so they are
averaged first. A wanted route without a row counts as zero.

Where a route is a pair of drives, the scores that Bench2Drive has are those of the event; `pairs` has the others. A
file of twins alone is scored by its twins.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from typing import Any

import numpy as np

from raw2drive_ros.contracts.errors import ResultsError
from raw2drive_ros.evaluation.metrics import ABILITIES, RouteResult, bootstrap
from raw2drive_ros.evaluation.pairs import Pair, headline, pairs_of, pairs_won, twin_scores
from raw2drive_ros.evaluation.results import OPTIONAL, Results, Row, id_of
from raw2drive_ros.simulation.protocol import PAIRS
from raw2drive_ros.simulation.route_id import TWIN, RouteId
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
    """Estimates of every score, in percent but for driving_score, reward and time_lost_s (s).

    driving_score to reward: of the events, see `pairs.headline`. pair_success_rate: pairs of which both drives succeed;
    event_success_rate, twin_success_rate: one of them; needless_stops, time_lost_s: of the twins; all of these None
    without pairs or twins. `defined`: in how many drives efficiency and comfort have a value.
    """
    rows = headline(results)
    found: dict[str, Any] = {
        name: estimate((route, value(row) if row else 0.0) for route, row in rows.items())
        for name, value in SCORES.items()
    }
    for name, values in pair_scores(results).items():
        found[name] = estimate(values)
    for name in OPTIONAL:
        found[name] = estimate((route, row.get(name) if row else None) for route, row in rows.items())
    defined = {name: sum(row is not None and row.get(name) is not None for row in rows.values()) for name in OPTIONAL}
    reward = estimate((route, row['reward']) for route, row in rows.items() if row)
    return found | {
        'reward': reward,
        'defined': defined,
        'wanted': len(results.wanted),
        'driven': len(results.rows),
    }


def pair_scores(results: Results) -> dict[str, list[tuple[RouteId, float | None]]]:
    """Score -> its value per pair or twin, in percent (time_lost_s: seconds)."""
    pairs = pairs_of(results)

    def percent(won: Callable[[Pair], bool]) -> list[tuple[RouteId, float | None]]:
        return [(pair.route, 100.0 * won(pair)) for pair in pairs]

    return {
        'pair_success_rate': percent(lambda pair: pair.won),
        'event_success_rate': percent(lambda pair: pair.event_won),
        'twin_success_rate': percent(lambda pair: pair.twin_won),
        **twin_scores(results),
    }


def by_type(results: Results) -> dict[str, dict[str, float]]:
    """Scenario type -> drives wanted, successes, mean driving score (missing drives are zero), pairs, pairs won.

    drives, successes, driving_score: of the events, see `pairs.headline`.
    """
    found: dict[str, list[Row | None]] = {}
    for route, row in headline(results).items():
        found.setdefault(route.type, []).append(row)
    won = pairs_won(results)
    return {
        name: {
            'drives': len(rows),
            'successes': sum(row['success'] for row in rows if row),
            'driving_score': sum(row['driving_score'] for row in rows if row) / len(rows),
            'pairs': won.get(name, (0, 0))[0],
            'pairs_won': won.get(name, (0, 0))[1],
        }
        for name, rows in sorted(found.items())
    }


def by_ability(results: Results) -> dict[str, dict[str, float]]:
    """Estimates of the success rate per ability, and `mean` over the five where all are driven; the rule is
    Bench2Drive's: for TrafficSign a drive counts twice, by its success and by whether it obeyed its signs."""
    known = load_scenarios()
    found: dict[str, dict[str, float]] = {}
    for ability in ABILITIES:
        value = estimate(
            (route, _ability_percent(ability, row))
            for route, row in headline(results).items()
            if route.type in known and ability in known[route.type].abilities
        )
        if value is not None:
            found[ability] = value
    if len(found) == len(ABILITIES):
        found['mean'] = {'mean': float(np.mean([value['mean'] for value in found.values()]))}
    return found


def _ability_percent(ability: str, row: Row | None) -> float:
    if row is None:
        return 0.0
    success = bool(row['success'])
    if ability != 'TrafficSign':
        return 100.0 * success
    return 50.0 * success + 50.0 * (success or row['signs_obeyed'])


def flaky(results: Results) -> list[dict[str, Any]]:
    """Routes whose finished repetitions disagree on success."""
    found: dict[tuple[str, int, bool], list[bool]] = {}
    for row in results.rows:
        route = id_of(row)
        found.setdefault((route.type, route.seed, route.twin), []).append(row['success'])
    return [
        {'type': kind + TWIN * twin, 'seed': seed, 'successes': sum(values), 'drives': len(values)}
        for (kind, seed, twin), values in found.items()
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
    estimate, the p-value of a sign-flip permutation test, and a verdict yes, no or undecided. driving_score and
    success_rate are of the events; pair_success_rate is there where both have pairs.

    Raises ResultsError when suite, version or protocol differ, or when there is no common route.
    """
    for name in ('suite', 'version', 'protocol'):
        if a.header[name] != b.header[name]:
            raise ResultsError(
                f'{a.driver} has {name} {a.header[name]!r} and {b.driver} {b.header[name]!r}: not comparable'
            )
    rows_a, rows_b = headline(a), headline(b)
    common = [route for route in rows_a if route in rows_b]
    if not common:
        raise ResultsError(f'{a.driver} and {b.driver} have no route in common')
    found: dict[str, Any] = {'common': len(common), 'not_common': len(set(rows_a) ^ set(rows_b))}
    for name in ('driving_score', 'success_rate'):
        value = SCORES[name]
        found[name] = _difference(
            (route, (value(ra) if (ra := rows_a[route]) else 0.0) - (value(rb) if (rb := rows_b[route]) else 0.0))
            for route in common
        )
    won_a, won_b = ({pair.route: 100.0 * pair.won for pair in pairs_of(results)} for results in (a, b))
    if won_a.keys() & won_b.keys():
        found['pair_success_rate'] = _difference((r, won_a[r] - won_b[r]) for r in won_a if r in won_b)
    return found


def _difference(pairs: Iterable[tuple[RouteId, float]]) -> dict[str, Any]:
    units = _units(pairs)
    differences = list(units.values())
    interval, p = bootstrap(differences), sign_flip_p(differences)
    return {**interval, 'routes': len(units), 'p': p, 'verdict': verdict(interval, p)}


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
    protocol: str = PAIRS,
) -> dict[str, Any]:
    """Results as one dictionary for JSON. Routes without a row count as zero and are listed under `missing`."""
    header = {'driver': driver, 'suite': suite, 'version': version, 'protocol': protocol}
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
