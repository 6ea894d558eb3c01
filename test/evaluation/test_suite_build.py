"""Drawing a suite: limits from a reference driver, rejected draws, and a call that goes on where it was interrupted."""

import json

import paired_types
import pytest
from paired_types import EMPTY, WALKER

from raw2drive_ros.cli.main import main
from raw2drive_ros.contracts.errors import UnfairScenarioError
from raw2drive_ros.evaluation import suite_build
from raw2drive_ros.evaluation.fairness import first_difference, is_fair
from raw2drive_ros.evaluation.reference import ReferenceRunner, References
from raw2drive_ros.evaluation.scene_distance import nearest_scenes, scene_key
from raw2drive_ros.evaluation.suite_build import ALIKE, DUPLICATE, UNSOLVED, build_suite, write_suite
from raw2drive_ros.evaluation.suite_plans import SuitePlan
from raw2drive_ros.evaluation.suites import load_suite
from raw2drive_ros.simulation import scenario
from raw2drive_ros.simulation.draws import TRAIN_SEED_START
from raw2drive_ros.simulation.layout import RoadLayout, Straight
from raw2drive_ros.simulation.route_id import RouteId
from raw2drive_ros.simulation.scenario import RouteSpec, Scenario, Scene, StandingSpec, TrafficSpec

RULE = References('rule', '')


@pytest.fixture(autouse=True)
def _paired(monkeypatch) -> None:
    paired_types.register(monkeypatch)


def crash(draw) -> Scene:
    """A car that ignores traffic hits a barrier; the ego is not involved."""
    blind = TrafficSpec('backward', 80.0, 9.0, ignores_traffic=True)
    wall = StandingSpec('barrier', 60.0, 3.5)
    return Scene(RoadLayout((Straight(200),), 1, 1), RouteSpec(), (blind, wall))


def blocked(draw) -> Scene:
    """Nobody who keeps his lane arrives."""
    draw.uniform('length', 0.0, 1.0, key=True)
    return Scene(RoadLayout((Straight(100),), 1, 1), RouteSpec(), (StandingSpec('barrier', 50.0, 0.0),))


def registered(monkeypatch, name, draw, *, paired=False) -> None:
    monkeypatch.setitem(scenario.REGISTRY, name, Scenario(name, (), draw, paired=paired))


def test_each_drive_gets_its_limit_from_the_reference_drivers_own_time(tmp_path) -> None:
    plan = SuitePlan((WALKER, 'LaneFollowing'), 2, 0)
    built = build_suite(plan, RULE)
    write_suite(tmp_path / 'own.json', 'own', '3', plan, built, RULE)
    suite = load_suite(str(tmp_path / 'own.json'))
    assert [pair.type for pair in suite.pairs] == [WALKER, WALKER, 'LaneFollowing', 'LaneFollowing']
    runner = ReferenceRunner(RULE)
    for route in suite.routes[:3]:
        seconds = runner.drive(route).seconds
        assert suite.reference_s(route) == seconds
        assert suite.limit_s(route) == pytest.approx(1.25 * seconds + 5.0, abs=0.01)
    event, twin = suite.pairs[0].drives
    assert suite.reference_s(event) > suite.reference_s(twin) + 1.0


def test_draws_that_are_alike_are_taken_once(tmp_path) -> None:
    plan = SuitePlan((EMPTY,), 6, 0, timed=False)
    built = build_suite(plan, RULE)
    assert built.rejected[DUPLICATE] > 0
    write_suite(tmp_path / 'own.json', 'own', '3', plan, built, RULE)
    suite = load_suite(str(tmp_path / 'own.json'))
    assert suite.limits_s(suite.routes) == {}
    assert all(scene.distance >= ALIKE for scene in nearest_scenes(suite, suite))


def test_scenes_whose_actors_crash_are_rejected(monkeypatch) -> None:
    registered(monkeypatch, 'Crash', crash)
    assert not is_fair('Crash', 0)
    assert is_fair(WALKER, 0)
    assert is_fair(WALKER, 0, twin=True)
    with pytest.raises(UnfairScenarioError, match='Crash: 60 draws rejected'):
        build_suite(SuitePlan(('Crash',), 1, 0), RULE)


def test_scenes_that_no_reference_driver_completes_are_rejected(monkeypatch) -> None:
    registered(monkeypatch, 'Blocked', blocked)
    monkeypatch.setattr(suite_build, 'DRAW_LIMIT', 2)
    assert suite_build.examine(ReferenceRunner(RULE), ('Blocked', 0), ('event',)).reason == UNSOLVED
    with pytest.raises(UnfairScenarioError, match='no reference driver reaches the goal'):
        build_suite(SuitePlan(('Blocked',), 1, 0), RULE)
    # The second driver sets the limit where the first one does not arrive.
    drive = ReferenceRunner(References('rule', 'expert')).drive(RouteId('Accident', 0))
    assert drive.by == 'expert'
    assert drive.seconds is not None


def test_an_interrupted_call_goes_on_and_ends_with_the_same_file(tmp_path, monkeypatch) -> None:
    plan, journal = SuitePlan((WALKER,), 3, 0), tmp_path / 'examined.jsonl'
    whole = build_suite(plan, RULE)
    examined = []
    original = suite_build.examine

    def stops(runner, job, drives):
        if len(examined) == 2:
            raise KeyboardInterrupt
        examined.append(job)
        return original(runner, job, drives)

    monkeypatch.setattr(suite_build, 'examine', stops)
    with pytest.raises(KeyboardInterrupt):
        build_suite(plan, RULE, journal)
    with journal.open('a') as file:
        file.write('{"type": "PairedWal')
    driven = []
    monkeypatch.setattr(suite_build, 'examine', lambda r, job, d: driven.append(job) or original(r, job, d))
    assert build_suite(plan, RULE, journal) == whole
    assert driven == [(WALKER, 2)]
    # Other settings are another suite: nothing is taken over.
    driven.clear()
    build_suite(SuitePlan((WALKER,), 3, 0, drives=('twin',)), RULE, journal)
    assert len(driven) == 3


def test_two_processes_draw_the_same_suite() -> None:
    plan = SuitePlan(('LaneFollowing', 'HardBreakRoute'), 2, TRAIN_SEED_START)
    assert build_suite(plan, RULE, workers=2) == build_suite(plan, RULE)


def test_build_from_the_command_line(tmp_path, monkeypatch, capsys) -> None:
    from raw2drive_ros.evaluation import suite_plans

    monkeypatch.setattr(
        suite_plans, 'suite_plans', lambda: {'small': SuitePlan((EMPTY,), 2, 0), 'none': SuitePlan((), 2, 0)}
    )
    out = tmp_path / 'made' / 'small.json'
    assert main(['suite', 'build', 'small', '--reference', 'rule', '--out', str(out)]) == 0
    assert 'small.json: 2 routes' in capsys.readouterr().out
    body = json.loads(out.read_text())
    assert (body['format'], body['version']) == (3, '3')
    assert body['limits'] == {'factor': 1.25, 'extra_s': 5.0, 'drivers': ['rule']}
    assert [len(entry['limit_s']) for entry in body['routes'][EMPTY]] == [2, 2]
    assert list(out.parent.iterdir()) == [out]
    assert main(['suite', 'build', 'none', '--out', str(out)]) == 2
    assert main(['suite', 'build', 'small', '--reference', 'nobody', '--out', str(out)]) == 2


def test_event_and_twin_look_alike_until_something_happens(monkeypatch) -> None:
    assert first_difference(EMPTY, 0) is None
    found = first_difference(WALKER, 0)
    assert found is not None
    assert found.what == 'walker'
    assert 10.0 < found.way_m < scene_key(WALKER, 0).parameters['place'].value

    def leaks(draw) -> Scene:
        where = 30.0 if draw.event else 31.0
        return Scene(RoadLayout((Straight(100),), 1, 1), RouteSpec(), (StandingSpec('cone', where, 5.0),))

    registered(monkeypatch, 'Leaks', leaks, paired=True)
    assert first_difference('Leaks', 0).way_m == 0.0
