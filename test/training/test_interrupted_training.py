"""Ctrl-C during training: the step is finished, a checkpoint written, and the run goes on as if nothing had been."""

import json
import os
import signal

import pytest
from safetensors.torch import load_file

from raw2drive_ros.contracts.errors import UsageError
from raw2drive_ros.training import run as run_module
from raw2drive_ros.training.run import train

# Neither the metrics nor the checkpoints of the schedule fall on the step of the interruption.
FIELDS = {'threads': 1, 'log_every': 5, 'picture_every': 4, 'checkpoint_every': 50, 'reset_policy_at': 9}
STEPS, AT = 12, 7


class Terminated(BaseException):
    pass


def go(bags, workspace, run, steps=STEPS, **more):
    return train('privileged', run, [bags], workspace / 'cache', steps, 'nano', FIELDS, **more)


@pytest.fixture
def signals(monkeypatch):
    """send(numbers): these signals arrive in the middle of step `AT`."""
    factor = run_module.decay_factor

    def send(*numbers: int) -> None:
        def sending(step: int, *others):
            if step == AT - 1:
                for number in numbers:
                    os.kill(os.getpid(), number)
            return factor(step, *others)

        monkeypatch.setattr(run_module, 'decay_factor', sending)

    yield send
    signal.signal(signal.SIGTERM, signal.SIG_DFL)


def checkpoints(run) -> list[str]:
    return sorted(path.name for path in (run / 'checkpoints').iterdir()) if (run / 'checkpoints').is_dir() else []


def metrics(run) -> list[dict]:
    lines = [json.loads(line) for line in (run / 'metrics.jsonl').read_text().splitlines()]
    return [{name: value for name, value in line.items() if not name.startswith('time')} for line in lines]


def test_a_resumed_run_is_the_uninterrupted_one(bags, workspace, tmp_path, signals, monkeypatch, capsys) -> None:
    go(bags, workspace, tmp_path / 'whole')
    signals(signal.SIGINT)
    run = tmp_path / 'run'
    with pytest.raises(KeyboardInterrupt):
        go(bags, workspace, run)
    assert checkpoints(run) == [f'{AT:08d}'], 'the step was finished'
    said = capsys.readouterr().err
    assert 'ends after this step' in said
    assert f'checkpoints/{AT:08d} written; the same command goes on from there' in said
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler
    monkeypatch.undo()
    go(bags, workspace, run)
    whole, resumed = (
        load_file(folder / 'checkpoints' / f'{STEPS:08d}' / 'tensors.safetensors')
        for folder in (tmp_path / 'whole', run)
    )
    assert whole.keys() == resumed.keys()
    assert not [name for name in whole if not whole[name].equal(resumed[name])]
    assert metrics(run) == metrics(tmp_path / 'whole')


def test_sigterm_writes_a_checkpoint_too(bags, workspace, tmp_path, signals) -> None:
    def end(number, frame):
        raise Terminated

    signal.signal(signal.SIGTERM, end)
    signals(signal.SIGTERM)
    with pytest.raises(Terminated):
        go(bags, workspace, tmp_path / 'run')
    assert checkpoints(tmp_path / 'run') == [f'{AT:08d}']


def test_the_second_ctrl_c_ends_at_once(bags, workspace, tmp_path, signals) -> None:
    signals(signal.SIGINT, signal.SIGINT)
    with pytest.raises(KeyboardInterrupt):
        go(bags, workspace, tmp_path / 'run')
    assert checkpoints(tmp_path / 'run') == []


def test_an_existing_run_keeps_its_preset(bags, workspace, tmp_path) -> None:
    go(bags, workspace, tmp_path / 'run', 1)
    with pytest.raises(UsageError, match=r'--preset laptop: .* is a run of preset nano'):
        train('privileged', tmp_path / 'run', [bags], workspace / 'cache', 2, 'laptop', FIELDS)
    # The same command again, and one that names no preset, go on.
    assert go(bags, workspace, tmp_path / 'run', 2).steps == 2
    assert train('privileged', tmp_path / 'run', [bags], workspace / 'cache', 3, None, FIELDS).steps == 3
