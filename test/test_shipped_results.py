"""The figures of the README are those of the stored results, and these are of the shipped bundles and of today."""

import re
import shlex
from pathlib import Path

import pytest

from raw2drive_ros.cli.main import main
from raw2drive_ros.evaluation.driver_spec import DriverSpec
from raw2drive_ros.evaluation.results import Results, read_results
from raw2drive_ros.evaluation.statistics import summary
from raw2drive_ros.settings import default_bundle

ROOT = Path(__file__).resolve().parents[1]
FOLDER = ROOT / 'docs' / 'results'
README = (ROOT / 'README.md').read_text()
COMPLETED = 90.0


def commands() -> dict[str, list[str]]:
    """File -> the words of the command that wrote it."""
    rows = re.findall(r'^\| `(\w+\.jsonl)` \| `raw2drive evaluate (.+)` \|$', (FOLDER / 'README.md').read_text(), re.M)
    return {file: shlex.split(words) for file, words in rows}


COMMANDS = commands()


def option(words: list[str], name: str, otherwise: str = '') -> str:
    return words[words.index(name) + 1] if name in words else otherwise


def percent(value: dict[str, float]) -> str:
    return f'{value["mean"]:.1f} ({value["low"]:.1f} to {value["high"]:.1f})'


def completed(results: Results) -> int:
    return sum(row['route_completion'] >= COMPLETED for row in results.rows)


def row_of(results: Results) -> list[str]:
    """The cells of the README's table from the third on."""
    found = summary(results)
    scores = [percent(found[name]) for name in ('success_rate', 'route_completion', 'driving_score')]
    return [scores[0], str(completed(results)), *scores[1:]]


def table() -> dict[str, list[str]]:
    """Options of the second column -> the cells after it."""
    rows = re.findall(r'^\| [^|]+ \| `(--driver [^`]+)` \| (.+) \|$', README, re.MULTILINE)
    return {options: cells.split(' | ') for options, cells in rows}


def test_every_stored_file_has_a_command_and_each_command_names_its_file() -> None:
    assert sorted(COMMANDS) == sorted(path.name for path in FOLDER.glob('*.jsonl'))
    for file, words in COMMANDS.items():
        assert option(words, '--out') == f'docs/results/{file}'


@pytest.mark.parametrize('file', COMMANDS)
def test_stored_rows_are_of_the_shipped_bundles_and_complete(file) -> None:
    results, words = read_results(FOLDER / file), COMMANDS[file]
    spec = DriverSpec(option(words, '--driver'), default_bundle(), blind='--blind' in words)
    assert results.driver == spec.identity(), 'another bundle drove these routes: run the command again'
    assert results.missing == []
    first = int(option(words, '--first-seed', '0'))
    assert [str(route) for route in results.wanted] == [f'LaneFollowing/{seed}' for seed in range(first, first + 20)]


def test_the_table_of_the_readme_is_that_of_the_stored_rows() -> None:
    stored = {}
    for file, words in COMMANDS.items():
        if '--first-seed' not in words:
            options = ' '.join(words[: words.index('--routes')])
            stored[options] = row_of(read_results(FOLDER / file))
    assert len(stored) >= 6
    assert table() == stored


def test_the_sentences_below_the_table_are_those_of_the_stored_rows() -> None:
    text = ' '.join(README.split())
    for words, file in (('With `--first-seed 20`', 'raw_from_20'), ('(`--first-seed 50000`)', 'raw_validation')):
        results = read_results(FOLDER / f'{file}.jsonl')
        figures = r'[^(]*? (\d+) of 20(?: routes)? \((?:success )?([\d.]+) %, (?:driving score )?([\d.]+)\)'
        found = re.search(re.escape(words) + figures, text)
        assert found, words
        scores = summary(results)
        means = [f'{scores[name]["mean"]:.1f}' for name in ('success_rate', 'driving_score')]
        assert list(found.groups()) == [str(completed(results)), *means]
    names = ('raw', 'raw_from_20', 'raw_validation')
    whole = sum(completed(read_results(FOLDER / f'{name}.jsonl')) for name in names)
    assert f': {whole} of these 60.' in text


@pytest.mark.parametrize(('driver', 'seeds'), [('straight', 4), ('random', 3), ('rule', 3)])
def test_the_stored_rows_are_what_the_command_gives_today(tmp_path, driver, seeds) -> None:
    """The simulation may have changed since; drivers without a network drive the same on every machine."""
    target = tmp_path / 'today.jsonl'
    words = ['evaluate', '--driver', driver, '--routes', 'lane-following', '--seeds', str(seeds), '--out', str(target)]
    assert main(words) == 0
    assert read_results(target).rows == read_results(FOLDER / f'{driver}.jsonl').rows[:seeds]
