import shutil

import numpy as np
import pytest

from raw2drive_ros.contracts.errors import UnknownDriverError, UnknownScenarioError
from raw2drive_ros.evaluation.driver_spec import DriverSpec
from raw2drive_ros.evaluation.drivers import make_driver
from raw2drive_ros.evaluation.episode import drive_route
from raw2drive_ros.evaluation.evaluate import Conditions, evaluate
from raw2drive_ros.evaluation.metrics import (
    bootstrap,
    efficiency_percent,
    failed_route,
    infraction_score,
    score_route,
)
from raw2drive_ros.evaluation.results import filmstrip_path
from raw2drive_ros.evaluation.routes import routes_of
from raw2drive_ros.simulation.environment import DrivingEnv, SimulationConfig
from raw2drive_ros.simulation.route_id import RouteId

X = RouteId('VanillaNonSignalizedTurn', 0)


def test_one_vehicle_collision_and_one_red_light_on_a_whole_route_score_42() -> None:
    result = score_route(X, 100.0, {'collision_vehicle': 1, 'red_light': 1}, '', 0.0)
    assert result.driving_score == pytest.approx(42.0)
    assert not result.success


def test_sixty_percent_outside_the_lane_leaves_a_factor_of_0_4() -> None:
    assert infraction_score({}, 60.0) == pytest.approx(0.4)


def test_repeated_events_multiply() -> None:
    assert infraction_score({'collision_pedestrian': 2, 'stop_sign': 1}, 0.0) == pytest.approx(0.25 * 0.8)


def test_success_needs_the_whole_route_and_no_infraction() -> None:
    assert score_route(X, 100.0, {}, '', 0.0).success
    assert not score_route(X, 99.0, {}, 'timeout', 0.0).success
    assert not score_route(X, 100.0, {'stop_sign': 1}, '', 0.0).success


def test_efficiency_leaves_out_extremes_and_is_undefined_without_traffic() -> None:
    assert efficiency_percent([50.0, 150.0, 1200.0]) == 100.0
    assert efficiency_percent([]) is None
    assert efficiency_percent([], bench2drive_compat=True) == 100.0


def test_a_route_whose_drive_raises_is_a_failed_route_with_the_reason() -> None:
    row = failed_route(X, 'ValueError: no')
    assert (row.driving_score, row.success, row.failure) == (0.0, False, 'error: ValueError: no')


def test_bootstrap_interval_holds_the_mean_and_is_repeatable() -> None:
    values = np.random.default_rng(1).uniform(0, 100, 50).tolist()
    interval = bootstrap(values)
    assert interval['low'] < interval['mean'] < interval['high']
    assert interval == bootstrap(values)


def test_routes_by_name_ability_and_all() -> None:
    assert routes_of('lane-following', 2) == [RouteId('LaneFollowing', 0), RouteId('LaneFollowing', 1)]
    assert {route.type for route in routes_of('GiveWay', 1)} == {'InvadingTurn', 'YieldToEmergencyVehicle'}
    assert len(routes_of('all', 1)) >= 11
    assert routes_of('lane-following', 2, 20) == [RouteId('LaneFollowing', 20), RouteId('LaneFollowing', 21)]
    assert routes_of('GiveWay', 1, weather='FogNoon')[0].weather == 'FogNoon'
    with pytest.raises(UnknownScenarioError, match='unknown routes'):
        routes_of('flying', 1)


def test_rule_driver_finishes_and_controls_do_not() -> None:
    routes = routes_of('lane-following', 3)
    scores = {}
    for name in ('rule', 'straight', 'random'):
        result = evaluate(DriverSpec(name), 'lane-following', '1', routes)
        scores[name] = [row['route_completion'] for row in result['routes']]
    assert min(scores['rule']) == 100.0
    assert max(scores['straight']) < 90 and max(scores['random']) < 90


def test_evaluation_is_repeatable_and_has_the_machine_form() -> None:
    routes = routes_of('VanillaSignalizedTurnEncounterRedLight,ParkedObstacle', 2)
    first, second = (evaluate(DriverSpec('rule'), 'x', '1', routes) for _ in range(2))
    assert first['routes'] == second['routes']
    assert set(first) == {
        'driver', 'suite', 'version', 'protocol', 'routes', 'missing', 'summary', 'abilities', 'flaky', 'timing',
    }  # fmt: skip
    assert set(first['routes'][0]) == {
        'id', 'type', 'seed', 'weather', 'repetition', 'route_completion', 'infraction_score', 'driving_score',
        'success', 'infractions', 'signs_obeyed', 'failure', 'duration_s', 'reward', 'efficiency', 'comfort',
        'limit_s', 'reference_s', 'twin', 'needless_stop_s',
    }  # fmt: skip
    assert {'mean', 'low', 'high', 'routes'} == set(first['summary']['driving_score'])


def test_two_workers_give_the_same_routes_as_one(tmp_path) -> None:
    routes = routes_of('VanillaNonSignalizedTurn,ControlLoss', 2)
    alone = evaluate(DriverSpec('rule'), 'x', '1', routes)
    shared = evaluate(DriverSpec('rule'), 'x', '1', routes, workers=2)
    assert shared['routes'] == alone['routes']
    assert shared['summary'] == alone['summary']


def test_a_bundle_is_known_by_its_weights_not_by_its_place(bundle, teacher_run, tmp_path) -> None:
    copy = tmp_path / 'elsewhere'
    shutil.copytree(bundle, copy)
    here, there = (DriverSpec('raw', place).identity() for place in (bundle, copy))
    assert here == there
    assert str(bundle) not in here
    assert DriverSpec('raw', bundle, blind=True).identity() != here
    shutil.copytree(teacher_run, tmp_path / 'run')
    runs = {DriverSpec('privileged', run=place).identity() for place in (teacher_run, tmp_path / 'run')}
    assert len(runs) == 1
    assert 'run' not in runs.pop()


def test_learned_drivers_run_in_process(bundle, teacher_run) -> None:
    env = DrivingEnv(SimulationConfig(end_on_infraction=False))
    for name in ('raw', 'privileged'):
        driver = make_driver(name, bundle, teacher_run)
        one, two = (drive_route(env, driver, RouteId('LaneFollowing', 0), max_ticks=15) for _ in range(2))
        assert len(one.controls) == 15
        assert one.controls == two.controls, 'a driver repeats itself bit for bit'


def test_unknown_driver_lists_the_known_ones() -> None:
    with pytest.raises(UnknownDriverError, match='privileged'):
        make_driver('autopilot')


def test_a_drive_that_raises_leaves_the_other_routes_their_scores(monkeypatch) -> None:
    from raw2drive_ros.simulation.world import World

    step = World.step

    def breaks(world: World, control) -> None:
        if world.scenario.name == 'ControlLoss' and world.time_s > 1.0:
            raise ZeroDivisionError('a bug')
        step(world, control)

    monkeypatch.setattr(World, 'step', breaks)
    routes = [RouteId('ControlLoss', 0), RouteId('VanillaNonSignalizedTurn', 0)]
    result = evaluate(DriverSpec('rule'), 'x', '1', routes)
    assert [row['failure'] for row in result['routes']] == ['error: ZeroDivisionError: a bug', '']
    assert result['routes'][1]['success']


def test_repetitions_start_elsewhere_and_are_repeatable() -> None:
    routes = [RouteId('HardBreakRoute', 0, repetition=i) for i in (0, 1, 2)]
    first, second = (evaluate(DriverSpec('rule'), 'x', '1', routes) for _ in range(2))
    assert first['routes'] == second['routes']
    assert len({row['reward'] for row in first['routes']}) == 3


def test_a_failed_route_leaves_a_filmstrip_of_pictures(tmp_path) -> None:
    from raw2drive_ros.report.filmstrip import FilmstripRecorder

    routes = [RouteId('BlockedIntersection', 0), RouteId('VanillaNonSignalizedTurn', 0)]
    evaluate(DriverSpec('constant'), 'x', '1', routes, Conditions(observe=FilmstripRecorder, filmstrips=tmp_path))
    assert list(tmp_path.iterdir()) == [filmstrip_path(tmp_path, str(routes[0]))]
