"""Two processes of `torchrun` with half of the batch each have the losses of one process with the whole batch."""

import json
import os
import subprocess
import sys

import pytest

STEPS = 12


def _train(bags, cache, run, processes, batch):
    command = [sys.executable, '-m']
    if processes > 1:
        command += ['torch.distributed.run', '--standalone', f'--nproc-per-node={processes}', '-m']
    command += ['raw2drive_ros.cli.main', 'train', 'privileged', '--preset', 'nano', '--steps', str(STEPS)]
    command += ['--bags', str(bags), '--cache', str(cache), '--folder', str(run)]
    fields = {
        'batch': batch,
        'starts': 8 * batch,
        'threads': 1,
        'log_every': 1,
        'picture_every': 100,
        'checkpoint_every': 6,
        'weight_advice': 1.0,
        'imitate': 1.0,
        'decode_share': 1.0,
    }
    for name, value in fields.items():
        command += ['--set', f'{name}={value}']
    environment = os.environ | {'OMP_NUM_THREADS': '1'}
    done = subprocess.run(command, capture_output=True, text=True, timeout=300, env=environment)
    assert done.returncode == 0, done.stderr[-2000:]
    return [json.loads(line) for line in (run / 'metrics.jsonl').read_text().splitlines()]


def test_two_processes_follow_the_loss_curve_of_one_with_the_doubled_batch(bags, workspace, tmp_path) -> None:
    whole = _train(bags, workspace / 'cache', tmp_path / 'whole', 1, 4)
    halves = _train(bags, workspace / 'cache', tmp_path / 'halves', 2, 2)
    assert [line['step'] for line in halves] == list(range(1, STEPS + 1))
    for one, two in zip(whole, halves, strict=True):
        for name in ('masks', 'ego', 'reward', 'continue', 'dyn', 'rep'):
            assert two[f'loss/{name}'] == pytest.approx(one[f'loss/{name}'], rel=2e-3), (one['step'], name)
    config = json.loads((tmp_path / 'halves' / 'config.json').read_text())
    assert config['processes'] == 2
    assert sorted(p.name for p in (tmp_path / 'halves' / 'checkpoints').iterdir()) == ['00000006', '00000012']
