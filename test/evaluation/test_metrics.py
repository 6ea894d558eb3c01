import numpy as np
import pytest

from raw2drive_ros.evaluation.drivers import UnknownDriverError, make_driver
from raw2drive_ros.evaluation.episode import drive_route
from raw2drive_ros.evaluation.evaluate import evaluate
from raw2drive_ros.evaluation.metrics import bootstrap, infraction_score, score_route
from raw2drive_ros.evaluation.routes import routes_of
from raw2drive_ros.simulation.environment import DrivingEnv, SimulationConfig
from raw2drive_ros.simulation.scenario import UnknownScenarioError


def test_one_vehicle_collision_and_one_red_light_on_a_whole_route_score_42() -> None:
    result = score_route('X', 0, 100.0, {'collision_vehicle': 1, 'red_light': 1}, '', 0.0)
    assert result.driving_score == pytest.approx(42.0)
    assert not result.success


def test_sixty_percent_outside_the_lane_leaves_a_factor_of_0_4() -> None:
    assert infraction_score({}, 60.0) == pytest.approx(0.4)


def test_repeated_events_multiply() -> None:
    assert infraction_score({'collision_pedestrian': 2, 'stop_sign': 1}, 0.0) == pytest.approx(0.25 * 0.8)


def test_success_needs_the_whole_route_and_no_infraction() -> None:
    assert score_route('X', 0, 100.0, {}, '', 0.0).success
    assert not score_route('X', 0, 99.0, {}, 'timeout', 0.0).success
    assert not score_route('X', 0, 100.0, {'stop_sign': 1}, '', 0.0).success


def test_bootstrap_interval_holds_the_mean_and_is_repeatable() -> None:
    values = np.random.default_rng(1).uniform(0, 100, 50).tolist()
    interval = bootstrap(values)
    assert interval['low'] < interval['mean'] < interval['high']
    assert interval == bootstrap(values)


def test_routes_by_name_ability_and_all() -> None:
    assert routes_of('lane-following', 2) == [('LaneFollowing', 0), ('LaneFollowing', 1)]
    assert {name for name, _ in routes_of('GiveWay', 1)} == {'InvadingTurn', 'YieldToEmergencyVehicle'}
    assert len(routes_of('all', 1)) >= 11
    assert routes_of('lane-following', 2, 20) == [('LaneFollowing', 20), ('LaneFollowing', 21)]
    with pytest.raises(UnknownScenarioError, match='unknown routes'):
        routes_of('flying', 1)


def test_rule_driver_finishes_and_controls_do_not() -> None:
    routes = routes_of('lane-following', 3)
    scores = {}
    for name in ('rule', 'straight', 'random'):
        result = evaluate(name, make_driver(name), 'lane-following', routes)
        scores[name] = [row['route_completion'] for row in result['routes']]
    assert min(scores['rule']) == 100.0
    assert max(scores['straight']) < 90 and max(scores['random']) < 90


def test_evaluation_is_repeatable_and_has_the_machine_form() -> None:
    routes = routes_of('VanillaSignalizedTurnEncounterRedLight,ParkedObstacle', 2)
    first, second = (evaluate('rule', make_driver('rule'), 'x', routes) for _ in range(2))
    assert first['routes'] == second['routes']
    assert set(first) == {'driver', 'suite', 'version', 'routes', 'summary', 'timing'}
    assert set(first['routes'][0]) == {
        'id', 'type', 'seed', 'route_completion', 'infraction_score', 'driving_score', 'success', 'infractions',
    }  # fmt: skip
    assert {'mean', 'low', 'high'} == set(first['summary']['driving_score'])


def test_lines_file_says_failed_until_there_is_data(tmp_path) -> None:
    lines = tmp_path / 'lines.jsonl'
    evaluate('rule', make_driver('rule'), 'x', routes_of('lane-following', 1), lines=lines)
    first, second = lines.read_text().splitlines()
    assert 'failed, no data' in first
    assert 'LaneFollowing/0' in second


def test_learned_drivers_run_in_process(bundle, teacher_run) -> None:
    env = DrivingEnv(SimulationConfig(end_on_infraction=False))
    for name in ('raw', 'privileged'):
        driver = make_driver(name, bundle, teacher_run)
        one, two = (drive_route(env, driver, 'LaneFollowing', 0, max_ticks=15) for _ in range(2))
        assert len(one.controls) == 15
        assert one.controls == two.controls, 'a driver repeats itself bit for bit'


def test_unknown_driver_lists_the_known_ones() -> None:
    with pytest.raises(UnknownDriverError, match='privileged'):
        make_driver('autopilot')
