"""Tables are not cut: into a pipe a row is a line, in a narrow terminal a cell goes on in the next line."""

import io
import re

import pytest
from rich.console import Console
from rich.table import Table

from raw2drive_ros.cli import table as tables
from raw2drive_ros.cli.main import main
from raw2drive_ros.cli.table import add_column, wide_console

LONGEST = 'VanillaNonSignalizedTurnEncounterStopsign'


def test_a_piped_row_is_one_whole_line(capsys, monkeypatch) -> None:
    monkeypatch.setenv('COLUMNS', '40')
    words = ['--routes', LONGEST, '--seeds', '1', '--weather', 'ClearNight']
    assert main(['evaluate', '--driver', 'straight', *words]) == 0
    lines = capsys.readouterr().out.splitlines()
    (row,) = [line for line in lines if line.startswith('│')]
    assert f' {LONGEST}/0/ClearNight ' in row
    assert re.search(r'│ +\d+\.\d │ .* │ +\d+\.\d │ +no │$', row)
    assert '…' not in ''.join(lines)


@pytest.mark.parametrize('width', [20, 40, 80])
def test_no_cell_is_cut_in_a_narrow_terminal(width) -> None:
    table = Table()
    for title, right in (('route', False), ('completion %', True), ('score', True)):
        add_column(table, title, right=right)
    table.add_row(f'{LONGEST}/0', '100.0', '93.25')
    out = io.StringIO()
    Console(file=out, width=width).print(table)
    cells = [line.split('│')[1:-1] for line in out.getvalue().splitlines() if line.startswith('│')]
    assert [''.join(cell.strip() for cell in column) for column in zip(*cells)] == [f'{LONGEST}/0', '100.0', '93.25']


def test_a_terminal_keeps_its_own_width(monkeypatch) -> None:
    monkeypatch.setattr(tables.sys.stdout, 'isatty', lambda: True, raising=False)
    monkeypatch.setenv('COLUMNS', '57')
    assert wide_console().width == 57
    monkeypatch.setattr(tables.sys.stdout, 'isatty', lambda: False, raising=False)
    assert wide_console().width == tables.PIPED_COLUMNS
