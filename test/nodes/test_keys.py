"""The key file: made once, by whoever is first, readable by its user only; anything else is one clear error."""

import multiprocessing
import os

import pytest

from raw2drive_ros.contracts.errors import KeyFileError
from raw2drive_ros.nodes.keys import KEY_VARIABLE, key_file, load_key


@pytest.fixture(autouse=True)
def runtime(tmp_path, monkeypatch):
    monkeypatch.setenv('XDG_RUNTIME_DIR', str(tmp_path))
    monkeypatch.delenv(KEY_VARIABLE, raising=False)
    return tmp_path


def test_every_node_of_a_domain_finds_the_same_key() -> None:
    key = load_key(7)
    assert len(key) == 32
    assert load_key(7) == key
    assert load_key(8) != key
    assert key_file(7).stat().st_mode & 0o777 == 0o600
    assert [path.name for path in key_file(7).parent.iterdir() if path.name.startswith('.')] == []


def test_nodes_that_start_at_once_find_the_same_key() -> None:
    with multiprocessing.get_context('fork').Pool(8) as pool:
        assert len(set(pool.map(load_key, [9] * 64))) == 1


def test_a_launcher_may_give_another_file(tmp_path, monkeypatch) -> None:
    monkeypatch.setenv(KEY_VARIABLE, str(tmp_path / 'own.key'))
    key = load_key(7)
    assert (tmp_path / 'own.key').read_bytes() == key


def damaged(kind, path) -> None:
    if kind == 'open to others':
        path.write_bytes(bytes(32))
        path.chmod(0o640)
    elif kind == 'a link':
        target = path.with_name('target')
        target.write_bytes(bytes(32))
        target.chmod(0o600)
        path.symlink_to(target)
    elif kind == 'a pipe':
        os.mkfifo(path, 0o600)
    elif kind == 'a folder':
        path.mkdir(mode=0o700)
    else:
        path.write_bytes(bytes({'short': 31, 'long': 33, 'empty': 0}[kind]))
        path.chmod(0o600)


@pytest.mark.parametrize('kind', ['open to others', 'a link', 'a pipe', 'a folder', 'short', 'long', 'empty'])
def test_what_is_no_key_of_ours_is_refused(kind) -> None:
    path = key_file(7)
    damaged(kind, path)
    with pytest.raises(KeyFileError, match=r'domain_7\.key'):
        load_key(7)
