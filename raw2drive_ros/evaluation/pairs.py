"""Pairs of drives in results: the event, and its twin in which it does not happen.

A pair is won by who succeeds on both. Twins say besides how often a driver stops for nothing, and how much time it
loses where nothing happens.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

from raw2drive_ros.evaluation.results import Results, Row
from raw2drive_ros.simulation.route_id import RouteId

# A longer stop without a reason is a needless one.
NEEDLESS_S = 1.0


@dataclass(frozen=True, slots=True)
class Pair:
    """route: of the event. event, twin: their rows; None for a drive that is missing."""

    route: RouteId
    event: Row | None
    twin: Row | None

    @property
    def event_won(self) -> bool:
        return bool(self.event and self.event['success'])

    @property
    def twin_won(self) -> bool:
        return bool(self.twin and self.twin['success'])

    @property
    def won(self) -> bool:
        return self.event_won and self.twin_won


def headline(results: Results) -> dict[RouteId, Row | None]:
    """The drives that the scores of Bench2Drive are taken from: the events, or the twins if there is nothing else."""
    rows = results.by_id()
    return {route: row for route, row in rows.items() if not route.twin} or rows


def pairs_of(results: Results) -> list[Pair]:
    """The pairs of which both drives are wanted, repetitions apart."""
    rows = results.by_id()
    twins = {replace(route, twin=False): row for route, row in rows.items() if route.twin}
    return [Pair(route, row, twins[route]) for route, row in rows.items() if not route.twin and route in twins]


def pairs_won(results: Results) -> dict[str, tuple[int, int]]:
    """Scenario type -> (pairs, pairs won)."""
    found: dict[str, tuple[int, int]] = {}
    for pair in pairs_of(results):
        pairs, won = found.get(pair.route.type, (0, 0))
        found[pair.route.type] = (pairs + 1, won + pair.won)
    return found


def twin_scores(results: Results) -> dict[str, list[tuple[RouteId, float | None]]]:
    """needless_stops: 100 for each twin with a stop of more than `NEEDLESS_S` without a reason, else 0. time_lost_s:
    against the reference time, of twins that were driven to the goal. None where a value is not defined."""
    twins = [(route, row) for route, row in results.by_id().items() if route.twin]
    return {
        'needless_stops': [(route, _needless(row)) for route, row in twins],
        'time_lost_s': [(route, _time_lost_s(row)) for route, row in twins],
    }


def _needless(row: Row | None) -> float | None:
    if row is None or row['needless_stop_s'] is None:
        return None
    return 100.0 * (row['needless_stop_s'] > NEEDLESS_S)


def _time_lost_s(row: Row | None) -> float | None:
    if row is None or row['reference_s'] is None or row['route_completion'] < 100.0:
        return None
    return float(row['duration_s'] - row['reference_s'])
