"""Shapes in comments and docstrings use the symbols and words of docs/shapes.md, each in the rooms named there."""

import ast
import io
import re
import tokenize
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import pytest

ROOT = Path(__file__).resolve().parents[1]
GLOSSARY = ROOT / 'docs/shapes.md'
FOLDERS = ('raw2drive_ros', 'msg_adapters', 'benchmarks')
GROUND_FLOOR = 'ground floor'
OPERATOR = r'(?:\*\*|//|[-+*/])'
FACTOR = r'(?:\d+|[A-Za-z_][A-Za-z0-9_]*)'
ELEMENT = re.compile(rf'\.\.\.|{FACTOR}(?:\s*{OPERATOR}\s*{FACTOR})*')
SYMBOL = re.compile(r'[A-Z]')
WORD = re.compile(r'[a-z][a-z_]*')


class Shape(NamedTuple):
    line: int
    text: str
    names: list[str]


def shape_in(text: str, line: int) -> Shape | None:
    """The shape that a parenthesised tuple is, or None for prose.

    All elements are `...`, or sums and products of numbers and names. Either all names are single capital letters (at
    least one) and lower-case words, or an element is a single capital letter: `(B, TT)` is a shape with an error,
    while `(Ctrl-C, SIGTERM)` is prose.
    """
    elements = [' '.join(element.split()) for element in text.split(',')]
    elements = [element for element in elements if element]
    if not all(ELEMENT.fullmatch(element) for element in elements):
        return None
    names = [name for element in elements for name in re.findall(r'[A-Za-z_][A-Za-z0-9_]*', element)]
    plain = all(SYMBOL.fullmatch(name) or WORD.fullmatch(name) for name in names)
    has_symbol = any(SYMBOL.fullmatch(name) for name in names)
    alone = any(SYMBOL.fullmatch(element) for element in elements)
    if alone or (plain and has_symbol):
        return Shape(line, f'({" ".join(text.split())})', names)
    return None


def prose_of(source: str) -> Iterator[tuple[int, str]]:
    """(first line, text) of docstrings and other bare strings, and of blocks of comments."""
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant) and isinstance(node.value.value, str):
            yield node.lineno, node.value.value
    first, block = 0, []
    for token in tokenize.generate_tokens(io.StringIO(source).readline):
        if token.type != tokenize.COMMENT:
            continue
        if block and token.start[0] != first + len(block):
            yield first, '\n'.join(block)
            block = []
        first = first if block else token.start[0]
        block.append(token.string.lstrip('#'))
    if block:
        yield first, '\n'.join(block)


def shapes_of(source: str) -> Iterator[Shape]:
    for first, text in prose_of(source):
        for match in re.finditer(r'\(([^()]*,[^()]*)\)', text):
            shape = shape_in(match[1], first + text.count('\n', 0, match.start()))
            if shape is not None:
                yield shape


def room_of(path: Path) -> str:
    """path: below the project's root."""
    parts = path.parts[:-1]
    return (parts[1] if len(parts) > 1 else GROUND_FLOOR) if parts[0] == 'raw2drive_ros' else parts[0]


ROOMS = {room_of(path.relative_to(ROOT)) for folder in FOLDERS for path in (ROOT / folder).rglob('*.py')}


class Glossary:
    """symbols: symbol -> room -> its meanings there, of which there should be one. words: lower-case words."""

    def __init__(self, text: str) -> None:
        _, symbols, words = re.split(r'^## .*$', text, flags=re.MULTILINE)
        self.symbols: dict[str, dict[str, list[str]]] = {}
        for symbol, meaning, rooms in re.findall(r'^\| `(\w+)` \| ([^|]+) \| ([^|]+) \|', symbols, re.MULTILINE):
            for room in _rooms(rooms.strip()):
                self.symbols.setdefault(symbol, {}).setdefault(room, []).append(meaning)
        first_cells = re.findall(r'^\| (`[^|]+) \|', words, re.MULTILINE)
        self.words = {word for cell in first_cells for word in re.findall(r'`(\w+)`', cell)}

    def unknown(self, source: str, room: str) -> list[str]:
        """'LINE: NAME in SHAPE' of every symbol that has no meaning in `room`, and of every unknown word."""
        return [
            f'{shape.line}: {name} in {shape.text}'
            for shape in shapes_of(source)
            for name in shape.names
            if name not in self.words and room not in self.symbols.get(name, {})
        ]


def _rooms(cell: str) -> set[str]:
    """Of 'all', 'all but `a`, `b`' or '`a`, `b`'. Raises ValueError for a room that does not exist."""
    named = set(re.findall(r'`([^`]+)`', cell))
    if not named <= ROOMS or (not named and cell != 'all'):
        raise ValueError(f'rooms of docs/shapes.md: {cell!r} is not made of {sorted(ROOMS)}')
    return ROOMS - named if cell.startswith('all') else named


@pytest.fixture(scope='module')
def glossary() -> Glossary:
    return Glossary(GLOSSARY.read_text(encoding='utf-8'))


@pytest.mark.parametrize('folder', FOLDERS)
def test_every_shape_is_made_of_known_symbols(glossary, folder) -> None:
    found = []
    for path in sorted((ROOT / folder).rglob('*.py')):
        name = path.relative_to(ROOT)
        found += [f'{name}:{line}' for line in glossary.unknown(path.read_text(encoding='utf-8'), room_of(name))]
    assert found == [], 'not in docs/shapes.md for this room'


def test_a_symbol_has_one_meaning_per_room(glossary) -> None:
    assert all(SYMBOL.fullmatch(symbol) for symbol in glossary.symbols)
    double = {(s, room): m for s, by_room in glossary.symbols.items() for room, m in by_room.items() if len(m) > 1}
    assert double == {}


def test_the_tables_and_the_shapes_are_read(glossary) -> None:
    """A heading or a format that changed would make the test above pass by reading nothing."""
    assert {'B', 'T', 'H', 'D', 'S', 'K', 'E', 'G', 'N', 'F', 'W', 'Z'} <= set(glossary.symbols)
    assert {'views', 'height', 'width', 'blocks'} <= glossary.words
    source = (ROOT / 'raw2drive_ros/world_model/rssm.py').read_text(encoding='utf-8')
    assert {'(..., D + S*K)', '(B, T, S, K)', '(blocks, I, O)'} <= {shape.text for shape in shapes_of(source)}


@pytest.mark.parametrize(
    ('text', 'wrong'),
    [
        ('"""(B, X) of a step."""', '1: X in (B, X)'),
        ('"""One line.\n\n    x: (..., D + S*J).\n    """', '3: J in (..., D + S*J)'),
        ('"""(N, views,\n    banana, 3)"""', '1: banana in (N, views, banana, 3)'),
        ('"""(B, TT)"""', '1: TT in (B, TT)'),
        ('def f():\n    x = 1  # (Y, 3)', '2: Y in (Y, 3)'),
        ('# First line: (B,\n# U).', '1: U in (B, U)'),
        ('x = 1\n"""Of x: (X,)."""', '2: X in (X,)'),
    ],
)
def test_a_planted_unknown_symbol_is_found(glossary, text, wrong) -> None:
    assert glossary.unknown(text, 'training') == [wrong]


def test_a_symbol_of_another_room_is_found(glossary) -> None:
    assert glossary.unknown('"""(Q, 4, 3)"""', 'simulation') == []
    assert glossary.unknown('"""(Q, 4, 3)"""', 'training') == ['1: Q in (Q, 4, 3)']
    assert glossary.unknown('"""(Z, side)"""', GROUND_FLOOR) == []
    two = Glossary('## Symbols\n| `H` | steps | `training` | |\n| `H` | height | all but `training` | |\n## Words\n')
    assert two.symbols['H']['training'] == ['steps'] and two.symbols['H']['report'] == ['height']
    with pytest.raises(ValueError, match='trainning'):
        Glossary('## Symbols\n| `H` | steps | `trainning` | |\n## Words\n')


@pytest.mark.parametrize(
    'text',
    [
        '(Ctrl-C, SIGTERM)',
        '(paper, section 3.3)',
        '(x, y)',
        '(its S recipe, which everything else is taken from)',
        'max(1, EMA of P95 - P5 of the returns)',
        '(rows, columns, weights)',
        '(B)',
        '(H + 1) N, 3',
        '(see R, M or Q)',
    ],
)
def test_prose_is_no_shape(text) -> None:
    assert list(shapes_of(f'"""{text}"""')) == []


def test_code_is_not_searched() -> None:
    assert list(shapes_of('x = (X, Y)\ny = "(X, Y)"')) == []
