"""The programs of docs/gym.md run."""

import re
import subprocess
import sys
from pathlib import Path

import pytest

from raw2drive_ros.cli.main import main
from raw2drive_ros.driving.driver_class import PROVIDES
from raw2drive_ros.evaluation.results import read_results

ROOT = Path(__file__).resolve().parents[2]
TEXT = (ROOT / 'docs' / 'gym.md').read_text()
PROGRAMS = re.findall(r'```python\n(.*?)```', TEXT, re.DOTALL)
DRIVER = next(program for program in PROGRAMS if 'class MyDriver' in program)


@pytest.mark.parametrize('number', [i for i, program in enumerate(PROGRAMS) if program != DRIVER])
def test_its_programs_run(number) -> None:
    done = subprocess.run([sys.executable, '-c', PROGRAMS[number]], capture_output=True, text=True, timeout=600)
    assert done.returncode == 0, done.stderr
    assert len(PROGRAMS) == 4


def test_its_driver_drives(tmp_path, monkeypatch) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / 'my_driver.py').write_text(DRIVER)
    command = ['--driver', 'my_driver:MyDriver', '--driver-args', 'speed_mps=6', '--routes', 'lane-following']
    assert main(['evaluate', *command, '--seeds', '1', '--out', 'mine.jsonl']) == 0
    (row,) = read_results(tmp_path / 'mine.jsonl').rows
    assert row['route_completion'] > 0.0 and not row['failure'].startswith('error')


def test_its_tables_list_all_sensors_and_observations() -> None:
    from raw2drive_ros.gym.observations import OBSERVATIONS

    for sensor, attributes in PROVIDES.items():
        (row,) = re.findall(rf'^\| `{sensor}` \|(.*)\|$', TEXT.split('**`sensors`**')[1], re.MULTILINE)
        assert all(re.search(rf'`{name}\b', row) for name in attributes), sensor
    for name in OBSERVATIONS:
        assert re.search(rf'^\| `{name}` \|', TEXT, re.MULTILINE)


def test_the_example_learns() -> None:
    """Three rounds are too few to be good, and enough to run all of it."""
    command = [sys.executable, 'examples/gym/evolve.py', '--rounds', '3']
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=600)
    assert done.returncode == 0, done.stderr
    assert 'round 3: mean return' in done.stdout and 'mean return on new routes' in done.stdout
