"""Files and functions stay small enough to read in one sitting."""

import ast
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
FOLDERS = ('raw2drive_ros', 'msg_adapters', 'benchmarks', 'test', 'launch', 'examples')
MAX_FILE_LINES = 400
MAX_FUNCTION_LINES = 60


def too_long(source: str) -> list[str]:
    """What exceeds a limit in one file's text: the file itself, and each function by name and line."""
    lines = len(source.splitlines())
    found = [f'the file has {lines} lines'] if lines > MAX_FILE_LINES else []
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            assert node.end_lineno is not None
            length = node.end_lineno - node.lineno + 1
            if length > MAX_FUNCTION_LINES:
                found.append(f'{node.name} (line {node.lineno}) has {length} lines')
    return found


def function(lines: int, head: str = 'def f():') -> str:
    """A function of so many lines."""
    return '\n'.join([head, *['    pass'] * (lines - 1)])


@pytest.mark.parametrize('folder', FOLDERS)
def test_no_file_and_no_function_is_too_long(folder) -> None:
    paths = sorted((ROOT / folder).rglob('*.py'))
    assert paths, f'{folder} holds no Python file: is it still called that?'
    offenders = [f'{path.relative_to(ROOT)}: {what}' for path in paths for what in too_long(path.read_text())]
    assert offenders == []


@pytest.mark.parametrize(
    ('source', 'expected'),
    [
        ('pass\n' * 400, []),
        ('pass\n' * 401, ['the file has 401 lines']),
        (function(60), []),
        (function(61), ['f (line 1) has 61 lines']),
        ('\n' + function(61, 'async def f():'), ['f (line 2) has 61 lines']),
        ('class C:\n    def g(self):\n' + '        pass\n' * 60, ['g (line 2) has 61 lines']),
        (
            'def outer():\n    def inner():\n' + '        pass\n' * 60,
            ['outer (line 1) has 62 lines', 'inner (line 2) has 61 lines'],
        ),
    ],
)
def test_what_is_one_line_too_long_is_found(source, expected) -> None:
    assert too_long(source) == expected
