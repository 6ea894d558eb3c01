"""`train --show-config` says what would be trained with, and where each value comes from; `--set help` lists fields."""

import json

import pytest

from raw2drive_ros.cli.main import main
from raw2drive_ros.training.config import TrainConfig, make_config
from raw2drive_ros.world_model.config import ModelConfig


def shown(words: list[str], capsys) -> dict[str, tuple[str, str]]:
    """field -> (source, value)."""
    assert main(['train', 'privileged', *words, '--show-config']) == 0
    printed = capsys.readouterr().out
    rows = [line for line in printed.splitlines() if line.startswith(('model.', 'train.'))]
    # Sources have one or two words and are padded.
    return {row[:24].strip(): (row[25:43].strip(), row[44:].strip()) for row in map(aligned, rows)}


def aligned(row: str) -> str:
    name, rest = row.split(' ', 1)
    rest = rest.lstrip()
    return f'{name:24} {rest}'


def test_a_new_run_has_defaults_its_preset_and_what_is_set(capsys) -> None:
    found = shown(['--preset', 'nano', '--set', 'seed=3', '--set', 'share=none'], capsys)
    expected = make_config('nano', {'seed': 3, 'share': 'none'})
    values = {f'model.{name}': value for name, value in expected.model.model_dump().items()}
    values |= {f'train.{name}': value for name, value in expected.train.model_dump().items()}
    assert {name: value for name, (_, value) in found.items()} == {name: str(value) for name, value in values.items()}
    sources = {name: source for name, (source, _) in found.items()}
    assert sources['train.seed'] == sources['train.share_rssm'] == sources['train.share_decoder'] == '--set'
    assert sources['train.batch'] == sources['model.deter'] == 'preset nano'
    assert sources['train.entropy'] == 'default'


def test_an_existing_run_shows_its_own_configuration(teacher_run, capsys) -> None:
    found = shown(['--run', str(teacher_run), '--set', 'model_lr=0.5'], capsys)
    assert found['train.model_lr'] == ('--set', '0.5')
    assert found['train.checkpoint_every'] == ('the run', '5')
    stored = json.loads((teacher_run / 'config.json').read_text())['config']
    assert found['model.deter'] == ('the run', str(stored['model']['deter']))
    before = (teacher_run / 'config.json').read_bytes()
    assert main(['train', 'privileged', '--run', str(teacher_run), '--preset', 'laptop', '--show-config']) == 2
    assert 'is a run of preset nano and keeps it' in capsys.readouterr().err
    assert (teacher_run / 'config.json').read_bytes() == before


def test_a_recipe_shows_its_rounds(capsys) -> None:
    found = shown(['--recipe', 'teacher', '--set', 'starts=7'], capsys)
    assert found['train.weight_advice'] == ('the recipe', '20.0')
    assert found['train.starts'] == ('--set', '7')
    assert main(['train', 'privileged', '--recipe', 'teacher', '--show-config']) == 0
    assert 'from round 9 on: model_lr=0.0005, policy_lr=0.00015' in capsys.readouterr().out


def test_every_field_of_set_is_listed(capsys) -> None:
    assert main(['train', 'privileged', '--set', 'help']) == 0
    printed = capsys.readouterr().out
    listed = [line.split('│')[1].strip() for line in printed.splitlines() if line.startswith('│')]
    assert listed == list(TrainConfig.model_fields)
    assert "Literal['raw', 'privileged', 'independent']" in printed
    assert 'last share of the run in which learning rates fall' in printed


def test_nothing_left_to_train_is_said(bags, teacher_run, workspace, capsys) -> None:
    words = ['train', 'privileged', '--bags', str(bags), '--run', str(teacher_run), '--steps', '3']
    assert main([*words, '--cache', str(workspace / 'cache')]) == 0
    assert 'nothing to train: the run has more steps than --steps 3' in capsys.readouterr().err


@pytest.mark.parametrize('name', ['deter', 'latent'])
def test_fields_of_the_model_are_not_set(name, capsys) -> None:
    assert name in ModelConfig.model_fields
    assert main(['train', 'privileged', '--set', f'{name}=1', '--show-config']) == 2
    assert f'{name}: no such key' in capsys.readouterr().err
