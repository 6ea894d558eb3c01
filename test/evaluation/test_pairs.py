"""Pairs of drives: what is counted, against numbers computed by hand, and what a protocol drives."""

import json

import pytest
from paired_types import EMPTY, WALKER, register

from raw2drive_ros.cli.main import main
from raw2drive_ros.contracts.public import Control
from raw2drive_ros.evaluation.driver_spec import DriverSpec
from raw2drive_ros.evaluation.evaluate import Conditions, evaluate
from raw2drive_ros.evaluation.following import pedals, pursuit_steer
from raw2drive_ros.evaluation.pairs import headline, pairs_of
from raw2drive_ros.evaluation.results import OLD_PROTOCOL, Results, read_results
from raw2drive_ros.evaluation.statistics import by_type, compare, flaky, summary
from raw2drive_ros.report.comparison import write_comparison
from raw2drive_ros.simulation.environment import DrivingEnv, SimulationConfig
from raw2drive_ros.simulation.route_id import RouteId


def row(seed: int, *, success: bool, twin: bool = False, repetition: int = 0, **more) -> dict:
    route = RouteId('Accident', seed, repetition=repetition, twin=twin)
    return {
        'id': str(route), 'type': 'Accident', 'seed': seed, 'weather': route.weather, 'repetition': repetition,
        'route_completion': 100.0, 'infraction_score': 1.0, 'driving_score': 100.0 * success, 'success': success,
        'infractions': {}, 'signs_obeyed': False, 'failure': '', 'duration_s': 20.0, 'reward': 1.0,
        'efficiency': None, 'comfort': None, 'limit_s': 30.0, 'reference_s': None, 'twin': twin,
        'needless_stop_s': 0.0,
    } | more  # fmt: skip


def results(rows, wanted=()) -> Results:
    routes = [*wanted, *(r['id'] for r in rows)]
    return Results({'driver': 'x', 'suite': 's', 'version': '3', 'protocol': 'pairs', 'routes': routes}, rows)


def drives(won: str, seed: int, **more) -> list[dict]:
    """Event and twin; won: both, event, twin or none."""
    event, twin = won in ('both', 'event'), won in ('both', 'twin')
    return [row(seed, success=event, **more), row(seed, success=twin, twin=True, **more)]


def test_a_pair_is_won_by_both_drives() -> None:
    run = results([*drives('both', 0), *drives('event', 1), *drives('twin', 2), *drives('none', 3)])
    found = summary(run)
    assert found['pair_success_rate']['mean'] == 25.0
    assert found['event_success_rate']['mean'] == found['success_rate']['mean'] == 50.0
    assert found['twin_success_rate']['mean'] == 50.0
    assert found['driving_score']['mean'] == 50.0
    assert found['pair_success_rate']['routes'] == found['success_rate']['routes'] == 4
    assert (found['wanted'], found['driven']) == (8, 8)
    assert found['pair_success_rate']['low'] < 25.0 < found['pair_success_rate']['high']
    assert by_type(run)['Accident'] == {
        'drives': 4, 'successes': 2, 'driving_score': 50.0, 'pairs': 4, 'pairs_won': 1,
    }  # fmt: skip


def test_a_missing_twin_loses_the_pair_and_single_drives_are_none() -> None:
    run = results([row(0, success=True), row(1, success=True)], ['Accident-twin/0'])
    assert len(pairs_of(run)) == 1
    found = summary(run)
    assert found['pair_success_rate']['mean'] == 0.0
    assert found['success_rate']['mean'] == 100.0
    assert [str(route) for route in run.missing] == ['Accident-twin/0']
    single = summary(results([row(0, success=True)]))
    assert single['pair_success_rate'] is single['needless_stops'] is single['time_lost_s'] is None


def test_repetitions_of_a_pair_are_averaged_and_an_event_is_not_flaky_because_of_its_twin() -> None:
    rows = [*drives('both', 0), *drives('event', 0, repetition=1), *drives('none', 1)]
    found = summary(results(rows))
    assert found['pair_success_rate']['mean'] == 25.0
    assert flaky(results(rows)) == [{'type': 'Accident-twin', 'seed': 0, 'successes': 1, 'drives': 2}]


def test_twins_alone_are_scored_by_themselves() -> None:
    run = results([row(0, success=True, twin=True), row(1, success=False, twin=True)])
    assert all(route.twin for route in headline(run))
    found = summary(run)
    assert found['success_rate']['mean'] == 50.0
    assert found['pair_success_rate'] is None


def test_needless_stops_and_time_lost_are_of_the_twins_that_have_them() -> None:
    rows = [
        row(0, success=True, needless_stop_s=9.0, reference_s=10.0),
        row(0, success=True, twin=True, needless_stop_s=1.0, reference_s=18.0),
        row(1, success=True, twin=True, needless_stop_s=1.1, reference_s=25.0),
        row(2, success=False, twin=True, needless_stop_s=30.0, reference_s=5.0, route_completion=50.0),
        row(3, success=True, twin=True, needless_stop_s=None),
    ]
    found = summary(results(rows))
    assert found['needless_stops']['mean'] == pytest.approx(200.0 / 3)
    assert found['time_lost_s']['mean'] == pytest.approx((2.0 - 5.0) / 2)
    assert (found['needless_stops']['routes'], found['time_lost_s']['routes']) == (3, 2)


def test_pairs_are_compared_where_both_have_them() -> None:
    good = results([line for seed in range(12) for line in drives('both', seed)])
    bad = results([line for seed in range(12) for line in drives('event', seed)])
    found = compare(good, bad)
    assert found['pair_success_rate']['verdict'] == 'yes'
    assert found['pair_success_rate']['mean'] == 100.0
    assert found['success_rate']['mean'] == 0.0
    assert found['common'] == 12
    assert 'pair_success_rate' not in compare(results([row(0, success=True)]), good)


# -- driven -------------------------------------------------------------------------------------------------


def pair(kind: str) -> list[RouteId]:
    return [RouteId(kind, 100_000, twin=twin) for twin in (False, True)]


def test_driven_pairs_are_read_back_with_their_times_and_reported(tmp_path, monkeypatch) -> None:
    register(monkeypatch)
    routes = pair(EMPTY)
    conditions = Conditions(limits_s=dict.fromkeys(routes, 60.0), references_s=dict.fromkeys(routes, 12.5))
    target = tmp_path / 'rule.jsonl'
    found = evaluate(DriverSpec('rule'), 'x', '3', routes, conditions, target)
    assert found['protocol'] == 'pairs'
    read = read_results(target)
    assert [r['twin'] for r in read.rows] == [False, True]
    assert [(r['limit_s'], r['reference_s']) for r in read.rows] == [(60.0, 12.5)] * 2
    assert found['summary'] == summary(read)
    assert found['summary']['pair_success_rate']['mean'] == 100.0
    lost = read.rows[1]['duration_s'] - 12.5
    assert found['summary']['time_lost_s']['mean'] == pytest.approx(lost)
    assert found['summary']['needless_stops']['mean'] == 0.0
    page = write_comparison(tmp_path / 'report.html', [target]).read_text()
    assert 'pair success %' in page and 'needless stops %' in page and '1/1 <span class="soft">pairs</span>' in page


def test_protocol_bench2drive_drives_events_alone_within_loose_limits(tmp_path, monkeypatch, capsys) -> None:
    register(monkeypatch)
    suite = tmp_path / 'two.json'
    place = {'seed': 100_000, 'weather': 'ClearNoon', 'limit_s': [11.0, 11.0], 'reference_s': [5.0, 5.0]}
    suite.write_text(json.dumps({'name': 'two', 'version': '3', 'format': 3, 'routes': {EMPTY: [place]}}))
    words = ['evaluate', '--driver', 'rule', '--suite', str(suite), '--json']
    assert main(words) == 0
    pairs = json.loads(capsys.readouterr().out)
    assert main([*words, '--protocol', 'bench2drive']) == 0
    single = json.loads(capsys.readouterr().out)
    assert [r['twin'] for r in pairs['routes']] == [False, True]
    assert [(r['twin'], r['limit_s']) for r in single['routes']] == [(False, 200.0)]
    assert (pairs['protocol'], single['protocol']) == ('pairs', 'bench2drive')
    assert pairs['summary']['success_rate']['mean'] == 0.0, 'the limit of the suite is short'
    assert single['summary']['success_rate']['mean'] == 100.0
    assert single['summary']['pair_success_rate'] is None
    place |= {'limit_s': [60.0], 'reference_s': [5.0]}
    twins = {'name': 'two', 'version': '3', 'format': 3, 'drives': ['twin'], 'routes': {EMPTY: [place]}}
    suite.write_text(json.dumps(twins))
    assert main([*words, '--protocol', 'bench2drive']) == 2
    assert 'twins alone' in capsys.readouterr().err


def test_files_of_version_2_are_read_as_such(tmp_path) -> None:
    old = row(0, success=True)
    for name in ('limit_s', 'reference_s', 'twin', 'needless_stop_s'):
        del old[name]
    header = {'driver': 'x', 'suite': 's', 'version': '2', 'routes': ['Accident/0']}
    path = tmp_path / 'old.jsonl'
    path.write_text(f'{json.dumps(header)}\n{json.dumps(old)}\n')
    read = read_results(path)
    assert read.header['protocol'] == OLD_PROTOCOL
    assert read.rows[0]['twin'] is False
    assert read.rows[0]['limit_s'] is read.rows[0]['needless_stop_s'] is None
    assert summary(read)['success_rate']['mean'] == 100.0


# -- the reward of twins ------------------------------------------------------------------------------------


def returned(route: RouteId, decide) -> float:
    """The discounted return of a drive under the rules of training."""
    env = DrivingEnv(SimulationConfig(cameras=False, bev=False))
    env.reset_to(route)
    found, discount = 0.0, 1.0
    while not env.done:
        found += discount * env.step(decide(env.world))[1]
        discount *= 1.0 - 1.0 / 333.0
    return found


@pytest.mark.parametrize('kind', [WALKER, EMPTY])
def test_on_a_twin_standing_still_and_stopping_for_nothing_lose(monkeypatch, kind) -> None:
    register(monkeypatch)
    twin = pair(kind)[1]

    def drive(world) -> Control:
        return pedals(world, 1.5 * (7.0 - world.ego.speed), pursuit_steer(world))

    def hesitate(world) -> Control:
        return Control(0.0, 1.0) if 6.0 < world.time_s < 12.0 else drive(world)

    through, hesitant, standing = (
        returned(twin, decide) for decide in (drive, hesitate, lambda world: Control(0.0, 1.0))
    )
    assert standing <= 0.0 < hesitant < through
