"""Statistics of results against numbers computed by hand."""

import numpy as np
import pytest

from raw2drive_ros.contracts.errors import ResultsError
from raw2drive_ros.evaluation.metrics import bootstrap
from raw2drive_ros.evaluation.results import Results
from raw2drive_ros.evaluation.statistics import (
    by_ability,
    by_type,
    compare,
    flaky,
    infractions,
    sign_flip_p,
    summary,
    verdict,
)
from raw2drive_ros.simulation.route_id import RouteId


def row(kind: str, seed: int, score: float, *, success: bool | None = None, repetition: int = 0, **more) -> dict:
    route = RouteId(kind, seed, repetition=repetition)
    return {
        'id': str(route), 'type': kind, 'seed': seed, 'weather': route.weather, 'repetition': repetition,
        'route_completion': 100.0, 'infraction_score': score / 100, 'driving_score': score,
        'success': score == 100.0 if success is None else success, 'infractions': {}, 'signs_obeyed': False,
        'failure': '', 'duration_s': 10.0, 'reward': 1.0, 'efficiency': None, 'comfort': None,
        'limit_s': None, 'reference_s': None, 'twin': False, 'needless_stop_s': None,
    } | more  # fmt: skip


def results(rows, wanted=None, **header) -> Results:
    routes = [r['id'] for r in rows] if wanted is None else wanted
    return Results({'driver': 'x', 'suite': 's', 'version': '1', 'protocol': 'pairs', 'routes': routes} | header, rows)


def test_missing_routes_count_as_zero_and_are_listed() -> None:
    run = results([row('Accident', 0, 100.0)], ['Accident/0', 'Accident/1', 'HardBreakRoute/2/CloudyNoon'])
    found = summary(run)
    assert [str(route) for route in run.missing] == ['Accident/1', 'HardBreakRoute/2/CloudyNoon']
    assert found['driving_score']['mean'] == pytest.approx(100.0 / 3)
    assert found['success_rate']['mean'] == pytest.approx(100.0 / 3)
    assert (found['wanted'], found['driven']) == (3, 1)
    assert by_type(run)['Accident'] == {
        'drives': 2, 'successes': 1, 'driving_score': 50.0, 'pairs': 0, 'pairs_won': 0
    }  # fmt: skip


def test_undefined_values_are_left_out_and_not_zero() -> None:
    found = summary(results([row('Accident', 0, 9.0, efficiency=80.0), row('Accident', 1, 9.0)]))
    assert found['efficiency']['mean'] == 80.0
    assert found['efficiency']['routes'] == found['defined']['efficiency'] == 1
    assert found['comfort'] is None


def test_repetitions_are_averaged_before_the_mean() -> None:
    """Route 0: 100 and 0 -> 50; route 1: 0 once. The mean over routes is 25, over drives it would be 33."""
    found = summary(
        results([row('Accident', 0, 100.0), row('Accident', 0, 0.0, repetition=1), row('Accident', 1, 0.0)])
    )
    assert found['driving_score']['mean'] == 25.0
    assert found['driving_score']['routes'] == 2


def test_clustering_by_route_is_wider_than_counting_drives() -> None:
    rows = [row('Accident', seed, 100.0 * (seed % 2), repetition=r) for seed in range(20) for r in range(5)]
    clustered = summary(results(rows))['driving_score']
    naive = bootstrap([r['driving_score'] for r in rows])
    assert clustered['mean'] == naive['mean'] == 50.0
    ratio = (clustered['high'] - clustered['low']) / (naive['high'] - naive['low'])
    assert ratio == pytest.approx(np.sqrt(5), rel=0.2)


def test_traffic_sign_counts_each_drive_twice_and_missing_routes_fail() -> None:
    """(successes + passes) / 2N: one of each, of three routes; a success is a pass even without a junction."""
    rows = [row('EnterActorFlow', 0, 60.0, signs_obeyed=True), row('EnterActorFlow', 1, 100.0)]
    found = by_ability(results(rows, ['EnterActorFlow/0', 'EnterActorFlow/1', 'EnterActorFlow/2']))
    assert found['TrafficSign']['mean'] == pytest.approx(100.0 * (1 + 2) / (2 * 3))
    assert found['Merging']['mean'] == pytest.approx(100.0 / 3)
    assert 'mean' not in found


def test_flaky_routes_are_those_whose_repetitions_disagree() -> None:
    rows = [row('Accident', 0, s, repetition=r) for r, s in enumerate((100.0, 0.0, 0.0))]
    rows += [row('Accident', 1, 100.0, repetition=r) for r in range(3)]
    assert flaky(results(rows)) == [{'type': 'Accident', 'seed': 0, 'successes': 1, 'drives': 3}]


def test_infractions_and_failures_are_counted_once() -> None:
    rows = [
        row('Accident', 0, 0.0, infractions={'red_light': 2, 'blocked': 1}, failure='blocked'),
        row('Accident', 1, 0.0, failure='error: no such thing'),
    ]
    assert infractions(results(rows)) == {'red_light': 2, 'blocked': 1, 'error': 1}


def test_verdicts_follow_clear_differences_both_ways() -> None:
    good = results([row('Accident', seed, 90.0 + seed % 3) for seed in range(12)])
    bad = results([row('Accident', seed, 50.0 - seed % 5) for seed in range(12)])
    found = compare(good, bad)
    assert found['driving_score']['mean'] == pytest.approx(91.0 - (50.0 - 21 / 12))
    assert found['driving_score']['verdict'] == 'yes'
    assert compare(bad, good)['driving_score']['verdict'] == 'no'
    assert found['success_rate']['verdict'] == 'undecided', 'neither ever succeeded'
    assert compare(good, good)['driving_score']['p'] == 1.0


def test_three_routes_decide_nothing() -> None:
    """All differences are +10, the bootstrap interval is [10, 10]; 2 of 8 sign patterns are as extreme."""
    assert sign_flip_p([10.0] * 3) == pytest.approx(0.25, abs=0.02)
    assert verdict(bootstrap([10.0] * 3), sign_flip_p([10.0] * 3)) == 'undecided'


def test_routes_of_one_side_only_are_counted_and_a_missing_row_is_zero() -> None:
    a = results([row('Accident', 0, 80.0), row('Accident', 1, 80.0)])
    b = results([row('Accident', 1, 30.0)], ['Accident/1', 'Accident/0', 'Accident/7'])
    found = compare(a, b)
    assert (found['common'], found['not_common']) == (2, 1)
    assert found['driving_score']['mean'] == pytest.approx((80.0 + 50.0) / 2)


def test_unlike_runs_are_not_compared() -> None:
    one = results([row('Accident', 0, 1.0)])
    with pytest.raises(ResultsError, match='version'):
        compare(one, results([row('Accident', 0, 1.0)], version='2'))
    with pytest.raises(ResultsError, match='no route in common'):
        compare(one, results([row('Accident', 1, 1.0)]))
