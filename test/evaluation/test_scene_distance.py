"""How near the scenes of two suites are: splits keep apart, and copies are refused."""

import json

import paired_types
import pytest
from paired_types import EMPTY, WALKER

from raw2drive_ros.cli.main import main
from raw2drive_ros.evaluation.scene_distance import (
    APART,
    DUPLICATE,
    NEAR_COPY,
    NEW_TYPE,
    UNKNOWN,
    SceneKey,
    apart,
    nearest_scenes,
)
from raw2drive_ros.evaluation.suites import load_suite
from raw2drive_ros.simulation.draws import GAP, Parameter


@pytest.fixture(autouse=True)
def _paired(monkeypatch) -> None:
    paired_types.register(monkeypatch)


def suite_of(tmp_path, name, routes):
    path = tmp_path / f'{name}.json'
    places = {kind: [{'seed': seed, 'weather': 'ClearNoon'} for seed in seeds] for kind, seeds in routes.items()}
    path.write_text(json.dumps({'format': 3, 'name': name, 'version': '3', 'routes': places}))
    return str(path)


def test_scenes_of_different_splits_are_a_gap_apart(tmp_path) -> None:
    a = load_suite(suite_of(tmp_path, 'a', {WALKER: range(12), EMPTY: range(12)}))
    b = load_suite(suite_of(tmp_path, 'b', {WALKER: range(100_000, 100_030), EMPTY: range(100_000, 100_030)}))
    found = nearest_scenes(a, b)
    assert len(found) == 24
    assert {scene.verdict for scene in found} == {APART}
    assert min(scene.distance for scene in found) >= GAP - 1e-6


def test_a_copy_is_refused_and_so_is_a_near_copy(tmp_path, capsys) -> None:
    a = suite_of(tmp_path, 'a', {WALKER: [0, 1]})
    b = suite_of(tmp_path, 'b', {WALKER: [1, 100_000]})
    first, second = nearest_scenes(load_suite(a), load_suite(b))
    # A scene is not compared with itself, only with others.
    assert (first.verdict, second.other) == (APART, 100_000)
    other = suite_of(tmp_path, 'c', {WALKER: [2, 100_000]})
    assert main(['suite', 'distance', b, other]) == 0
    assert 'refused' not in capsys.readouterr().err
    assert {scene.verdict for scene in nearest_scenes(load_suite(a), load_suite(other), near_copy=1.0)} == {NEAR_COPY}


def test_scenes_without_key_parameters_are_compared_whole(tmp_path, monkeypatch, capsys) -> None:
    from raw2drive_ros.simulation import scenario
    from raw2drive_ros.simulation.layout import RoadLayout, Straight
    from raw2drive_ros.simulation.scenario import Scenario, Scene

    def draw(parameters) -> Scene:
        return Scene(RoadLayout((Straight(100 + 10 * (parameters.seed % 3)),)))

    monkeypatch.setitem(scenario.REGISTRY, 'Poor', Scenario('Poor', (), draw))
    a, b = suite_of(tmp_path, 'a', {'Poor': [0, 1]}), suite_of(tmp_path, 'b', {'Poor': [100_001, 100_003]})
    verdicts = [(scene.seed, scene.verdict, scene.other) for scene in nearest_scenes(load_suite(a), load_suite(b))]
    assert verdicts == [(0, UNKNOWN, None), (1, DUPLICATE, 100_003)]
    assert main(['suite', 'distance', a, b]) == 1
    printed = capsys.readouterr()
    assert 'refused: 1 of 2 scenes of a: Poor/1 is a duplicate of Poor/100003' in printed.err
    assert 'Poor' in printed.out
    assert main(['suite', 'distance', a, b, '--json']) == 1
    body = json.loads(capsys.readouterr().out)
    assert [scene['verdict'] for scene in body['scenes']] == [UNKNOWN, DUPLICATE]


def test_a_type_that_the_other_suite_lacks_is_new(tmp_path) -> None:
    a, b = suite_of(tmp_path, 'a', {WALKER: [0]}), suite_of(tmp_path, 'b', {EMPTY: [100_000]})
    (only,) = nearest_scenes(load_suite(a), load_suite(b))
    assert (only.verdict, only.distance) == (NEW_TYPE, None)


def test_the_distance_is_that_of_the_most_different_key_parameter() -> None:
    def key(place, side):
        parameters = {'place': Parameter(place, (0.0, 10.0), key=True), 'side': Parameter(side, None, key=True)}
        return SceneKey('X', 0, parameters, '')

    assert apart(key(2.0, 'left'), key(4.5, 'left')) == pytest.approx(0.25)
    assert apart(key(2.0, 'left'), key(2.0, 'right')) == 1.0


def test_two_suites_are_asked_for(capsys) -> None:
    assert main(['suite', 'distance', 'dev10']) == 2
    assert 'needs two suites' in capsys.readouterr().err
