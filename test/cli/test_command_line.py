import json
import subprocess
import sys
from pathlib import Path

import pytest

from raw2drive_ros.cli.main import VERBS, main
from raw2drive_ros.graph import doctor
from raw2drive_ros.nodes.transport import PROFILE_VARIABLE, shipped_profile

ROOT = Path(__file__).resolve().parents[2]


def run_cli(*arguments: str) -> subprocess.CompletedProcess:
    command = [sys.executable, '-m', 'raw2drive_ros.cli.main', *arguments]
    return subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=180)


@pytest.mark.parametrize('verb', VERBS)
def test_every_verb_has_help_with_examples(verb, capsys) -> None:
    with pytest.raises(SystemExit) as stop:
        main([verb, '--help'])
    assert stop.value.code == 0
    assert 'examples:' in capsys.readouterr().out


@pytest.mark.parametrize(
    ('arguments', 'code', 'message'),
    [
        (['evaluate', '--driver', 'rule', '--routes', 'nowhere'], 2, 'unknown routes'),
        (['evaluate', '--driver', 'rule', '--suite', 'nowhere'], 2, 'unknown suite'),
        (['evaluate', '--driver', 'rule', '--suite', 'b2d220', '--ability', 'x'], 2, 'no such routes'),
        (['evaluate', '--driver', 'rule', '--ability', 'merging'], 2, '--ability goes with --suite'),
        (['suite', 'build', 'nothing'], 2, 'needs one of'),
        (['collect', '--size', '1x1', '--out', 'runs/never'], 2, 'use one of'),
        (['evaluate', '--driver', 'nobody'], 2, 'unknown driver'),
        (['evaluate', '--driver', 'raw', '--bundle', 'no/such'], 1, 'no policy bundle there'),
        (['bag', 'info', 'no/such'], 1, 'no such bag'),
        (['train', 'raw', '--bags', 'x', '--run', 'y'], 2, 'needs --teacher'),
        (['train', 'privileged', '--bags', 'no/such', '--run', 'runs/never'], 1, 'no such file'),
        (['demo', '--bundle', 'no/such', '--out', 'runs/never'], 1, 'no policy bundle there'),
        (['sim', '--scenario', 'Nope'], 2, 'unknown scenario'),
        (['sim', '--size', '1x1'], 2, 'use one of'),
        (['replay', 'no/such'], 1, 'no such bag'),
    ],
)
def test_bad_input_is_one_line_and_an_exit_code(arguments, code, message, capsys) -> None:
    assert main(arguments) == code
    error = capsys.readouterr().err.strip()
    assert message in error
    assert len(error.splitlines()) == 1
    assert not (ROOT / 'runs' / 'never').exists()


def test_evaluate_prints_the_machine_form() -> None:
    result = run_cli('evaluate', '--driver', 'straight', '--routes', 'lane-following', '--seeds', '2', '--json')
    assert result.returncode == 0, result.stderr
    body = json.loads(result.stdout)
    assert body['driver'] == 'straight'
    assert len(body['routes']) == 2


def test_collect_train_and_resume_from_the_command_line(tmp_path) -> None:
    bags, run = tmp_path / 'bags', tmp_path / 'run'
    assert run_cli('collect', '--ticks', '60', '--no-cameras', '--out', str(bags)).returncode == 0
    arguments = ('train', 'privileged', '--preset', 'nano', '--bags', str(bags), '--run', str(run))
    cache = ('--cache', str(tmp_path / 'cache'))
    first = run_cli(*arguments, *cache, '--steps', '2', '--set', 'threads=1')
    assert first.returncode == 0, first.stderr
    again = run_cli(*arguments, *cache, '--steps', '3')
    assert '3 steps' in again.stdout, again.stderr


def test_doctor_names_what_is_missing_and_which_profile_is_in_force(monkeypatch, capsys) -> None:
    monkeypatch.setattr(doctor, 'PACKAGES', ('numpy', 'no-such-package'))
    monkeypatch.setattr(doctor, 'LEAST_SHARED_MEMORY_BYTES', float('inf'))
    monkeypatch.setenv(PROFILE_VARIABLE, str(shipped_profile()))
    assert main(['doctor', '--quick', '--json']) == 1
    body = json.loads(capsys.readouterr().out)
    assert list(body['versions']) == ['numpy']
    assert body['problems'][0] == 'no-such-package is missing: pip install no-such-package'
    assert 'free in /dev/shm' in body['problems'][1]
    assert len(body['problems']) == 2
    assert not {'latency_ms', 'stopping'} & set(body)
    monkeypatch.setenv(PROFILE_VARIABLE, '/elsewhere.xml')
    found = doctor.examine(quick=True)
    assert found['transport']['set_by_user'] == found['transport']['in_force'] == '/elsewhere.xml'
    assert 'Fast DDS profile /elsewhere.xml is in force' in found['problems'][1]


def test_doctor_reports_transport_versions_and_latency() -> None:
    result = run_cli('doctor', '--json')
    body = json.loads(result.stdout)
    assert result.returncode == 0, result.stdout
    assert body['transport']['shipped_profile_in_force'] is True
    assert {'torch', 'rclpy', 'numpy', 'highway-env', 'rosbags'} <= set(body['versions'])
    latency = body['latency_ms']
    assert 0.0 < latency['images_to_command_p50'] <= latency['images_to_command_p99']
    promised, seen = body['stopping']['computed'], body['stopping']['measured']
    assert 0.3 <= seen['detection_s'] <= promised['detection_s'] + promised['reaction_s'] + 0.1
    assert 0.5 < seen['total_s'] <= promised['total_s'] + 0.1
