"""Checkpoints that were damaged after they were written: noticed, named, and replaced by the one before."""

import json
import os
import shutil
from pathlib import Path

import numpy as np
import pytest
import torch
from conftest import NANO
from safetensors.torch import load_file, save_file

from raw2drive_ros.artifact import whole_folder, write_whole
from raw2drive_ros.contracts.errors import CheckpointError
from raw2drive_ros.training.run import train
from raw2drive_ros.world_model.run_files import SUMS, damage_of, newest_checkpoint, read_checkpoint, write_sums
from raw2drive_ros.world_model.teacher import load_teacher

FILES = ('tensors.safetensors', 'state.json', SUMS)


@pytest.fixture
def run(teacher_run, tmp_path):
    """A run with the checkpoints 5 and 10."""
    shutil.copytree(teacher_run, tmp_path / 'run')
    return tmp_path / 'run'


def flip(file, at: float = 0.5) -> None:
    data = bytearray(file.read_bytes())
    data[int(at * len(data))] ^= 1
    file.write_bytes(data)


def cut(file) -> None:
    os.truncate(file, file.stat().st_size // 2)


@pytest.mark.parametrize('name', FILES)
@pytest.mark.parametrize('damage', [flip, cut, lambda file: file.write_bytes(b'')])
def test_one_bit_or_half_a_file_is_noticed_and_the_one_before_is_used(run, name, damage, capsys) -> None:
    newest = run / 'checkpoints' / '00000010'
    assert newest_checkpoint(run / 'checkpoints') == newest
    damage(newest / name)
    assert damage_of(newest)
    assert newest_checkpoint(run / 'checkpoints').name == '00000005'
    said = capsys.readouterr().err
    assert f'{newest} is damaged' in said
    assert 'using the one before, 00000005' in said
    with pytest.raises(CheckpointError, match=newest.name):
        read_checkpoint(newest)


def test_every_single_bit_counts(run) -> None:
    """Numbers in JSON and tensors stay valid when a bit flips; only the hash tells."""
    newest = run / 'checkpoints' / '00000010'
    rng = np.random.default_rng(0)
    for name in FILES[:2]:
        whole = (newest / name).read_bytes()
        for at in rng.uniform(0.0, 1.0, 20):
            flip(newest / name, at)
            assert damage_of(newest), (name, at)
            (newest / name).write_bytes(whole)
    assert not damage_of(newest)


def test_where_no_checkpoint_is_sound_nothing_begins_anew(run, workspace, bags) -> None:
    """Training from scratch would overwrite a run whose weights somebody may still save."""
    for number in ('00000005', '00000010'):
        flip(run / 'checkpoints' / number / 'tensors.safetensors')
    with pytest.raises(CheckpointError, match='no sound checkpoint is left'):
        train('privileged', run, [bags], workspace / 'cache', 15, 'nano', NANO)
    assert sorted(p.name for p in (run / 'checkpoints').iterdir()) == ['00000005', '00000010']


def test_training_goes_on_from_the_one_before_to_the_same_weights(run, workspace, bags, tmp_path, capsys) -> None:
    shutil.copytree(run, tmp_path / 'whole')
    shutil.rmtree(tmp_path / 'whole' / 'checkpoints' / '00000010')
    arguments = [bags], workspace / 'cache', 15, 'nano', NANO
    train('privileged', tmp_path / 'whole', *arguments)
    flip(run / 'checkpoints' / '00000010' / 'tensors.safetensors')
    train('privileged', run, *arguments)
    assert 'using the one before, 00000005' in capsys.readouterr().err
    whole, other = (
        load_file(folder / 'checkpoints' / '00000015' / 'tensors.safetensors') for folder in (tmp_path / 'whole', run)
    )
    assert whole.keys() == other.keys()
    assert all(torch.equal(whole[name], other[name]) for name in whole)
    assert sorted(p.name for p in (run / 'checkpoints').iterdir()) == ['00000010', '00000015']


def test_a_damaged_later_one_is_kept_and_does_not_count_among_the_newest(run, workspace, bags) -> None:
    flip(run / 'checkpoints' / '00000010' / 'tensors.safetensors')
    train('privileged', run, [bags], workspace / 'cache', 8, 'nano', NANO | {'checkpoint_every': 4})
    left = sorted(p.name for p in (run / 'checkpoints').iterdir())
    assert left[:2] == ['00000005', '00000008']
    assert left[2].startswith('00000010.damaged-')
    assert newest_checkpoint(run / 'checkpoints').name == '00000008'


def test_a_checkpoint_of_an_earlier_version_has_no_hashes_and_is_used(run) -> None:
    newest = run / 'checkpoints' / '00000010'
    (newest / SUMS).unlink()
    assert not damage_of(newest)
    assert load_teacher(run).steps == 10
    cut(newest / 'tensors.safetensors')
    assert newest_checkpoint(run / 'checkpoints').name == '00000005'


def test_resuming_with_other_bags_says_so(run, workspace, bags, tmp_path, capsys) -> None:
    arguments = workspace / 'cache', 12, 'nano', NANO
    train('privileged', run, [bags], *arguments)
    assert 'other bags' not in capsys.readouterr().err
    shutil.copytree(bags, tmp_path / 'bags')
    for file in (tmp_path / 'bags').rglob('metadata.yaml'):
        file.write_text(file.read_text() + '\n')
    train('privileged', run, [bags, tmp_path / 'bags'], workspace / 'cache', 14, 'nano', NANO)
    count = len(list(bags.rglob('metadata.yaml')))
    assert f'resumes with other bags than before: {count} new, 0 gone' in capsys.readouterr().err


def test_bags_that_are_too_short_for_a_sequence_are_named(workspace, bags, bag, tmp_path, capsys) -> None:
    from raw2drive_ros.recording.bag_edit import cut as cut_bag

    cut_bag(bag, tmp_path / 'bags' / 'short', 0.0, 0.3)
    (tmp_path / 'bags' / 'link').symlink_to(bag)
    train('privileged', tmp_path / 'run', [bags, tmp_path / 'bags'], workspace / 'cache', 1, 'nano', NANO)
    said = capsys.readouterr().err
    assert '1 linked folders are not followed' in said
    assert 'are shorter than a sequence of' in said
    assert str(tmp_path / 'bags' / 'short') in said


@pytest.mark.parametrize('value', [float('nan'), float('inf')])
def test_weights_of_a_checkpoint_that_are_not_finite_are_refused(run, value) -> None:
    newest = run / 'checkpoints' / '00000010'
    tensors = load_file(newest / 'tensors.safetensors')
    name = next(name for name in tensors if name.startswith('policy/'))
    tensors[name].view(-1)[0] = value
    save_file(tensors, newest / 'tensors.safetensors')
    write_sums(newest)
    with pytest.raises(CheckpointError, match=f'{name} holds weights that are not finite'):
        load_teacher(newest)


def test_files_and_names_are_on_the_disk_before_a_checkpoint_has_its_name(tmp_path, monkeypatch) -> None:
    """The order in which the file system is told; what a loss of power leaves follows from it."""
    done: list[str] = []
    real_sync, real_replace = os.fsync, type(tmp_path).replace

    def sync(handle: int) -> None:
        done.append('sync ' + str(Path(f'/proc/self/fd/{handle}').readlink()).removeprefix(f'{tmp_path}/'))
        real_sync(handle)

    def replace(path, target):
        done.append(f'name {target.name}')
        return real_replace(path, target)

    monkeypatch.setattr(os, 'fsync', sync)
    monkeypatch.setattr(type(tmp_path), 'replace', replace)
    with whole_folder(tmp_path / '00000005', durable=True) as folder:
        (folder / 'tensors').write_text('x')
    partial = f'.00000005.{os.getpid()}.partial'
    assert done == [f'sync {partial}/tensors', f'sync {partial}', 'name 00000005', f'sync {tmp_path}']
    done.clear()
    write_whole(tmp_path / 'config.json', json.dumps({}), durable=True)
    assert done == [f'sync .config.json.{os.getpid()}.partial', 'name config.json', f'sync {tmp_path}']
    done.clear()
    write_whole(tmp_path / 'other', '')
    assert done == ['name other']
