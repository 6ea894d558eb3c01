"""The page that compares results: nothing dropped, nothing unescaped, and commands that can be run."""

import argparse
import json
import shlex
from html import unescape
from html.parser import HTMLParser

import cv2
import numpy as np
import pytest

from raw2drive_ros.cli import scenario as scenario_verb
from raw2drive_ros.cli.main import main
from raw2drive_ros.contracts.errors import ResultsError
from raw2drive_ros.evaluation.driver_spec import DriverSpec
from raw2drive_ros.evaluation.metrics import score_route
from raw2drive_ros.evaluation.statistics import compare, summarise, timing_of
from raw2drive_ros.report.charts import MAX_RUNS, grouped_bars
from raw2drive_ros.report.comparison import read_all, statistics_of, tone, write_comparison
from raw2drive_ros.report.failures import replay_command
from raw2drive_ros.report.html import write_report
from raw2drive_ros.simulation.route_id import RouteId

HOSTILE = '<img src=x onerror="alert(1)">&'


class Page(HTMLParser):
    """Texts and tags of a page."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.tags: list[tuple[str, dict]] = []
        self.stack: list[str] = []
        self.codes: list[str] = []
        self.feed(text)

    def handle_starttag(self, tag, attrs) -> None:
        self.tags.append((tag, dict(attrs)))
        self.stack.append(tag)

    def handle_endtag(self, tag) -> None:
        while self.stack and self.stack.pop() != tag:
            pass

    def handle_data(self, data) -> None:
        if self.stack and self.stack[-1] == 'code':
            self.codes.append(data)


def row(kind: str, seed: int, score: float, **more) -> dict:
    route = RouteId(kind, seed, more.pop('weather', 'ClearNoon'), more.pop('repetition', 0))
    return {
        'id': str(route), 'type': kind, 'seed': seed, 'weather': route.weather, 'repetition': route.repetition,
        'route_completion': score, 'infraction_score': 1.0, 'driving_score': score, 'success': score == 100.0,
        'infractions': {}, 'signs_obeyed': False, 'failure': '', 'duration_s': 10.0, 'reward': 1.0,
        'efficiency': None, 'comfort': None,
    } | more  # fmt: skip


def write(path, driver: str, rows: list[dict], wanted: list[str] | None = None, suite: str = 'b2d220', **more):
    routes = [r['id'] for r in rows] if wanted is None else wanted
    header = {'status': 'failed, no data', 'started': 1.0, 'driver': driver, 'suite': suite, 'version': '2'}
    path.write_text('\n'.join(json.dumps(r) for r in (header | {'routes': routes} | more, *rows)) + '\n')
    return path


def filmstrip(results, row_id: str) -> None:
    folder = results.with_suffix('.filmstrips')
    folder.mkdir(exist_ok=True)
    cv2.imwrite(str(folder / f'{row_id.replace("/", "_")}.jpg'), np.zeros((8, 56, 3), np.uint8))


def test_everything_from_data_is_escaped(tmp_path) -> None:
    bad = row(HOSTILE, 0, 5.0, failure=HOSTILE, infractions={HOSTILE: 2})
    page = Page(write_comparison(tmp_path / 'r.html', [write(tmp_path / 'a.jsonl', HOSTILE, [bad])]).read_text())
    assert not [attributes for tag, attributes in page.tags if 'onerror' in attributes]
    assert 'script' not in {tag for tag, _ in page.tags}
    assert HOSTILE in (tmp_path / 'r.html').read_text().replace('&#34;', '"').replace('&lt;', '<').replace(
        '&gt;', '>'
    ).replace('&amp;', '&')


def test_the_page_needs_nothing_from_outside(tmp_path) -> None:
    results = write(tmp_path / 'a.jsonl', 'rule', [row('Accident', 0, 5.0)])
    filmstrip(results, 'Accident/0')
    page = Page(write_comparison(tmp_path / 'r.html', [results]).read_text())
    links = [v for _, attributes in page.tags for k, v in attributes.items() if k in ('src', 'href', 'xlink:href')]
    assert [link[:23] for link in links] == ['data:image/jpeg;base64,']


def test_missing_drives_are_listed_and_make_the_mean_smaller(tmp_path) -> None:
    results = write(tmp_path / 'a.jsonl', 'rule', [row('Accident', 0, 100.0)], ['Accident/0', 'Accident/3/FogNoon'])
    text = write_comparison(tmp_path / 'r.html', [results]).read_text()
    assert 'Accident/3/FogNoon' in text
    assert '1 missing drives' in text
    numbers = statistics_of([results], read_all([results]))
    assert numbers['runs'][0]['summary']['driving_score']['mean'] == 50.0
    assert numbers['runs'][0]['missing'] == ['Accident/3/FogNoon']


@pytest.mark.parametrize('key', ['bench2drive_compat', 'quirks'])
def test_the_page_says_which_runs_are_scored_as_bench2drive_s_tools_do(tmp_path, key) -> None:
    for value in (True, False):
        results = write(tmp_path / 'a.jsonl', 'rule', [row('Accident', 0, 5.0)], **{key: value})
        text = write_comparison(tmp_path / 'r.html', [results]).read_text()
        assert ('as Bench2Drive’s tools compute them' in text) == value
        assert statistics_of([results], read_all([results]))['runs'][0]['bench2drive_compat'] is value


def test_the_replay_command_is_one_that_the_command_line_takes(tmp_path, teacher_run) -> None:
    failed = row('T_Junction', 7, 5.0, weather='HardRainNight', repetition=2)
    identity = DriverSpec('privileged', run=teacher_run, blind=True).identity()
    results = write(tmp_path / 'a.jsonl', identity, [failed])
    page = Page(write_comparison(tmp_path / 'r.html', [results]).read_text())
    command = next(code for code in page.codes if code.startswith('raw2drive scenario'))
    parser = argparse.ArgumentParser()
    scenario_verb.add_arguments(parser)
    options = parser.parse_args(shlex.split(unescape(command))[2:])
    assert (options.name, options.seed, options.weather, options.repetition) == ('T_Junction', 7, 'HardRainNight', 2)
    assert (options.driver, options.training_run, options.blind) == ('privileged', None, True)
    assert str(options.video) == 'out.mp4'


def test_a_hostile_type_stays_one_word_of_the_shell() -> None:
    assert shlex.split(replay_command('rule', RouteId('x; rm -rf ~', 0)))[3] == 'x; rm -rf ~'


def test_worst_failures_come_first_and_pictures_are_capped(tmp_path) -> None:
    rows = [row('Accident', seed, 90.0 - seed) for seed in range(5)] + [row('Accident', 9, 100.0)]
    results = write(tmp_path / 'a.jsonl', 'rule', rows)
    for failed in rows[:5]:
        filmstrip(results, failed['id'])
    text = write_comparison(tmp_path / 'r.html', [results], max_filmstrips=2).read_text()
    assert text.count('data:image/jpeg;base64,') == 2
    assert '3 more are left out' in text
    assert 'a.filmstrips/Accident_0.jpg' in text
    assert text.index('<h4>Accident/4') < text.index('<h4>Accident/0')
    assert '<h4>Accident/9' not in text


def test_the_comparison_matrix_reads_both_ways(tmp_path) -> None:
    good = write(tmp_path / 'a.jsonl', 'good', [row('Accident', s, 90.0 + s % 3) for s in range(12)])
    bad = write(tmp_path / 'b.jsonl', 'bad', [row('Accident', s, 20.0) for s in range(12)])
    text = write_comparison(tmp_path / 'r.html', [good, bad]).read_text()
    assert 'better +71.0' in text and 'worse -71.0' in text


def test_files_of_different_suites_are_one_line_of_error(tmp_path, capsys) -> None:
    paths = [write(tmp_path / f'{s}.jsonl', 'x', [row('Accident', 0, 1.0)], suite=s) for s in ('one', 'two')]
    assert main(['report', *map(str, paths), '--out', str(tmp_path / 'r.html')]) == 1
    error = capsys.readouterr().err.strip()
    assert 'not comparable' in error and len(error.splitlines()) == 1
    with pytest.raises(ResultsError, match=f'1 to {MAX_RUNS}'):
        read_all([paths[0]] * (MAX_RUNS + 1))


def test_json_prints_what_the_page_shows(tmp_path, capsys) -> None:
    paths = [write(tmp_path / f'{n}.jsonl', n, [row('Accident', 0, 40.0), row('Accident', 1, 100.0)]) for n in 'ab']
    assert main(['report', *map(str, paths), '--json']) == 0
    numbers = json.loads(capsys.readouterr().out)
    assert [run['driver'] for run in numbers['runs']] == ['a', 'b']
    assert numbers['comparisons'] == [{'a': 'A', 'b': 'B'} | compare(*read_all(paths))]


def test_bars_stand_where_their_values_are() -> None:
    chart = grouped_bars(['one'], [{'one': {'mean': 100.0, 'low': 50.0, 'high': 100.0}}, {'one': {'mean': 50.0}}])
    full, half = chart.groups[0].bars
    grid = {percent: y for y, percent in chart.grid}
    assert (full.y, full.low_y, half.y, half.low_y) == (grid[100], grid[50], grid[50], None)
    assert full.x + full.width <= half.x
    assert tone(0.0) != tone(1.0) and tone(0.5) == 'rgb(255,255,255)'


def test_the_report_of_a_demo_shows_scores_and_escapes_what_comes_from_data(tmp_path) -> None:
    """Also on a route where efficiency is undefined."""
    route = RouteId('VanillaNonSignalizedTurn', 0)
    row = score_route(route, 80.0, {'stop_sign': 1}, 'timeout', 0.0, comfort=50.0)
    result = summarise('<b>raw</b>', 'x', '2', [route], [row], timing_of([20.0, 21.0]))
    assert result['summary']['efficiency'] is None
    page = write_report(tmp_path / 'report.html', result).read_text()
    assert '64.0' in page, '80 % of the route and a stop sign run'
    assert '<b>raw</b>' not in page and '&lt;b&gt;raw&lt;/b&gt;' in page
