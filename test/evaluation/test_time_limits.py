"""The time limit of a suite reaches the drive, the row, the evaluation, the command line and the bridge."""

import json
import math

import paired_types
import pytest
from paired_types import EMPTY

from raw2drive_ros.cli.main import main
from raw2drive_ros.contracts.errors import RouteIdError
from raw2drive_ros.evaluation.driver_spec import DriverSpec
from raw2drive_ros.evaluation.drivers import make_driver
from raw2drive_ros.evaluation.episode import drive_route
from raw2drive_ros.evaluation.evaluate import Conditions, evaluate
from raw2drive_ros.evaluation.quick_drive import sensorless_env
from raw2drive_ros.evaluation.results import read_results
from raw2drive_ros.evaluation.suites import limits_of_text, limits_text, load_suite
from raw2drive_ros.simulation.criteria import time_limit_s
from raw2drive_ros.simulation.route_id import RouteId


@pytest.fixture(autouse=True)
def _paired(monkeypatch) -> None:
    paired_types.register(monkeypatch)


def suite_file(tmp_path, limits):
    place = {'seed': 0, 'weather': 'ClearNoon', 'limit_s': limits, 'reference_s': [9.0, 9.0]}
    path = tmp_path / 'own.json'
    path.write_text(json.dumps({'format': 3, 'name': 'own', 'version': '3', 'routes': {EMPTY: [place]}}))
    return str(path)


def test_a_drive_fails_at_its_limit_and_not_before() -> None:
    env, driver = sensorless_env(), make_driver('constant')
    free = drive_route(env, driver, RouteId(EMPTY, 0), time_limit_s=math.inf).result
    assert free.success
    assert free.limit_s is None
    late = drive_route(env, driver, RouteId(EMPTY, 0), time_limit_s=free.duration_s - 1.0).result
    assert (late.failure, late.success) == ('timeout', False)
    assert late.duration_s == pytest.approx(free.duration_s - 1.0, abs=0.15)
    assert late.limit_s == pytest.approx(free.duration_s - 1.0, abs=0.01)
    just = drive_route(env, driver, RouteId(EMPTY, 0), time_limit_s=free.duration_s + 0.1).result
    assert just.success


def test_without_a_suite_the_scenes_own_limit_holds() -> None:
    env = sensorless_env()
    result = drive_route(env, make_driver('constant'), RouteId(EMPTY, 0), max_ticks=3).result
    assert result.limit_s == round(time_limit_s(env.world), 2)


def test_event_and_twin_are_evaluated_under_their_own_limits(tmp_path) -> None:
    suite = load_suite(suite_file(tmp_path, [60.0, 5.0]))
    out = tmp_path / 'rows.jsonl'
    conditions = Conditions(limits_s=suite.limits_s(suite.routes))
    evaluate(DriverSpec('constant'), suite.name, suite.version, suite.routes, conditions, out)
    event, twin = read_results(out).rows
    assert (event['success'], event['limit_s']) == (True, 60.0)
    assert (twin['success'], twin['failure'], twin['limit_s']) == (False, 'timeout', 5.0)
    # Rows of older files have no limit.
    lines = out.read_text().splitlines()
    old = {name: value for name, value in json.loads(lines[1]).items() if name != 'limit_s'}
    out.write_text('\n'.join([lines[0], json.dumps(old)]) + '\n')
    assert read_results(out).rows[0]['limit_s'] is None


def test_the_command_line_takes_the_limits_of_the_suite(tmp_path, capsys) -> None:
    path = suite_file(tmp_path, [60.0, 5.0])
    assert main(['evaluate', '--driver', 'constant', '--suite', path, '--json', '--weather', 'FogNoon']) == 0
    rows = json.loads(capsys.readouterr().out)['routes']
    assert [row['limit_s'] for row in rows] == [60.0, 5.0]
    assert main(['suite', 'show', path, '--json']) == 0
    shown = json.loads(capsys.readouterr().out)['routes']
    assert [(r['twin'], r['limit_s'], r['reference_s']) for r in shown] == [(False, 60.0, 9.0), (True, 5.0, 9.0)]


def test_limits_are_one_line_for_the_bridge() -> None:
    limits = {RouteId(EMPTY, 3, 'FogNoon', 1, twin=True): 31.125, RouteId('Accident', 0): 7.0}
    assert limits_of_text(limits_text(limits)) == limits
    assert limits_of_text('') == {}
    for text in ('Accident/0', 'Accident/0=', 'Accident/0=x', 'Accident/0=-3', 'Accident/0=nan', 'Accident=3'):
        with pytest.raises(RouteIdError):
            limits_of_text(text)
