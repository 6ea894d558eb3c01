"""Starting a graph in a folder, or on a machine, that others have prepared: nothing of theirs runs or is written to."""

import fcntl
import os
import socket
import subprocess
import sys
import time

import pytest

from raw2drive_ros.contracts.errors import DomainBusyError
from raw2drive_ros.evaluation.recipe_rounds import Job
from raw2drive_ros.graph.processes import reserve_domain, running_graph
from raw2drive_ros.safe_path import safe_path_variables

LOCK = 'raw2drive_domain_50.lock'
PLANTED = "open('planted', 'a').close()\n"
# As the verbs start their pools.
WORKERS = """
import argparse, multiprocessing
from raw2drive_ros.cli.guard import guarded

def run(options):
    with multiprocessing.get_context('spawn').Pool(1) as pool:
        return pool.apply(int)

if __name__ == '__main__':
    raise SystemExit(guarded(run, argparse.Namespace()))
"""


@pytest.fixture
def foreign_folder(tmp_path, monkeypatch):
    """The working directory, with files named like modules that every process imports; PYTHONPATH with empty parts."""
    folder = tmp_path / 'foreign'
    folder.mkdir()
    for name in ('rclpy', 'json', 'argparse', 'runpy', 'pickle'):
        (folder / f'{name}.py').write_text(PLANTED)
    monkeypatch.chdir(folder)
    monkeypatch.setenv('PYTHONPATH', os.pathsep + os.environ.get('PYTHONPATH', '') + os.pathsep)
    return folder


def test_a_node_imports_nothing_from_the_working_directory(foreign_folder, tmp_path) -> None:
    with reserve_domain(None) as domain, running_graph(tmp_path / 'logs', domain) as graph:
        graph.start('safety_gate', {'clock': 'steady'}, sim_time=False)
        deadline = time.monotonic() + 30.0
        while 'shipped gate.yaml' not in (log := (tmp_path / 'logs' / 'safety_gate.log').read_text()):
            assert time.monotonic() < deadline, log
            time.sleep(0.1)
        graph.check()
    assert not (foreign_folder / 'planted').exists()


def test_verbs_of_recipes_import_nothing_from_the_working_directory(foreign_folder, tmp_path) -> None:
    job = Job(['scenario', 'list'], tmp_path / 'log')
    job.finish()
    assert 'LaneFollowing' in (tmp_path / 'log').read_text()
    assert not (foreign_folder / 'planted').exists()


def test_worker_processes_import_nothing_from_the_working_directory(foreign_folder, tmp_path) -> None:
    """Started from a command, which looks for modules in its own folder first, not in the working directory."""
    command = tmp_path / 'raw2drive'
    command.write_text(WORKERS)
    paths = os.environ | {'PYTHONPATH': safe_path_variables()['PYTHONPATH']}
    child = subprocess.run([sys.executable, str(command)], env=paths, capture_output=True, text=True, timeout=120)
    assert child.returncode == 0, child.stderr[-2000:]
    assert not (foreign_folder / 'planted').exists()


def test_a_lock_is_private_and_keeps_its_content(tmp_path) -> None:
    (tmp_path / LOCK).write_text('kept')
    with reserve_domain(50, tmp_path), pytest.raises(DomainBusyError), reserve_domain(50, tmp_path):
        pass
    assert (tmp_path / LOCK).read_text() == 'kept'
    with reserve_domain(51, tmp_path):
        assert (tmp_path / 'raw2drive_domain_51.lock').stat().st_mode & 0o777 == 0o600


def plant_link(path) -> None:
    (path.parent / 'target').write_text('precious')
    path.symlink_to(path.parent / 'target')


def plant_lock_of_another_graph(path) -> None:
    handle = path.open('w')
    fcntl.flock(handle, fcntl.LOCK_EX)
    plant_lock_of_another_graph.kept = handle


@pytest.mark.parametrize(
    'plant',
    [plant_link, plant_lock_of_another_graph, lambda path: path.mkdir(), os.mkfifo],
    ids=['link', 'locked', 'folder', 'pipe'],
)
def test_a_lock_that_cannot_be_had_means_the_next_domain(tmp_path, plant) -> None:
    plant(tmp_path / LOCK)
    with reserve_domain(None, tmp_path) as domain:
        assert domain > 50
    with pytest.raises(DomainBusyError), reserve_domain(50, tmp_path):
        pass
    assert not (tmp_path / 'target').exists() or (tmp_path / 'target').read_text() == 'precious'


def test_the_lock_of_another_user_means_the_next_domain(tmp_path, monkeypatch) -> None:
    """Their file where ours should be, and their graph, whose folder nobody else can look into."""
    (tmp_path / LOCK).write_text('')
    other = os.geteuid() + 1
    with monkeypatch.context() as patched:
        patched.setattr('raw2drive_ros.graph.processes.os.geteuid', lambda: other)
        with pytest.raises(DomainBusyError), reserve_domain(50, tmp_path):
            pass
    (tmp_path / 'ours').mkdir()
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as theirs:
        theirs.bind('\0raw2drive_domain_50')
        with reserve_domain(None, tmp_path / 'ours') as domain:
            assert domain > 50
