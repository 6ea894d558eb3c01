"""Folders and files that are whole or not there, whenever their writer is killed."""

import os
import signal
import subprocess
import sys
import time

import pytest
import torch

from raw2drive_ros.artifact import (
    check_manifest,
    load_weights,
    model_card,
    part_of,
    restore_folder,
    save_weights,
    short_hash,
    whole_folder,
    write_whole,
)
from raw2drive_ros.contracts.errors import BundleError


def names(folder) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


def fill(folder, text) -> None:
    (folder / 'content').write_text(text)


def test_a_folder_appears_when_it_is_whole_and_replaces_the_one_before(tmp_path) -> None:
    target = tmp_path / 'bundle'
    for text in ('first', 'second'):
        with whole_folder(target) as folder:
            before = (target / 'content').read_text() if target.exists() else None
            fill(folder, text)
            assert before == (None if text == 'first' else 'first'), 'not there before it is whole'
    assert (target / 'content').read_text() == 'second'
    assert names(tmp_path) == ['bundle'], 'nothing is left beside it'


def test_an_error_while_filling_leaves_what_was_there(tmp_path) -> None:
    target = tmp_path / 'bundle'
    with whole_folder(target) as folder:
        fill(folder, 'first')
    with pytest.raises(OSError, match='no space'), whole_folder(target) as folder:
        fill(folder, 'half')
        raise OSError('no space')
    assert (target / 'content').read_text() == 'first'
    assert names(tmp_path) == ['bundle']


def test_a_kill_between_the_renames_keeps_the_predecessor(tmp_path) -> None:
    target = tmp_path / 'best'
    (tmp_path / '.best.old').mkdir()
    fill(tmp_path / '.best.old', 'first')
    restore_folder(target)
    assert (target / 'content').read_text() == 'first'
    # Killed after the second rename: the predecessor only has to go.
    (tmp_path / '.best.old').mkdir()
    restore_folder(target)
    assert names(tmp_path) == ['best']


def test_a_file_in_the_place_of_the_folder_is_left_alone(tmp_path) -> None:
    (tmp_path / 'bundle').write_text('mine')
    for _ in range(2):
        with pytest.raises(NotADirectoryError, match='is a file'), whole_folder(tmp_path / 'bundle') as folder:
            fill(folder, 'never')
    assert (tmp_path / 'bundle').read_text() == 'mine'
    assert names(tmp_path) == ['bundle']


def test_a_link_to_a_folder_stays_a_link(tmp_path) -> None:
    (tmp_path / 'disk').mkdir()
    (tmp_path / 'link').symlink_to(tmp_path / 'disk')
    for text in ('first', 'second'):
        with whole_folder(tmp_path / 'link') as folder:
            fill(folder, text)
    assert (tmp_path / 'link').is_symlink()
    assert (tmp_path / 'disk' / 'content').read_text() == 'second'
    assert names(tmp_path) == ['disk', 'link']


def test_what_a_killed_writer_left_goes_after_a_day(tmp_path) -> None:
    old, young = (tmp_path / f'.bundle.{pid}.partial' for pid in (1, 2))
    for left, age_s in ((old, 25 * 3600), (young, 3600)):
        left.mkdir()
        os.utime(left, (time.time() - age_s,) * 2)
    with whole_folder(tmp_path / 'bundle') as folder:
        fill(folder, 'whole')
    assert names(tmp_path) == [young.name, 'bundle']


BUILDERS = """
import sys
from pathlib import Path
from raw2drive_ros.artifact import whole_folder
for number in range(300):
    target = Path(sys.argv[1]) / str(number)
    if not target.is_dir():
        with whole_folder(target, keep_existing=True) as folder:
            for name in range(5):
                (folder / str(name)).write_text('same')
    assert len([(target / str(name)).read_text() for name in range(5)]) == 5
"""


def test_two_builders_of_one_cache_do_not_disturb_each_other(tmp_path) -> None:
    command = [sys.executable, '-c', BUILDERS, str(tmp_path)]
    processes = [subprocess.Popen(command, stderr=subprocess.PIPE, text=True) for _ in range(3)]
    errors = [process.communicate()[1] for process in processes]
    assert errors == ['', '', '']
    assert names(tmp_path) == sorted(str(number) for number in range(300))


KILLED = """
import sys, time
from pathlib import Path
from raw2drive_ros.artifact import whole_folder, write_whole
target = Path(sys.argv[1])
number = 0
while True:
    number += 1
    with whole_folder(target / 'folder') as folder:
        for name in range(20):
            (folder / f'{name}').write_text(str(number))
    write_whole(target / 'file', f'{number} ' * 2000)
    print(number, flush=True)
"""


def test_killed_writers_leave_whole_folders_and_files(tmp_path) -> None:
    for _ in range(5):
        process = subprocess.Popen([sys.executable, '-c', KILLED, str(tmp_path)], stdout=subprocess.PIPE)
        for _ in range(20):
            process.stdout.readline()
        process.send_signal(signal.SIGKILL)
        process.wait()
        restore_folder(tmp_path / 'folder')
        files = sorted((tmp_path / 'folder').iterdir())
        assert len(files) == 20
        assert len({file.read_text() for file in files}) == 1
        assert len(set((tmp_path / 'file').read_text().split())) == 1


def test_weights_are_shared_half_precision_and_checked(tmp_path) -> None:
    tensors = {'model/a': torch.linspace(0.0, 1.0, 7), 'policy/b': torch.ones(2, 2)}
    identity = save_weights(tmp_path, tensors)
    file = tmp_path / 'weights.safetensors'
    assert identity == short_hash(file.read_bytes())
    assert file.stat().st_mode & 0o777 == 0o644, 'whoever may read the folder may read the weights'
    loaded = load_weights(tmp_path, identity, BundleError)
    assert torch.equal(part_of(loaded, 'model')['a'], tensors['model/a'].half().float())
    assert list(part_of(loaded, 'pol')) == [], 'whole words only'
    file.write_bytes(file.read_bytes()[:-1] + b'\x01')
    with pytest.raises(BundleError, match='do not match their hash'):
        load_weights(tmp_path, identity, BundleError)


def test_manifests_of_another_format_or_with_other_hashes_are_refused(tmp_path) -> None:
    body = {'format': 1, 'action_table': 'abc'}
    check_manifest(tmp_path, body, 'bundle', 1, {'action_table': 'abc'}, BundleError)
    with pytest.raises(BundleError, match='bundle format 1, this version reads 2'):
        check_manifest(tmp_path, body, 'bundle', 2, {}, BundleError)
    with pytest.raises(BundleError, match='action_table hash abc differs from this version: xyz'):
        check_manifest(tmp_path, body, 'bundle', 1, {'action_table': 'xyz'}, BundleError)


def test_a_card_shows_the_length_of_long_lists() -> None:
    card = model_card('Title `1`', 'Drives.', ['RSSM 64'], {'training_bags': ['a', 'b'], 'preset': 'nano'})
    assert card.startswith('# Title `1`\n\nDrives.\n\n- RSSM 64\n- training_bags: 2\n- preset: nano\n')
    assert 'not for real roads' in card


def test_write_whole_takes_text_and_bytes(tmp_path) -> None:
    assert write_whole(tmp_path / 'a', 'ä').read_text(encoding='utf-8') == 'ä'
    assert write_whole(tmp_path / 'a', b'\x00').read_bytes() == b'\x00'
    assert names(tmp_path) == ['a']
