"""Results files: written and read back, resumed, truncated and damaged; no other module reads or writes their rows."""

import ast
import json
import subprocess
import sys
from dataclasses import asdict
from pathlib import Path

import pytest

from raw2drive_ros.contracts.errors import ResultsError
from raw2drive_ros.evaluation.driver_spec import DriverSpec
from raw2drive_ros.evaluation.evaluate import evaluate
from raw2drive_ros.evaluation.metrics import RouteResult, score_route
from raw2drive_ros.evaluation.recipe_rounds import failures_by_type
from raw2drive_ros.evaluation.results import (
    RowsFile,
    append_row,
    header_of,
    read_results,
    result_from_line,
    result_from_row,
)
from raw2drive_ros.evaluation.routes import routes_of
from raw2drive_ros.graph.drive import Tail
from raw2drive_ros.report.comparison import read_all
from raw2drive_ros.report.curves import read_run
from raw2drive_ros.simulation.route_id import RouteId

ROOT = Path(__file__).resolve().parents[2]
ROUTES = [RouteId('Accident', 0), RouteId('ParkedObstacle', 3, 'FogNoon', 1), RouteId('Accident', 2)]


def header(routes=ROUTES, **other) -> dict:
    return header_of('rule', 's', '2', routes) | {'started': 1.0} | other


def result(route: RouteId, completion: float = 100.0) -> RouteResult:
    failure = '' if completion == 100.0 else 'timeout'
    return score_route(route, completion, {'red_light': 1}, failure, 0.0, duration_s=9.5, reward=-0.125, comfort=50.0)


def write(path: Path, *records, tail: str = '') -> Path:
    path.write_text(''.join((r if isinstance(r, str) else json.dumps(r)) + '\n' for r in records) + tail)
    return path


# -- what is written --------------------------------------------------------------------------------


def test_what_is_written_is_read_back(tmp_path) -> None:
    path, rows = tmp_path / 'deep' / 'x.jsonl', [result(ROUTES[1], 33.3), result(ROUTES[0])]
    file = RowsFile(path, header())
    for row in rows:
        file.add(row)
    read = read_results(path)
    assert read.header == header()
    assert [result_from_row(row, 'x') for row in read.rows] == rows[::-1], 'in the order of the wanted routes'
    assert (read.driver, read.wanted, read.missing) == ('rule', ROUTES, [ROUTES[2]])
    assert list(file.rows.values()) == list(RowsFile(path, header()).rows.values()) == rows, 'as they were driven'


def test_the_bytes_of_a_file_are_these(tmp_path) -> None:
    file = RowsFile(tmp_path / 'x.jsonl', header_of('rule', 's', '2', ROUTES[:1]) | {'started': 1.5})
    file.add(result(ROUTES[0]))
    assert (tmp_path / 'x.jsonl').read_text() == (
        '{"status": "failed, no data", "started": 1.5, "driver": "rule", "suite": "s", "version": "2", '
        '"protocol": "pairs", "bench2drive_compat": false, "routes": ["Accident/0"]}\n'
        '{"id": "Accident/0", "type": "Accident", "seed": 0, "weather": "ClearNoon", "repetition": 0, '
        '"route_completion": 100.0, "infraction_score": 0.7, "driving_score": 70.0, "success": false, '
        '"infractions": {"red_light": 1}, "signs_obeyed": false, "failure": "", "duration_s": 9.5, '
        '"reward": -0.125, "efficiency": null, "comfort": 50.0, "limit_s": null, "reference_s": null, "twin": false, '
        '"needless_stop_s": null}\n'
    )


def test_without_a_path_rows_are_only_kept(tmp_path, monkeypatch) -> None:
    monkeypatch.chdir(tmp_path)
    file = RowsFile(None, header())
    file.add(result(ROUTES[0]))
    assert list(file.rows) == [ROUTES[0]]
    assert not list(tmp_path.iterdir())


def test_a_file_says_failed_until_there_is_data(tmp_path) -> None:
    lines = tmp_path / 'lines.jsonl'
    evaluate(DriverSpec('rule'), 'x', '1', routes_of('lane-following', 1), lines=lines)
    first, second = lines.read_text().splitlines()
    assert 'failed, no data' in first
    assert 'LaneFollowing/0' in second


def test_rows_that_the_bridge_appends_are_followed_while_it_writes(tmp_path) -> None:
    path = tmp_path / 'rows.jsonl'
    tail = Tail(path)
    assert tail.lines() == []
    append_row(path, result(ROUTES[0]))
    with path.open('a') as file:
        file.write('{"id": "Parked')
    assert [(n, result_from_line(line, 'x')) for n, line in tail.lines()] == [(1, result(ROUTES[0]))]
    with path.open('a') as file:
        file.write('Obst')
    assert tail.lines() == []
    with path.open('a') as file:
        file.write('acle"}\n')
    ((number, line),) = tail.lines()
    with pytest.raises(ResultsError, match='rows: line 2 is not a result: without type, seed'):
        result_from_line(line, f'rows: line {number}')


# -- resumed ----------------------------------------------------------------------------------------


def test_results_are_resumed_and_a_torn_last_line_is_driven_again(tmp_path) -> None:
    lines = tmp_path / 'lines.jsonl'
    routes = routes_of('VanillaNonSignalizedTurn', 3)
    whole = evaluate(DriverSpec('rule'), 'x', '1', routes, lines=lines)
    kept = lines.read_text().splitlines()
    lines.write_text('\n'.join(kept[:2]) + '\n' + kept[2][:40])
    driven = []
    again = evaluate(
        DriverSpec('rule'), 'x', '1', routes, lines=lines, on_route=lambda done, row: driven.append(row.seed)
    )
    assert driven == [1, 2]
    assert again['routes'] == whole['routes']
    assert lines.read_text().splitlines() == kept


def test_results_of_another_driver_are_not_mixed_in(tmp_path) -> None:
    lines = tmp_path / 'lines.jsonl'
    evaluate(DriverSpec('rule'), 'x', '1', ROUTES[:1], lines=lines)
    with pytest.raises(ResultsError, match="driver 'rule', not 'straight'"):
        evaluate(DriverSpec('straight'), 'x', '1', ROUTES[:1], lines=lines)


@pytest.mark.parametrize(
    ('now', 'message'),
    [
        ({'driver': 'idm'}, "driver 'rule', not 'idm'"),
        ({'suite': 't'}, "suite 's', not 't'"),
        ({'version': '3'}, "version '2', not '3'"),
        ({'protocol': 'bench2drive'}, "protocol 'pairs', not 'bench2drive'"),
        ({'bench2drive_compat': True}, 'bench2drive_compat False, not True'),
        ({'routes': ['Accident/0', 'Accident/2']}, 'ParkedObstacle/3/FogNoon/1, which is not asked for now'),
    ],
)
def test_another_evaluation_does_not_resume_a_file(tmp_path, now, message) -> None:
    path = write(tmp_path / 'x.jsonl', header(), asdict(result(ROUTES[0])))
    before = path.read_bytes()
    with pytest.raises(ResultsError, match=f'x.jsonl: holds results of {message}.*: give another --out'):
        RowsFile(path, header(**now))
    assert path.read_bytes() == before


def test_more_routes_than_before_are_added_to_the_header(tmp_path) -> None:
    rows = [asdict(result(ROUTES[2])), asdict(result(ROUTES[0]))]
    path = write(tmp_path / 'x.jsonl', header([ROUTES[0], ROUTES[2]], started=5.0), *rows)
    file = RowsFile(path, header(started=9.0))
    assert list(file.rows) == [ROUTES[2], ROUTES[0]]
    assert [json.loads(line) for line in path.read_text().splitlines()] == [header(started=5.0), *rows]
    assert list(tmp_path.iterdir()) == [path]


def test_a_header_is_replaced_in_one_step(tmp_path, monkeypatch) -> None:
    """A kill before the rename leaves the old file."""
    path = write(tmp_path / 'x.jsonl', header(ROUTES[:1]), asdict(result(ROUTES[0])), tail='{"id": "Acc')
    before = path.read_bytes()

    def killed(self: Path, target: Path) -> None:
        raise KeyboardInterrupt

    with monkeypatch.context() as patch, pytest.raises(KeyboardInterrupt):
        patch.setattr(Path, 'replace', killed)
        RowsFile(path, header())
    assert path.read_bytes() == before
    assert list(RowsFile(path, header()).rows) == [ROUTES[0]]
    assert read_results(path).wanted == ROUTES


@pytest.mark.parametrize(
    ('tail', 'last'),
    [('{"id": "Accident/2", "ty', None), ('\0\0\0', None), (json.dumps(asdict(result(ROUTES[2]))), ROUTES[2])],
)
def test_a_file_that_does_not_end_in_a_line_break(tmp_path, tail, last) -> None:
    """An incomplete last record is dropped; a complete one counts, and gets its line break when the file is resumed."""
    path = write(tmp_path / 'x.jsonl', header(), asdict(result(ROUTES[0])), tail=tail)
    done = [ROUTES[0]] + [last] * (last is not None)
    assert [row['id'] for row in read_results(path).rows] == [str(route) for route in done]
    assert list(RowsFile(path, header()).rows) == done
    append_row(path, result(ROUTES[1]))
    assert len(path.read_text().splitlines()) == 2 + len(done)
    assert read_results(path).missing == [route for route in ROUTES[2:] if route not in done]


@pytest.mark.parametrize('compat', [False, True])
def test_the_old_name_of_a_header_key_is_read_and_resumed(tmp_path, compat) -> None:
    old = {('quirks' if name == 'bench2drive_compat' else name): value for name, value in header().items()}
    path = write(tmp_path / 'x.jsonl', old | {'quirks': compat}, asdict(result(ROUTES[0])))
    before = path.read_bytes()
    assert read_results(path).header == header(bench2drive_compat=compat)
    assert list(RowsFile(path, header(bench2drive_compat=compat)).rows) == [ROUTES[0]]
    assert path.read_bytes() == before
    with pytest.raises(ResultsError, match=f'bench2drive_compat {compat}, not {not compat}'):
        RowsFile(path, header(bench2drive_compat=not compat))
    more = [*ROUTES, RouteId('HighwayExit', 0)]
    RowsFile(path, header(more, bench2drive_compat=compat))
    assert json.loads(path.read_text().splitlines()[0]) == header(more, bench2drive_compat=compat)


def test_a_file_from_before_that_key_is_read_but_not_resumed(tmp_path) -> None:
    oldest = {name: value for name, value in header().items() if name != 'bench2drive_compat'}
    row = {name: value for name, value in asdict(result(ROUTES[0])).items() if name not in ('efficiency', 'comfort')}
    path = write(tmp_path / 'x.jsonl', oldest, row)
    assert read_results(path).rows == [row | {'efficiency': None, 'comfort': None}]
    with pytest.raises(ResultsError, match='bench2drive_compat None, not False'):
        RowsFile(path, header())


# -- damaged ----------------------------------------------------------------------------------------


def test_the_later_row_of_a_route_counts(tmp_path) -> None:
    path = write(tmp_path / 'x.jsonl', header(), asdict(result(ROUTES[0], 10.0)), asdict(result(ROUTES[0], 20.0)))
    assert [row['route_completion'] for row in read_results(path).rows] == [20.0]
    assert [row.route_completion for row in RowsFile(path, header()).rows.values()] == [20.0]


@pytest.mark.parametrize(
    ('text', 'message'),
    [
        ('', 'is empty'),
        ('\n\n', 'is empty'),
        ('{"driver": "x"}\n', 'line 1 is not the header of results: without suite, version, routes'),
        ('[1]\n', 'line 1 is not the header'),
        ('ROW\n', 'line 1 is not the header'),
        ('{torn', 'line 1 is not JSON'),
        pytest.param('[' * 100_000 + '\n', 'line 1 is not JSON', id='deep'),
        ('NO ROUTES\n', 'line 1 .* routes: not a list'),
        ('NUMBERS\n', 'line 1 .* routes: not a list'),
        ('NO ROUTE\n', "line 1 .* 'Accident' is not of the form"),
        ('HEADER\nnonsense\nROW\n', 'line 2 is not JSON'),
        ('HEADER\nROW\nnonsense\n', 'line 3 is not JSON'),
        ('HEADER\n\nROW\nROW\n{"id": "Accident/0"}\n', 'line 5 is not a result: without type, seed, weather'),
        ('HEADER\nSTRANGE\n', 'line 2 is of Accident/5, which is not among the routes'),
    ],
)
def test_a_damaged_file_is_an_error_that_names_the_line(tmp_path, text, message) -> None:
    places = {
        'HEADER': header(),
        'NO ROUTES': header([]),
        'NUMBERS': header() | {'routes': [1]},
        'NO ROUTE': header() | {'routes': ['Accident']},
        'ROW': asdict(result(ROUTES[0])),
        'STRANGE': asdict(result(RouteId('Accident', 5))),
    }
    text = '\n'.join(json.dumps(places[line]) if line in places else line for line in text.split('\n'))
    path = tmp_path / 'x.jsonl'
    path.write_text(text)
    with pytest.raises(ResultsError, match=f'x.jsonl.*{message}'):
        read_results(path)
    with pytest.raises(ResultsError, match=f'x.jsonl.*{message}.*move it away or give another --out'):
        RowsFile(path, header())
    assert path.read_text() == text


def test_a_file_that_cannot_be_read_is_an_error(tmp_path) -> None:
    with pytest.raises(ResultsError, match='none: cannot be read'):
        read_results(tmp_path / 'none')
    (tmp_path / 'x').write_bytes(b'\xff\xfe')
    for read in (read_results, lambda path: RowsFile(path, header())):
        with pytest.raises(ResultsError, match='x: cannot be read'):
            read(tmp_path / 'x')


def validation_of(file: Path) -> Path:
    """A run whose first validation is `file`."""
    target = file.parent / 'run' / 'validation' / 'round_01.jsonl'
    target.parent.mkdir(parents=True)
    target.write_bytes(file.read_bytes())
    (target.parents[1] / 'metrics.jsonl').write_text('{"step": 1, "loss/masks": 1.0}\n')
    return target.parents[1]


READERS = {
    'read_results': read_results,
    'resume': lambda file: RowsFile(file, header()),
    'recipe': lambda file: failures_by_type(validation_of(file), 1),
    'curves': lambda file: read_run(validation_of(file)),
    'report': lambda file: read_all([file]),
    'graph, line': lambda file: result_from_line(file.read_text().splitlines()[1], 'rows: line 2'),
    'graph, row': lambda file: result_from_row(json.loads(file.read_text().splitlines()[1]), 'result: line 2'),
}
LACKING = object()
BAD = {
    'without weather': {'weather': LACKING},
    'without success': {'success': LACKING},
    'unknown: colour': {'colour': 'red'},
    'id: 5 is not of type str': {'id': 5},
    "'Accident' is not of the form": {'id': 'Accident'},
    'unknown weather': {'weather': 'Snow'},
    'id Accident/0 is not that of HighwayExit/0/ClearNoon/0': {'type': 'HighwayExit'},
    'id Accident/0 is not that of Accident/0/ClearNoon/0, a twin': {'twin': True},
    'limit_s: -inf is not finite': {'limit_s': float('-inf')},
    'seed: True is not of type int': {'seed': True},
    'success: 1 is not of type bool': {'success': 1},
    'failure: None is not of type str': {'failure': None},
    'infractions: not a table of counts': {'infractions': {'red_light': 'twice'}},
    "driving_score: '9' is not a number": {'driving_score': '9'},
    'driving_score: nan is not finite': {'driving_score': float('nan')},
    'comfort: inf is not finite': {'comfort': float('inf')},
    'reward: None is not a number': {'reward': None},
    'is not finite': {'reward': 10**400},
}


@pytest.mark.parametrize('reader', READERS)
def test_every_reader_takes_a_good_row(tmp_path, reader) -> None:
    READERS[reader](write(tmp_path / 'x.jsonl', header(), asdict(result(ROUTES[0]))))


@pytest.mark.parametrize('message', BAD)
@pytest.mark.parametrize('reader', READERS)
def test_every_reader_rejects_the_same_rows(tmp_path, reader, message) -> None:
    changed = asdict(result(ROUTES[0])) | BAD[message]
    row = {name: value for name, value in changed.items() if value is not LACKING}
    path = write(tmp_path / 'x.jsonl', header(), row)
    with pytest.raises(ResultsError, match=f'line 2 is not a result: .*{message}'):
        READERS[reader](path)


# -- no other module ----------------------------------------------------------------------------------------


def offences(tree: ast.AST) -> list[int]:
    """Line numbers of calls that make a RouteResult of a dictionary, or a line of JSON of a RouteResult."""
    found = []
    for call in (node for node in ast.walk(tree) if isinstance(node, ast.Call)):
        name = ast.unparse(call.func).split('.')[-1]
        if (name == 'RouteResult' and any(word.arg is None for word in call.keywords)) or (
            name == 'dumps' and any(ast.unparse(argument).endswith('.to_json()') for argument in call.args)
        ):
            found.append(call.lineno)
    return found


def test_rows_are_read_and_written_in_one_module_only() -> None:
    files = [file for room in ('raw2drive_ros', 'msg_adapters', 'benchmarks') for file in (ROOT / room).rglob('*.py')]
    offenders = {str(file.relative_to(ROOT)) for file in files if offences(ast.parse(file.read_text()))}
    assert offenders == {'raw2drive_ros/evaluation/results.py'}
    planted = 'a = metrics.RouteResult(**row)\nb = json.dumps(row.to_json())\nc = RouteResult(1)'
    assert offences(ast.parse(planted)) == [1, 2]


def test_reading_and_summing_up_needs_no_torch() -> None:
    """The bridge does both, and loads torch only for a learned driver."""
    code = (
        'import sys, raw2drive_ros.evaluation.results, raw2drive_ros.evaluation.statistics\n'
        "raise SystemExit('torch' in sys.modules)"
    )
    assert subprocess.run([sys.executable, '-c', code], cwd=ROOT, timeout=60).returncode == 0
