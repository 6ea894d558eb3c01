"""The completion script in a real bash; making it loads nothing heavy, and using it starts no Python."""

import subprocess
import sys
from pathlib import Path

import pytest

from raw2drive_ros.cli.completion import SHELLS, known_values, scenario_types
from raw2drive_ros.cli.main import VERBS, main
from raw2drive_ros.evaluation.suites import suite_names
from raw2drive_ros.settings import preset_names
from raw2drive_ros.simulation.scenario import load_scenarios

ROOT = Path(__file__).resolve().parents[2]
# Prints what bash would offer for the last of the words.
OFFER = """
source "$1"
shift
COMP_WORDS=("$@"); COMP_CWORD=$(($# - 1)); COMPREPLY=()
PATH=/nowhere
_shtab_raw2drive
printf '%s\\n' "${COMPREPLY[@]}"
"""


@pytest.fixture(scope='module')
def script(tmp_path_factory) -> Path:
    made = subprocess.run(
        [sys.executable, '-m', 'raw2drive_ros.cli.main', 'completion', 'bash'], cwd=ROOT, capture_output=True, text=True
    )
    assert made.returncode == 0, made.stderr
    path = tmp_path_factory.mktemp('completion') / 'raw2drive.bash'
    path.write_text(made.stdout)
    return path


def offered(script: Path, *words: str) -> list[str]:
    command = ['bash', '-c', OFFER, 'bash', str(script), 'raw2drive', *words]
    found = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=30)
    assert found.stderr == ''
    return found.stdout.split()


def test_verbs_options_and_names_are_offered(script) -> None:
    assert offered(script, 'ev') == ['evaluate']
    assert {verb for verb in VERBS if ' ' not in verb} == {word for word in offered(script, '') if word[0] != '-'}
    assert offered(script, 'evaluate', 'f') == ['faults']
    assert offered(script, 'evaluate', '--dri') == ['--driver']
    assert offered(script, 'evaluate', 'faults', '--pl') == ['--plans']
    assert offered(script, 'evaluate', '--driver', 'r') == ['raw', 'rule', 'random']
    assert offered(script, 'evaluate', '--suite', 'b') == ['b2d220']
    assert 'ParkingExit' in offered(script, 'scenario', 'show', 'Par')
    assert offered(script, 'suite', 's') == ['show']
    assert offered(script, 'train', 'privileged', '--preset', '') == preset_names()
    assert offered(script, 'bag', 'info', 'setup.p') == ['setup.py']


def test_the_names_are_those_that_the_verbs_know() -> None:
    assert scenario_types() == sorted(load_scenarios())
    assert known_values()['suite'] == suite_names()


@pytest.mark.parametrize('shell', SHELLS)
def test_making_it_loads_nothing_heavy(shell) -> None:
    code = (
        f'import sys; from raw2drive_ros.cli.main import main\nmain(["completion", "{shell}"])\n'
        "raise SystemExit(', '.join({'torch', 'highway_env', 'rclpy', 'rich'} & sys.modules.keys()) or 0)"
    )
    made = subprocess.run([sys.executable, '-c', code], cwd=ROOT, capture_output=True, text=True)
    assert made.returncode == 0, made.stderr


def test_zsh_gets_every_verb_with_its_line(capsys) -> None:
    assert main(['completion', 'zsh']) == 0
    made = capsys.readouterr().out
    assert made.startswith('#compdef raw2drive')
    for verb, (_, line) in VERBS.items():
        first, _, second = verb.partition(' ')
        assert _unquoted(f'{second or first}:{line}') in _unquoted(made)


def _unquoted(text: str) -> str:
    """Without quotes and backslashes: releases of shtab quote in different ways."""
    return text.translate(str.maketrans('', '', '\'"\\'))


def test_another_shell_is_one_line(capsys) -> None:
    with pytest.raises(SystemExit) as stop:
        main(['completion', 'fish'])
    assert stop.value.code == 2
    assert "'fish' is none of bash, zsh" in capsys.readouterr().err
