"""Ctrl-C during an evaluation: the table of what was driven, no traceback, and how to go on."""

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from raw2drive_ros.cli.main import main
from raw2drive_ros.evaluation import evaluate, fault_matrix
from raw2drive_ros.evaluation.results import read_results

ROOT = Path(__file__).resolve().parents[2]
WORDS = ['evaluate', '--driver', 'straight', '--routes', 'LaneFollowing', '--seeds', '4']


@pytest.fixture
def ctrl_c_in_the_third_route(monkeypatch):
    drive = evaluate.RouteRunner.drive

    def stopping(self, route):
        if route.seed == 2:
            raise KeyboardInterrupt
        return drive(self, route)

    monkeypatch.setattr(evaluate.RouteRunner, 'drive', stopping)
    return monkeypatch


def test_the_table_so_far_is_printed(ctrl_c_in_the_third_route, capsys) -> None:
    assert main(WORDS) == 130
    printed = capsys.readouterr()
    assert 'LaneFollowing/0' in printed.out and 'LaneFollowing/1' in printed.out
    assert 'LaneFollowing/2' not in printed.out
    assert 'of 2 routes with completion' in printed.out
    assert printed.err == (
        'interrupted: the figures are of 2 of 4 routes; with --out FILE the same command goes on where it was\n'
    )


def test_with_a_file_the_same_command_goes_on(ctrl_c_in_the_third_route, tmp_path, capsys) -> None:
    words = [*WORDS, '--json', '--out', str(tmp_path / 'rows.jsonl')]
    assert main(words) == 130
    printed = capsys.readouterr()
    assert [row['seed'] for row in json.loads(printed.out)['routes']] == [0, 1]
    assert 'of 2 of 4 routes; the same command goes on' in printed.err
    ctrl_c_in_the_third_route.undo()
    assert main(words) == 0
    assert [row['seed'] for row in json.loads(capsys.readouterr().out)['routes']] == [0, 1, 2, 3]


def test_ctrl_c_before_the_first_row_prints_no_table(monkeypatch, capsys) -> None:
    def stopping(self, route):
        raise KeyboardInterrupt

    monkeypatch.setattr(evaluate.RouteRunner, 'drive', stopping)
    assert main(WORDS) == 130
    printed = capsys.readouterr()
    assert printed.out == ''
    assert 'figures are of 0 of 4' in printed.err


def test_workers_end_without_a_word(tmp_path) -> None:
    rows = tmp_path / 'rows.jsonl'
    command = [sys.executable, '-m', 'raw2drive_ros.cli.main', 'evaluate', '--driver', 'straight', '--routes', 'all']
    command += ['--seeds', '50', '--workers', '2', '--out', str(rows)]
    # A terminal sends Ctrl-C to the whole group.
    process = subprocess.Popen(
        command, cwd=ROOT, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, start_new_session=True
    )
    deadline = time.monotonic() + 120.0
    while not rows.exists() or len(rows.read_text().splitlines()) < 4:
        assert process.poll() is None, process.stderr.read()
        assert time.monotonic() < deadline
        time.sleep(0.05)
    os.killpg(process.pid, signal.SIGINT)
    out, err = process.communicate(timeout=60)
    assert process.returncode == 130
    assert 'Traceback' not in err
    done = len(read_results(rows).rows)
    assert f'interrupted: the figures are of {done} of ' in err
    assert f'of {done} routes with completion' in out


def test_faults_keep_the_plans_so_far(monkeypatch, tmp_path, capsys) -> None:
    class Pool:
        """Two drives, then Ctrl-C."""

        def __init__(self, *args) -> None: ...

        def __enter__(self):
            return self

        def __exit__(self, *error) -> None: ...

        def imap(self, function, jobs):
            for job in jobs[:2]:
                row = dict.fromkeys(('reaction_s', 'standing_s')) | {'causes': [], 'reason': '', 'touched': {}}
                yield row | {'plan': job.plan, 'driving_score': 50.0, 'collisions': 0}
            raise KeyboardInterrupt

    monkeypatch.setattr(fault_matrix.multiprocessing, 'get_context', lambda kind: type('', (), {'Pool': Pool}))
    rows = tmp_path / 'rows.jsonl'
    words = ['evaluate faults', '--routes', 'LaneFollowing', '--seeds', '3', '--out', str(rows)]
    assert main(words) == 130
    printed = capsys.readouterr()
    assert 'none' in printed.out
    assert 'interrupted after 2 of ' in printed.err
    assert len(rows.read_text().splitlines()) == 2
