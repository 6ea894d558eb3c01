"""What files of results say: means over routes, two drivers on the same routes, and which routes are flaky.

The unit of every interval is the ROUTE (type, seed): repetitions of one route are not independent, so they are
averaged first. A route that was wanted and has no row counts as zero.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from raw2drive_ros.errors import ResultsError
from raw2drive_ros.evaluation.metrics import ABILITIES, bootstrap
from raw2drive_ros.simulation.route_id import RouteId
from raw2drive_ros.simulation.scenario import load_scenarios

Row = dict[str, Any]
Unit = tuple[str, int]
# (name in results, unit of one drive's value); undefined values of the last two are left out, not zero.
SCORES: dict[str, Callable[[Row], float]] = {
    'driving_score': lambda row: row['driving_score'],
    'success_rate': lambda row: 100.0 * row['success'],
    'route_completion': lambda row: row['route_completion'],
}
OPTIONAL = ('efficiency', 'comfort')
NUMBERS = ('route_completion', 'infraction_score', 'driving_score')
FLIPS = 10_000
SIGNIFICANT = 0.05


class Results(NamedTuple):
    """header: the file's first record. rows: by finished drive, in the order of the wanted routes."""

    header: Row
    rows: list[Row]

    @property
    def driver(self) -> str:
        return str(self.header['driver'])

    @property
    def wanted(self) -> list[RouteId]:
        return [RouteId.parse(text) for text in self.header['routes']]

    @property
    def missing(self) -> list[RouteId]:
        """Wanted routes without a row: they count as zero."""
        done = {id_of(row) for row in self.rows}
        return [route for route in self.wanted if route not in done]

    def by_id(self) -> dict[RouteId, Row | None]:
        found = {id_of(row): row for row in self.rows}
        return {route: found.get(route) for route in self.wanted}


def id_of(row: Row) -> RouteId:
    return RouteId.parse(row['id'])


def read_results(path: Path) -> Results:
    """A file that `raw2drive evaluate --out` wrote or is writing: a torn last line is left out, the later of two rows
    of one route counts. Raises ResultsError."""
    try:
        lines = path.read_text(encoding='utf-8').splitlines()
    except (OSError, UnicodeDecodeError) as error:
        raise ResultsError(f'{path}: cannot be read: {error}') from error
    records: list[Row] = []
    for number, line in enumerate(lines, 1):
        try:
            record = json.loads(line)
            records.append(_checked_row(record) if records else _checked_header(record))
        except (ValueError, TypeError, KeyError, AttributeError) as error:
            if isinstance(error, json.JSONDecodeError) and number == len(lines) and records:
                continue
            raise ResultsError(f'{path}: line {number} is not a result: {type(error).__name__}: {error}') from error
    if not records:
        raise ResultsError(f'{path}: is empty')
    header, *rows = records
    found = {id_of(row): row for row in rows}
    wanted = dict.fromkeys(Results(header, []).wanted)
    if strange := [str(route) for route in found if route not in wanted]:
        raise ResultsError(f'{path}: holds {strange[0]}, which is not among the routes that its header lists')
    return Results(header, [found[route] for route in wanted if route in found])


def _checked_header(record: Row) -> Row:
    if not isinstance(record['routes'], list) or not record['routes']:
        raise ValueError('routes: not a list of route ids')
    for text in record['routes']:
        RouteId.parse(text)
    return record | {name: str(record[name]) for name in ('driver', 'suite', 'version')}


def _checked_row(record: Row) -> Row:
    RouteId.parse(record['id'])
    for name in (*NUMBERS, *OPTIONAL, 'duration_s', 'reward'):
        if name in OPTIONAL and record.get(name) is None:
            continue
        if not math.isfinite(value := record[name]):
            raise ValueError(f'{name}: {value} is not finite')
    if not isinstance(record['success'], bool):
        raise TypeError('success: neither true nor false')
    if not all(isinstance(count, int) for count in record['infractions'].values()):
        raise TypeError('infractions: not a table of counts')
    return record | {'failure': str(record['failure']), 'signs_obeyed': bool(record['signs_obeyed'])}


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
    """Is A better than B on the routes that both were to drive? Per score: the paired difference A - B as an
    estimate, the p-value of a sign-flip permutation test, and a verdict yes, no or undecided.

    Raises ResultsError when suite or version differ, or no route is common.
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
