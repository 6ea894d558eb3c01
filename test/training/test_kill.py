"""Training that is killed at any moment and called again ends with the weights of an uninterrupted run."""

import json
import os
import random
import signal
import subprocess
import sys
import time

import pytest
from safetensors.torch import load_file

STEPS, KILLS = 120, 10


def _start(bags, cache, run):
    command = [sys.executable, '-m', 'raw2drive_ros.cli.main', 'train', 'privileged', '--preset', 'nano']
    command += ['--steps', str(STEPS), '--bags', str(bags), '--cache', str(cache), '--run', str(run)]
    for field in ('threads=1', 'log_every=2', 'picture_every=50', 'checkpoint_every=4', 'imitate=1.0'):
        command += ['--set', field]
    return subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE)


def _finish(process):
    _, errors = process.communicate(timeout=300)
    assert process.returncode == 0, errors.decode()[-2000:]


def _steps_logged(run) -> int:
    file = run / 'metrics.jsonl'
    return len(file.read_text().splitlines()) if file.exists() else 0


@pytest.mark.long
def test_ten_kills_change_nothing(bags, workspace, tmp_path) -> None:
    _finish(_start(bags, workspace / 'cache', tmp_path / 'whole'))
    chance = random.Random(0)
    run = tmp_path / 'killed'
    for _ in range(KILLS):
        process = _start(bags, workspace / 'cache', run)
        before = _steps_logged(run)
        while process.poll() is None and _steps_logged(run) <= before:
            time.sleep(0.005)
        # Anywhere from the first logged step on: in a step, in a checkpoint, between the two.
        time.sleep(chance.uniform(0.0, 0.15))
        assert process.poll() is None, 'it was done before it could be killed: make the run longer'
        os.kill(process.pid, signal.SIGKILL)
        process.wait()
        process.stderr.close()
    _finish(_start(bags, workspace / 'cache', run))
    whole, killed = (
        load_file(tmp_path / r / 'checkpoints' / f'{STEPS:08d}' / 'tensors.safetensors') for r in ('whole', 'killed')
    )
    assert whole.keys() == killed.keys()
    assert not [name for name in whole if not whole[name].equal(killed[name])]
    logs = []
    for folder in (tmp_path / 'whole', run):
        lines = [json.loads(line) for line in (folder / 'metrics.jsonl').read_text().splitlines()]
        logs.append([{k: v for k, v in line.items() if not k.startswith('time')} for line in lines])
    assert logs[0] == logs[1]
