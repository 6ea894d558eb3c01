"""Results of several drivers on one page: scores, paired verdicts, abilities, types, and failures with pictures."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations
from pathlib import Path
from typing import Any

from jinja2 import Environment, FileSystemLoader

from raw2drive_ros import __version__
from raw2drive_ros.contracts.errors import ResultsError
from raw2drive_ros.evaluation.metrics import ABILITIES
from raw2drive_ros.evaluation.results import Results, read_results
from raw2drive_ros.evaluation.statistics import (
    by_ability,
    by_type,
    compare,
    flaky,
    infractions,
    summary,
)
from raw2drive_ros.report.charts import MAX_RUNS, PALETTE, grouped_bars
from raw2drive_ros.report.failures import failures_of

DEFAULT_FILMSTRIPS = 40
# With more runs than this, tables are set more tightly.
ROOMY_RUNS = 4
OPPOSITE = {'yes': 'no', 'no': 'yes', 'undecided': 'undecided'}
VERDICT_WORDS = {'yes': 'better', 'no': 'worse', 'undecided': 'undecided'}


def read_all(paths: Sequence[Path]) -> list[Results]:
    """Read 1 to `MAX_RUNS` files. Raises ResultsError."""
    if not 1 <= len(paths) <= MAX_RUNS:
        raise ResultsError(f'{len(paths)} files of results: give 1 to {MAX_RUNS}')
    return [read_results(path) for path in paths]


def statistics_of(paths: Sequence[Path], runs: Sequence[Results]) -> dict[str, Any]:
    """The page's numbers as a dictionary for JSON; runs are called A, B, ... Raises ResultsError if suites differ."""
    letters = [chr(ord('A') + i) for i in range(len(runs))]
    return {
        'suite': runs[0].header['suite'],
        'version': runs[0].header['version'],
        'protocol': runs[0].header['protocol'],
        'runs': [
            {
                'name': letter,
                'file': path.name,
                'driver': run.driver,
                'bench2drive_compat': bool(run.header.get('bench2drive_compat')),
                'summary': summary(run),
                'abilities': by_ability(run),
                'types': by_type(run),
                'infractions': infractions(run),
                'flaky': flaky(run),
                'missing': [str(route) for route in run.missing],
            }
            for letter, path, run in zip(letters, paths, runs, strict=True)
        ],
        'comparisons': [
            {'a': a, 'b': b} | compare(run_a, run_b)
            for (a, run_a), (b, run_b) in combinations(zip(letters, runs, strict=True), 2)
        ],
    }


def write_comparison(target: Path, paths: Sequence[Path], max_filmstrips: int = DEFAULT_FILMSTRIPS) -> Path:
    """One self-contained HTML file. Raises ResultsError, OSError."""
    runs = read_all(paths)
    numbers = statistics_of(paths, runs)
    titles = [name for name in (*ABILITIES, 'mean') if any(name in run['abilities'] for run in numbers['runs'])]
    environment = Environment(
        autoescape=True,
        trim_blocks=True,
        lstrip_blocks=True,
        loader=FileSystemLoader(Path(__file__).parent),
    )
    page = environment.get_template('comparison.html').render(
        numbers,
        version_of_package=__version__,
        palette=PALETTE,
        titles=titles,
        chart=grouped_bars(titles, [run['abilities'] for run in numbers['runs']]),
        types=sorted({name for run in numbers['runs'] for name in run['types']}),
        infraction_names=sorted({name for run in numbers['runs'] for name in run['infractions']}),
        matrix=_matrix(numbers),
        failures=[failures_of(path, run, max_filmstrips) for path, run in zip(paths, runs, strict=True)],
        succeeded=[[row for row in run.rows if row['success']] for run in runs],
        paired=any(run['summary']['pair_success_rate'] for run in numbers['runs']),
        twins=any(run['summary']['needless_stops'] for run in numbers['runs']),
        repeated=any(route.repetition for run in runs for route in run.wanted),
        max_filmstrips=max_filmstrips,
        crowded=len(runs) > ROOMY_RUNS,
        tone=tone,
        words=VERDICT_WORDS,
    )
    target.parent.mkdir(parents=True, exist_ok=True)
    target.write_text(page, encoding='utf-8')
    return target


def tone(share: float) -> str:
    """Background of a success share in [0, 1]: orange through white to blue."""
    end = (86, 180, 233) if share > 0.5 else (240, 150, 70)
    strength = 0.75 * abs(2.0 * share - 1.0)
    return 'rgb({},{},{})'.format(*(round(255 + strength * (value - 255)) for value in end))


def _matrix(numbers: dict[str, Any]) -> dict[str, dict[str, dict[str, Any]]]:
    """row name -> column name -> {score: difference row - column}: every comparison, read both ways."""
    found: dict[str, dict[str, dict[str, Any]]] = {run['name']: {} for run in numbers['runs']}
    for pair in numbers['comparisons']:
        scores = {name: pair[name] for name in ('driving_score', 'success_rate', 'pair_success_rate') if name in pair}
        counts = {name: pair[name] for name in ('common', 'not_common')}
        found[pair['a']][pair['b']] = scores | counts
        found[pair['b']][pair['a']] = {name: _turned(value) for name, value in scores.items()} | counts
    return found


def _turned(value: dict[str, Any]) -> dict[str, Any]:
    turned = {'mean': -value['mean'], 'low': -value['high'], 'high': -value['low']}
    return value | turned | {'verdict': OPPOSITE[value['verdict']]}
