"""The shipped suites: their size, that they do not overlap, and that unfair draws are found."""

import pytest

from raw2drive_ros.contracts.errors import UnfairScenarioError, UnknownSuiteError
from raw2drive_ros.evaluation.suites import (
    DEV10,
    SuitePlan,
    benchmark_types,
    draw_suite,
    is_fair,
    load_suite,
)
from raw2drive_ros.simulation.draws import TRAIN_SEED_START, VALIDATION_SEED_START, Draw
from raw2drive_ros.simulation.route_id import RouteId
from raw2drive_ros.simulation.scenario import get_scenario
from raw2drive_ros.simulation.weather import WEATHER_NAMES
from raw2drive_ros.simulation.world import World


def test_b2d220_is_44_types_with_five_routes_each() -> None:
    suite = load_suite('b2d220')
    assert len(suite.routes) == len(set(suite.routes)) == 220
    assert {route.type for route in suite.routes} == set(benchmark_types())
    assert all(route.seed < VALIDATION_SEED_START for route in suite.routes)
    assert {route.weather for route in suite.routes} == set(WEATHER_NAMES)


def test_dev10_is_a_part_of_b2d220() -> None:
    dev10 = load_suite('dev10').routes
    assert [route.type for route in dev10] == list(DEV10)
    assert set(dev10) <= set(load_suite('b2d220').routes)


def test_training_validation_and_evaluation_share_no_route() -> None:
    train, validation = load_suite('train'), load_suite('validation')
    assert len(train.routes) >= 1000
    assert all(route.seed >= TRAIN_SEED_START for route in train.routes)
    assert all(VALIDATION_SEED_START <= route.seed < TRAIN_SEED_START for route in validation.routes)


def test_a_shipped_route_is_drawn_again_as_it_stands() -> None:
    plan = SuitePlan(('VanillaNonSignalizedTurn', 'HardBreakRoute'), 5, 0)
    routes, _ = draw_suite(plan)
    shipped = {str(route) for route in load_suite('b2d220').routes}
    drawn = {str(RouteId.parse(f'{kind}/{place}')) for kind, places in routes.items() for place in places}
    assert drawn <= shipped


def test_a_scene_whose_actors_crash_is_unfair(monkeypatch) -> None:
    """A car that ignores traffic hits a barrier; the ego is not involved."""
    from raw2drive_ros.simulation import scenario
    from raw2drive_ros.simulation.layout import RoadLayout, Straight
    from raw2drive_ros.simulation.scenario import RouteSpec, Scene, StandingSpec, TrafficSpec

    def draw(rng) -> Scene:
        blind = TrafficSpec('backward', 80.0, 9.0, ignores_traffic=True)
        wall = StandingSpec('barrier', 60.0, 3.5)
        return Scene(RoadLayout((Straight(200),), 1, 1), RouteSpec(), (blind, wall))

    monkeypatch.setitem(scenario.REGISTRY, 'Crash', scenario.Scenario('Crash', (), draw))
    assert not is_fair('Crash', 0)
    with pytest.raises(UnfairScenarioError, match='Crash'):
        draw_suite(SuitePlan(('Crash',), 1, 0))


def test_unknown_and_broken_suites_are_clear_errors(tmp_path) -> None:
    with pytest.raises(UnknownSuiteError, match='b2d220'):
        load_suite('nowhere')
    broken = tmp_path / 'broken.json'
    broken.write_text('{"name": "x"}')
    with pytest.raises(UnknownSuiteError, match='not a suite'):
        load_suite(str(broken))


def test_long_routes_chain_many_events_over_two_kilometres() -> None:
    routes = load_suite('long').routes
    assert len(routes) >= 10
    world = World(get_scenario('LongRoute'), Draw('LongRoute', routes[0].seed))
    assert world.route.length_m > 2000.0
    kinds = {type(spec).__name__ for spec in world.scene.actors}
    assert {'TrafficSpec', 'WalkerSpec', 'StandingSpec'} <= kinds
    assert len(world.road.junctions) >= 4
