"""The runtime folder is private, or refused in one line."""

import os

import pytest

from raw2drive_ros.contracts.errors import RuntimeFolderError, UserError
from raw2drive_ros.runtime_folder import runtime_folder


@pytest.fixture
def temporary(tmp_path, monkeypatch):
    monkeypatch.delenv('XDG_RUNTIME_DIR', raising=False)
    return tmp_path


def test_it_lies_in_the_session_folder_and_is_private(tmp_path, monkeypatch) -> None:
    monkeypatch.setenv('XDG_RUNTIME_DIR', str(tmp_path))
    previous = os.umask(0)
    try:
        folder = runtime_folder(tmp_path / 'unused')
    finally:
        os.umask(previous)
    assert folder == tmp_path / 'raw2drive'
    assert folder.stat().st_mode & 0o777 == 0o700
    (folder / 'kept').write_text('x')
    assert runtime_folder() == folder and (folder / 'kept').exists()


def test_without_a_session_it_lies_in_the_temporary_folder(temporary) -> None:
    folder = runtime_folder(temporary)
    assert folder == temporary / f'raw2drive-{os.geteuid()}'
    assert folder.stat().st_mode & 0o777 == 0o700


@pytest.mark.parametrize('session', ['', 'relative', '/no/such/folder', 'file'])
def test_a_session_folder_that_is_none_is_passed_over(temporary, monkeypatch, session) -> None:
    if session == 'file':
        session = str(temporary / 'file')
        (temporary / 'file').write_text('')
    monkeypatch.setenv('XDG_RUNTIME_DIR', session)
    assert runtime_folder(temporary).parent == temporary


def test_the_session_folder_of_another_user_is_passed_over(temporary, monkeypatch) -> None:
    """As after `su`, which keeps the variable."""
    (temporary / 'session').mkdir()
    monkeypatch.setenv('XDG_RUNTIME_DIR', str(temporary / 'session'))
    other = os.geteuid() + 1
    monkeypatch.setattr('raw2drive_ros.runtime_folder.os.geteuid', lambda: other)
    with pytest.raises(RuntimeFolderError, match='belongs to another user'):
        # What it makes is owned by the true user, whom it takes for another one: the second check.
        runtime_folder(temporary)
    assert not (temporary / 'session' / 'raw2drive').exists()
    assert (temporary / f'raw2drive-{other}').exists()


@pytest.mark.parametrize('mode', [0o770, 0o755, 0o701])
def test_a_folder_that_others_may_use_is_refused(temporary, mode) -> None:
    runtime_folder(temporary).chmod(mode)
    with pytest.raises(RuntimeFolderError, match='open to other users'):
        runtime_folder(temporary)


def test_a_link_is_refused_and_its_target_left_alone(temporary) -> None:
    (temporary / 'target').mkdir(mode=0o700)
    (temporary / f'raw2drive-{os.geteuid()}').symlink_to(temporary / 'target')
    with pytest.raises(RuntimeFolderError, match='is a link'):
        runtime_folder(temporary)
    assert list((temporary / 'target').iterdir()) == []


def test_what_is_no_folder_or_cannot_be_made_is_one_line(temporary) -> None:
    (temporary / f'raw2drive-{os.geteuid()}').write_text('')
    for folder in (temporary, temporary / 'missing'):
        with pytest.raises(UserError, match='cannot make the runtime folder') as caught:
            runtime_folder(folder)
        assert '\n' not in str(caught.value)
