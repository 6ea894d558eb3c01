"""Suites: the shipped ones, pairs and time limits of format 3, files of format 2, and how they are planned."""

import json

import paired_types
import pytest
from paired_types import EMPTY, WALKER

from raw2drive_ros.contracts.errors import UnknownSuiteError
from raw2drive_ros.evaluation.fairness import weather_of
from raw2drive_ros.evaluation.suite_plans import DEV10, benchmark_types, suite_plans
from raw2drive_ros.evaluation.suites import LimitRule, load_suite
from raw2drive_ros.simulation.draws import TRAIN_SEED_START, VALIDATION_SEED_START, Draw
from raw2drive_ros.simulation.route_id import RouteId
from raw2drive_ros.simulation.scenario import get_scenario
from raw2drive_ros.simulation.weather import WEATHER_NAMES
from raw2drive_ros.simulation.world import World

PLACE = {'seed': 3, 'weather': 'FogNoon', 'limit_s': [31.5, 20.0], 'reference_s': [21.2, 12.0]}


@pytest.fixture
def _paired(monkeypatch) -> None:
    paired_types.register(monkeypatch)


def written(tmp_path, routes, **head) -> str:
    path = tmp_path / 'own.json'
    path.write_text(json.dumps({'format': 3, 'name': 'own', 'version': '3', **head, 'routes': routes}))
    return str(path)


def test_b2d220_is_44_types_with_five_routes_each() -> None:
    suite = load_suite('b2d220')
    pairs = suite.pairs
    assert len(pairs) == 220
    assert {pair.type for pair in pairs} == set(benchmark_types())
    assert all(pair.seed < VALIDATION_SEED_START for pair in pairs)
    assert {route.weather for route in suite.routes} == set(WEATHER_NAMES)


def test_dev10_is_a_part_of_b2d220() -> None:
    dev10 = load_suite('dev10').pairs
    assert [pair.type for pair in dev10] == list(DEV10)
    assert {(p.type, p.seed) for p in dev10} <= {(p.type, p.seed) for p in load_suite('b2d220').pairs}


def test_training_validation_and_evaluation_share_no_route() -> None:
    train, validation = load_suite('train'), load_suite('validation')
    assert len(train.routes) >= 1000
    assert all(route.seed >= TRAIN_SEED_START for route in train.routes)
    assert all(VALIDATION_SEED_START <= route.seed < TRAIN_SEED_START for route in validation.routes)


def test_plans_cover_training_and_keep_its_seeds_apart() -> None:
    plans = suite_plans()
    train = plans['train']
    assert train.per_type * len(train.types) >= 1500
    assert plans['catch'].drives == ('twin',)
    firsts = {name: plan.first_seed for name, plan in plans.items()}
    assert all(seed < VALIDATION_SEED_START for name, seed in firsts.items() if name not in ('train', 'validation'))
    assert (firsts['validation'], firsts['train']) == (VALIDATION_SEED_START, TRAIN_SEED_START)


@pytest.mark.usefixtures('_paired')
def test_a_pair_has_two_drives_with_limits_of_their_own(tmp_path) -> None:
    suite = load_suite(written(tmp_path, {WALKER: [PLACE]}))
    event, twin = RouteId(WALKER, 3, 'FogNoon'), RouteId(WALKER, 3, 'FogNoon', twin=True)
    assert suite.routes == (event, twin)
    assert suite.pairs[0].drives == (event, twin)
    assert (suite.limit_s(event), suite.limit_s(twin)) == (31.5, 20.0)
    assert suite.reference_s(twin) == 12.0
    # In other weather, and repeated, a drive has the same limit; another route has none.
    other = RouteId(WALKER, 3, 'ClearNight', 2, twin=True)
    assert suite.limits_s([other, RouteId(WALKER, 4)]) == {other: 20.0}


@pytest.mark.usefixtures('_paired')
def test_a_suite_may_hold_twins_alone_and_drives_without_limits(tmp_path) -> None:
    catch = load_suite(written(tmp_path, {EMPTY: [PLACE | {'limit_s': [9.0], 'reference_s': [4.0]}]}, drives=['twin']))
    assert [str(route) for route in catch.routes] == [f'{EMPTY}-twin/3/FogNoon']
    assert catch.limit_s(catch.routes[0]) == 9.0
    free = load_suite(written(tmp_path, {EMPTY: [{'seed': 1, 'weather': 'ClearNoon'}]}))
    assert len(free.routes) == 2
    assert free.limit_s(free.routes[0]) is None


def test_a_type_without_twin_has_one_drive(tmp_path) -> None:
    place = PLACE | {'limit_s': [31.5], 'reference_s': [21.2]}
    suite = load_suite(written(tmp_path, {'LaneFollowing': [place]}))
    assert suite.routes == (RouteId('LaneFollowing', 3, 'FogNoon'),)
    assert suite.limit_s(suite.routes[0]) == 31.5


def test_files_of_format_2_are_single_drives_without_limits(tmp_path) -> None:
    path = tmp_path / 'old.json'
    path.write_text('{"name": "old", "version": "2", "routes": {"LaneFollowing": ["0/ClearNoon", "1/FogNoon"]}}')
    suite = load_suite(str(path))
    assert suite.routes == (RouteId('LaneFollowing', 0), RouteId('LaneFollowing', 1, 'FogNoon'))
    assert suite.limits_s(suite.routes) == {}


@pytest.mark.usefixtures('_paired')
@pytest.mark.parametrize(
    ('place', 'reason'),
    [
        (PLACE | {'limit_s': [31.5]}, 'not a time for each of event, twin'),
        (PLACE | {'limit_s': [31.5, -1.0]}, '-1.0 is not a time'),
        (PLACE | {'limit_s': [31.5, True]}, 'True is not a time'),
        (PLACE | {'limit_s': 31.5}, 'not a time for each'),
        (PLACE | {'reference_s': ['x', 1.0]}, "'x' is not a time"),
        (PLACE | {'seed': '3'}, 'not a whole number'),
        (PLACE | {'weather': 'Snow'}, 'Snow'),
        ({'seed': 3}, 'weather'),
        (7, 'TypeError'),
    ],
)
def test_broken_entries_are_one_line(tmp_path, place, reason) -> None:
    with pytest.raises(UnknownSuiteError, match=reason) as caught:
        load_suite(written(tmp_path, {WALKER: [place]}))
    assert '\n' not in str(caught.value)


@pytest.mark.usefixtures('_paired')
def test_broken_files_are_one_line(tmp_path) -> None:
    for head, reason in (
        ({'format': 4}, 'format 4'),
        ({'drives': ['both']}, 'drives'),
        ({'partners': 3}, 'not a suite'),
    ):
        with pytest.raises(UnknownSuiteError, match=reason):
            load_suite(written(tmp_path, {WALKER: [PLACE]}, **head))
    with pytest.raises(UnknownSuiteError, match='listed twice'):
        load_suite(written(tmp_path, {WALKER: [PLACE, PLACE]}))
    with pytest.raises(UnknownSuiteError, match='Nowhere'):
        load_suite(written(tmp_path, {'Nowhere': [PLACE]}))
    with pytest.raises(UnknownSuiteError, match='b2d220'):
        load_suite('nowhere')


def test_the_limit_is_a_quarter_more_than_the_reference_and_five_seconds() -> None:
    assert LimitRule().limit_s(20.0) == 30.0
    assert LimitRule(2.0, 1.0).limit_s(10.0) == 21.0


def test_weather_tells_nothing_about_type_and_seed() -> None:
    by_type = {kind: [weather_of(kind, seed) for seed in range(400)] for kind in ('Accident', 'T_Junction', 'Unheard')}
    for kind, found in by_type.items():
        counts = [found.count(name) for name in WEATHER_NAMES]
        assert min(counts) >= 4, kind
        assert max(counts) <= 40, kind
    same = sum(a == b for a, b in zip(by_type['Accident'], by_type['T_Junction'], strict=True))
    assert same < 60


def test_long_routes_chain_many_events_over_two_kilometres() -> None:
    routes = load_suite('long').routes
    assert len(routes) >= 10
    world = World(get_scenario('LongRoute'), Draw('LongRoute', routes[0].seed))
    assert world.route.length_m > 2000.0
    kinds = {type(spec).__name__ for spec in world.scene.actors}
    assert {'TrafficSpec', 'WalkerSpec', 'StandingSpec'} <= kinds
    assert len(world.road.junctions) >= 4
