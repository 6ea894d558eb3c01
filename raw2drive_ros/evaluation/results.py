"""Files of results: a header, then one JSON line per finished drive. Every row of results is read and written here.

A killed writer leaves half a line without a line break at the end of its file; such a torn line is left out by every
reader and removed when the file is resumed. Any other damage is a ResultsError that names the file and the line.
"""

from __future__ import annotations

import json
import math
import time
from collections.abc import Sequence
from dataclasses import fields
from pathlib import Path
from typing import Any, NamedTuple

from raw2drive_ros.artifact import write_whole
from raw2drive_ros.bounds import MAX_RESULTS_BYTES, read_regular
from raw2drive_ros.contracts.errors import ResultsError
from raw2drive_ros.evaluation.metrics import RouteResult
from raw2drive_ros.simulation.protocol import PAIRS
from raw2drive_ros.simulation.route_id import RouteId
from raw2drive_ros.simulation.weather import get_weather

Row = dict[str, Any]
NUMBERS = ('route_completion', 'infraction_score', 'driving_score', 'duration_s', 'reward')
# None where undefined; the oldest files do not have them.
OPTIONAL = ('efficiency', 'comfort')
# Fields that files before suites of version 3 do not have: numbers, and what their rows mean.
LATER = ('limit_s', 'reference_s', 'needless_stop_s')
LATER_DEFAULTS: Row = dict.fromkeys(LATER) | {'twin': False}
TYPES: dict[str, type] = {
    'id': str,
    'type': str,
    'seed': int,
    'weather': str,
    'repetition': int,
    'success': bool,
    'infractions': dict,
    'signs_obeyed': bool,
    'failure': str,
    'twin': bool,
}
FIELDS = tuple(field.name for field in fields(RouteResult))
# Name in older files -> name today.
OLD_HEADER_KEYS = {'quirks': 'bench2drive_compat'}
# Only rows whose headers agree in these may stand in one file.
IDENTITY = ('driver', 'suite', 'version', 'protocol', 'bench2drive_compat')
# Protocol of files whose header names none: a drive ended at its first collision, and lanes were judged by its centre.
OLD_PROTOCOL = 'version 2'


class Results(NamedTuple):
    """header: the file's first record. rows: by finished drive, in the order of the wanted routes."""

    header: Row
    rows: list[Row]

    @property
    def driver(self) -> str:
        return str(self.header['driver'])

    @property
    def wanted(self) -> list[RouteId]:
        return [RouteId.parse(text) for text in self.header['routes']]

    @property
    def missing(self) -> list[RouteId]:
        """Wanted routes without a row: they count as zero."""
        done = {id_of(row) for row in self.rows}
        return [route for route in self.wanted if route not in done]

    def by_id(self) -> dict[RouteId, Row | None]:
        found = {id_of(row): row for row in self.rows}
        return {route: found.get(route) for route in self.wanted}


def id_of(row: Row) -> RouteId:
    """The route that a row is of. Raises RouteIdError."""
    return RouteId.parse(row['id'])


def filmstrips_of(results_file: Path) -> Path:
    """Folder of the pictures of failed routes that belong to a file of results; version 0.2 called it `.strips`."""
    folder, old = results_file.with_suffix('.filmstrips'), results_file.with_suffix('.strips')
    return old if old.is_dir() and not folder.is_dir() else folder


def filmstrip_path(filmstrips: Path, route_id: str) -> Path:
    """The pictures of one failed route."""
    return filmstrips / f'{route_id.replace("/", "_")}.jpg'


# -- reading ----------------------------------------------------------------------------------------


def read_results(path: Path) -> Results:
    """A file that `raw2drive evaluate --out` wrote or is writing; the later of two rows of one route counts.

    Raises ResultsError.
    """
    content = _read(path)
    found = {id_of(row): row for row in content.rows}
    wanted = dict.fromkeys(Results(content.header, []).wanted)
    return Results(content.header, [found[route] for route in wanted if route in found])


def result_from_line(text: str | bytes, source: str) -> RouteResult:
    """A row as the bridge appends it to its `rows_file`. Raises ResultsError that begins with `source`."""
    return result_from_row(_decoded(text, source), source)


def result_from_row(record: Any, source: str) -> RouteResult:
    """What `RouteResult.to_json` gave. Raises ResultsError that begins with `source`."""
    return RouteResult(**_checked_row(record, source))


class _Content(NamedTuple):
    """rows: checked, in the order of the file, and lines: their texts. whole: the file ends as its writer ends it."""

    header: Row
    rows: list[Row]
    lines: list[str]
    whole: bool


def _read(path: Path) -> _Content:
    """Raises ResultsError."""
    try:
        text = read_regular(path, MAX_RESULTS_BYTES).decode().replace('\r\n', '\n')
    except (OSError, UnicodeDecodeError) as error:
        raise ResultsError(f'{path}: cannot be read: {error}') from error
    texts = text.split('\n')
    numbered = [(number, line) for number, line in enumerate(texts, 1) if line.strip()]
    if not numbered:
        raise ResultsError(f'{path}: is empty')
    (number, first), *rest = numbered
    header = _checked_header(_decoded(first, f'{path}: line {number}'), f'{path}: line {number}')
    wanted = {RouteId.parse(route) for route in header['routes']}
    rows: list[Row] = []
    lines: list[str] = []
    for number, line in rest:
        source = f'{path}: line {number}'
        try:
            record = _decoded(line, source)
        except ResultsError:
            # Nothing follows a line break at the end of the file, so this line has none.
            if number == len(texts):
                break
            raise
        row = _checked_row(record, source)
        if id_of(row) not in wanted:
            raise ResultsError(f'{source} is of {row["id"]}, which is not among the routes that the header lists')
        rows.append(row)
        lines.append(line)
    return _Content(header, rows, lines, text.endswith('\n'))


def _decoded(text: str | bytes, source: str) -> Any:
    try:
        return json.loads(text)
    except (ValueError, RecursionError) as error:
        raise ResultsError(f'{source} is not JSON: {error}') from error


def _checked_header(record: Any, source: str) -> Row:
    """With today's keys. Raises ResultsError."""
    try:
        if not isinstance(record, dict):
            raise ValueError(f'{record!r} is not a table')
        as_written: Row = record
        header = {OLD_HEADER_KEYS.get(name, name): value for name, value in as_written.items()}
        _require(header, ('driver', 'suite', 'version', 'routes'))
        routes = header['routes']
        if not isinstance(routes, list) or not routes or not all(isinstance(text, str) for text in routes):
            raise ValueError('routes: not a list of route ids')
        for text in routes:
            RouteId.parse(text)
    except ValueError as error:
        raise ResultsError(f'{source} is not the header of results: {error}') from error
    header.setdefault('protocol', OLD_PROTOCOL)
    return header | {name: str(header[name]) for name in ('driver', 'suite', 'version', 'protocol')}


def _checked_row(record: Any, source: str) -> Row:
    """With every field of RouteResult and no other. Raises ResultsError."""
    try:
        if not isinstance(record, dict):
            raise ValueError(f'{record!r} is not a table')
        row = dict.fromkeys(OPTIONAL) | LATER_DEFAULTS | record
        _require(row, FIELDS)
        if unknown := [name for name in row if name not in FIELDS]:
            raise ValueError(f'unknown: {", ".join(unknown)}')
        for name, kind in TYPES.items():
            # Not `isinstance`, by which true is a number.
            if type(row[name]) is not kind:
                raise ValueError(f'{name}: {row[name]!r} is not of type {kind.__name__}')
        for name in (*NUMBERS, *OPTIONAL, *LATER):
            _check_number(name, row[name])
        if not all(type(count) is int for count in row['infractions'].values()):
            raise ValueError('infractions: not a table of counts')
        named = RouteId(row['type'], row['seed'], get_weather(row['weather']).name, row['repetition'], row['twin'])
        if named != id_of(row):
            parts = '/'.join(str(row[name]) for name in ('type', 'seed', 'weather', 'repetition'))
            raise ValueError(f'id {row["id"]} is not that of {parts}{", a twin" * row["twin"]}')
    except ValueError as error:
        raise ResultsError(f'{source} is not a result: {error}') from error
    return row


def _require(record: Row, names: Sequence[str]) -> None:
    if missing := [name for name in names if name not in record]:
        raise ValueError(f'without {", ".join(missing)}')


def _check_number(name: str, value: Any) -> None:
    if value is None and name in (*OPTIONAL, *LATER):
        return
    if type(value) not in (int, float):
        raise ValueError(f'{name}: {value!r} is not a number')
    try:
        finite = math.isfinite(value)
    except OverflowError:
        finite = False
    if not finite:
        raise ValueError(f'{name}: {value} is not finite')


# -- writing ----------------------------------------------------------------------------------------


def header_of(
    identity: str,
    suite: str,
    version: str,
    routes: Sequence[RouteId],
    *,
    protocol: str = PAIRS,
    bench2drive_compat: bool = False,
) -> Row:
    """The first record of a file of results. identity: of the driver, see `DriverSpec.identity`."""
    return {
        'status': 'failed, no data',
        'started': round(time.time(), 1),
        'driver': identity,
        'suite': suite,
        'version': version,
        'protocol': protocol,
        'bench2drive_compat': bench2drive_compat,
        'routes': [str(route) for route in routes],
    }


def append_row(path: Path, row: RouteResult) -> None:
    """One JSON line at the end of a file."""
    with path.open('a') as file:
        file.write(json.dumps(row.to_json()) + '\n')


class RowsFile:
    """rows: finished routes by id, those of an earlier call included. Without a path nothing is written.

    Raises ResultsError for a file that is damaged, or of another driver, suite, version or way to score, or that
    holds routes which are not asked for now.
    """

    def __init__(self, path: Path | None, header: Row) -> None:
        self.path = path
        self.rows: dict[RouteId, RouteResult] = {}
        if path is None:
            return
        path.parent.mkdir(parents=True, exist_ok=True)
        if path.exists():
            self._take_over(path, header)
        else:
            path.write_text(json.dumps(header) + '\n')

    def add(self, row: RouteResult) -> None:
        self.rows[RouteId.parse(row.id)] = row
        if self.path is not None:
            append_row(self.path, row)

    def _take_over(self, path: Path, header: Row) -> None:
        try:
            content = _read(path)
        except ResultsError as error:
            raise ResultsError(f'{error}; move it away or give another --out') from error
        first = content.header
        different = [
            f'{key} {first.get(key)!r}, not {header[key]!r}' for key in IDENTITY if first.get(key) != header[key]
        ]
        wanted = set(header['routes'])
        if strange := [route for route in first['routes'] if route not in wanted]:
            different.append(f'{strange[0]}, which is not asked for now')
        if different:
            raise ResultsError(f'{path}: holds results of {"; ".join(different)}: give another --out')
        # In the order of the file: the summary's resampling depends on it.
        self.rows = {id_of(row): RouteResult(**row) for row in content.rows}
        if not content.whole or first['routes'] != header['routes']:
            lines = [json.dumps(first | {'routes': header['routes']}), *content.lines]
            write_whole(path, '\n'.join(lines) + '\n')
