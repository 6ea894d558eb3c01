"""Recipes: rounds in order, resumed where they stopped, the best round kept; and the teacher bundle at their end."""

import json

import pytest
import torch

from raw2drive_ros.cli.main import main
from raw2drive_ros.contracts import topics
from raw2drive_ros.contracts.errors import CheckpointError, ConfigError, UnknownScenarioError
from raw2drive_ros.evaluation.metrics import score_route
from raw2drive_ros.evaluation.recipe_rounds import failures_by_type, keep_if_best, run_recipe
from raw2drive_ros.evaluation.results import RowsFile, header_of
from raw2drive_ros.evaluation.routes import weighted_types
from raw2drive_ros.recording.bag_reader import find_bags, open_bag
from raw2drive_ros.recording.ticks import read_advice
from raw2drive_ros.simulation.route_id import RouteId
from raw2drive_ros.training.dataset import RosbagsFactory
from raw2drive_ros.training.export import export_teacher, training_metadata
from raw2drive_ros.training.recipe import Collection, Recipe, load_recipe
from raw2drive_ros.world_model.run_files import newest_checkpoint
from raw2drive_ros.world_model.teacher import load_teacher, teacher_identity

FIELDS = {
    'threads': 1,
    'log_every': 2,
    'picture_every': 100,
    'checkpoint_every': 2,
    'imitate': 1.0,
    'weight_advice': 1.0,
}
ROUNDS = [
    {'collect': [{'driver': 'expert', 'table': True, 'noise': 0.05, 'ticks': 60}], 'steps': 4},
    {'collect': [{'driver': 'privileged', 'advice': True, 'advice_every': 8, 'ticks': 40}], 'steps': 2},
]


def recipe_of(rounds) -> Recipe:
    return Recipe(preset='nano', routes='lane-following', episode_ticks=30, validation='', set=FIELDS, rounds=rounds)


@pytest.fixture(scope='module')
def run(tmp_path_factory):
    """A run of two rounds; the second was added to the recipe when the first was done."""
    folder = tmp_path_factory.mktemp('recipe')
    run_recipe(recipe_of(ROUNDS[:1]), folder / 'run', folder / 'cache', {}, 1)
    first = {p.name: p.stat().st_mtime_ns for p in (folder / 'run' / 'bags').iterdir()}
    assert newest_checkpoint(folder / 'run' / 'checkpoints').name == '00000004'
    run_recipe(recipe_of(ROUNDS), folder / 'run', folder / 'cache', {}, 1)
    assert first.items() <= {p.name: p.stat().st_mtime_ns for p in (folder / 'run' / 'bags').iterdir()}.items()
    return folder / 'run'


def test_every_round_collects_and_trains_on_all_bags(run) -> None:
    assert sorted(p.name for p in (run / 'bags').iterdir()) == ['00_0_expert', '01_0_privileged']
    config = json.loads((run / 'config.json').read_text())
    assert {b['path'].split('/')[-2] for b in config['bags']} == {'00_0_expert', '01_0_privileged'}
    assert newest_checkpoint(run / 'checkpoints').name == '00000006'


def test_bags_that_a_round_leaves_out_are_left_out_from_then_on(tmp_path) -> None:
    for name in ('00_0_expert', '00_1_expert', '01_0_privileged'):
        (tmp_path / name).mkdir()
    recipe = recipe_of([*ROUNDS, {'steps': 2, 'without': ['00_*_expert']}, {'steps': 2}])
    assert recipe.bags(1, tmp_path) == [tmp_path]
    assert (
        [p.name for p in recipe.bags(2, tmp_path)] == ['01_0_privileged'] == [p.name for p in recipe.bags(3, tmp_path)]
    )


def test_the_policy_s_bags_hold_the_expert_s_advice(run) -> None:
    (path,) = find_bags([run / 'bags' / '01_0_privileged'])
    with open_bag(path) as reader:
        advice = read_advice(reader, RosbagsFactory())
        ticks = next(c.msgcount for c in reader.connections if c.topic == topics.BEV)
    assert abs(len(advice) - ticks / 2) <= 6, 'four ticks in a row out of eight'
    assert all(0 <= advised.action < 39 for advised in advice.values())


def test_a_finished_recipe_has_nothing_left_to_do(run) -> None:
    before = (run / 'metrics.jsonl').read_text()
    run_recipe(recipe_of(ROUNDS), run, run.parent / 'cache', {}, 1)
    assert (run / 'metrics.jsonl').read_text() == before


def test_a_failed_collector_is_an_error_that_names_its_log(tmp_path) -> None:
    rounds = [{'collect': [{'driver': 'nobody', 'ticks': 10}], 'steps': 1}]
    with pytest.raises(CheckpointError, match=r'collect failed .*00_0_nobody.log.*unknown driver'):
        run_recipe(recipe_of(rounds), tmp_path / 'run', tmp_path / 'cache', {}, 1)


def test_the_best_round_is_kept(run, tmp_path) -> None:
    checkpoint = newest_checkpoint(run / 'checkpoints')
    assert keep_if_best(tmp_path, checkpoint, {'driving_score': 30.0, 'round': 1})
    assert not keep_if_best(tmp_path, checkpoint, {'driving_score': 20.0, 'round': 2})
    assert keep_if_best(tmp_path, checkpoint, {'driving_score': 31.0, 'round': 3})
    assert json.loads((tmp_path / 'best' / 'score.json').read_text())['round'] == 3
    (tmp_path / 'best').rename(tmp_path / '.best.old')
    assert not keep_if_best(tmp_path, checkpoint, {'driving_score': 30.5, 'round': 4}), 'killed between two renames'
    assert json.loads((tmp_path / 'best' / 'score.json').read_text())['round'] == 3


def test_settings_add_up_and_the_command_line_wins() -> None:
    rounds = [{'steps': 1, 'set': {'starts': 4}}, {'steps': 2, 'set': {'imitate': 0.5}}]
    recipe = Recipe(set={'starts': 2, 'gamma': 0.9}, rounds=rounds)
    assert recipe.settings(1, {'gamma': 0.8}) == {'starts': 4, 'gamma': 0.8, 'imitate': 0.5}
    assert [recipe.total_steps(i) for i in range(2)] == [1, 3]
    seeds = {recipe.seed(s, r, i) for s in range(3) for r in range(5) for i in range(10)}
    assert len(seeds) == 150, 'no two collections drive the same routes'


def test_shipped_recipes_are_read_and_mistakes_are_named(tmp_path) -> None:
    assert load_recipe('teacher').rounds
    with pytest.raises(ConfigError, match=r'known: .*teacher'):
        load_recipe('nobody')
    broken = tmp_path / 'broken.yaml'
    broken.write_text('rounds:\n  - {collect: [{driver: expert, tick: 5}], steps: 1}\n')
    with pytest.raises(ConfigError, match=r'rounds\.0\.collect\.0\.tick'):
        load_recipe(str(broken))


def test_a_teacher_bundle_decides_as_its_run_does(run, tmp_path) -> None:
    identity = export_teacher(run, tmp_path / 'teacher')
    bundle, original = load_teacher(tmp_path / 'teacher'), load_teacher(run)
    assert identity == teacher_identity(tmp_path / 'teacher') != teacher_identity(run)
    feature = torch.randn(20, original.config.feature_size)
    assert torch.allclose(bundle.policy.actor(feature), original.policy.actor(feature), atol=2e-2)
    assert torch.allclose(bundle.model.reward(feature), original.model.reward(feature), atol=2e-2)
    assert bundle.model.advice is None and original.model.advice is not None
    assert 'RSSM' in (tmp_path / 'teacher' / 'MODEL_CARD.md').read_text()
    weights = tmp_path / 'teacher' / 'weights.safetensors'
    weights.write_bytes(weights.read_bytes()[:-1] + b'\x01')
    with pytest.raises(CheckpointError, match='do not match their hash'):
        load_teacher(tmp_path / 'teacher')


def test_recipe_and_bags_exclude_each_other(capsys) -> None:
    assert main(['train', 'privileged', '--recipe', 'teacher', '--bags', 'bags', '--run', 'runs/never']) == 2
    assert 'collects its own bags' in capsys.readouterr().err
    assert main(['train', 'privileged', '--run', 'runs/never']) == 2
    assert 'give --bags' in capsys.readouterr().err


def test_a_focused_collection_drives_more_of_what_failed(tmp_path) -> None:
    (tmp_path / 'validation').mkdir()
    for number, wins in ((1, [True]), (2, [False, True]), (3, [False, False])):
        routes = [RouteId('ParkedObstacle', seed) for seed in range(len(wins))] + [RouteId('HighwayExit', 0)]
        file = RowsFile(
            tmp_path / 'validation' / f'round_{number:02d}.jsonl', header_of('privileged', 'validation', '1', routes)
        )
        for route, won in zip(routes, [*wins, True], strict=True):
            file.add(score_route(route, 100.0 if won else 50.0, {}, '' if won else 'timeout', 0.0))
    failed = failures_by_type(tmp_path, 3)
    assert failed == {'ParkedObstacle': 0.75, 'HighwayExit': 0.0}
    assert failures_by_type(tmp_path, 0) == {}
    # Killed validations leave half a row, or a file without a header.
    with (tmp_path / 'validation' / 'round_03.jsonl').open('a') as file:
        file.write('{"id": "ParkedObst')
    (tmp_path / 'validation' / 'round_04.jsonl').write_text('')
    assert failures_by_type(tmp_path, 4) == {'ParkedObstacle': 1.0, 'HighwayExit': 0.0}
    collection = Collection(driver='privileged', ticks=10, focus=4)
    arguments = collection.arguments(recipe_of(ROUNDS), 1, tmp_path, tmp_path / 'out', failed)
    assert arguments[arguments.index('--routes') + 1] == 'lane-following,ParkedObstacle*3'


def test_weighted_types_are_repeated() -> None:
    kinds = weighted_types('all,ParkedObstacle*3')
    assert kinds.count('ParkedObstacle') == 4
    assert set(kinds) == set(weighted_types('all'))
    assert len(weighted_types('all,ParkedObstacle')) == len(weighted_types('all')) == len(kinds) - 3
    for wrong in ('ParkedObstacle*', 'ParkedObstacle*0', 'ParkedObstacle*x'):
        with pytest.raises(UnknownScenarioError, match='whole number'):
            weighted_types(wrong)


@pytest.mark.parametrize(
    'damage',
    [
        lambda body: body['config'].update(train=[]),
        lambda body: body['config']['model'].update(deter=0),
        lambda body: body['config']['model'].update(blocks=7),
        lambda body: body.update(steps=None),
        lambda body: body.update(config=[]),
        lambda body: body.pop('facts'),
        lambda body: body.update(action_table='x'),
    ],
)
def test_a_damaged_teacher_manifest_is_one_clear_error(run, tmp_path, damage) -> None:
    export_teacher(run, tmp_path / 'teacher')
    manifest = tmp_path / 'teacher' / 'teacher.json'
    body = json.loads(manifest.read_text())
    damage(body)
    manifest.write_text(json.dumps(body))
    with pytest.raises(CheckpointError) as error:
        load_teacher(tmp_path / 'teacher')
    assert len(str(error.value).splitlines()) == 1


def test_the_validation_of_a_card_is_of_the_checkpoint_that_is_exported(run) -> None:
    assert ('validation' in training_metadata(run)) == (run / 'best').is_dir()
    newest = newest_checkpoint(run / 'checkpoints')
    assert 'validation' not in training_metadata(newest)
