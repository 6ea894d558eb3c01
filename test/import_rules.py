"""The rooms of the house from the top down, and what an import may do: run downward, or stay in its room."""

from __future__ import annotations

import ast
from collections.abc import Iterator, Mapping
from functools import cache
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
NAME = 'raw2drive_ros'
# From the top floor down. Rooms of one floor do not know each other. Seven are single files.
FLOORS: tuple[tuple[str, ...], ...] = (
    ('benchmarks', 'examples', 'launch'),
    (f'{NAME}.cli',),
    (f'{NAME}.graph', f'{NAME}.gym'),
    (f'{NAME}.nodes', f'{NAME}.report'),
    (f'{NAME}.evaluation',),
    (f'{NAME}.training',),
    (f'{NAME}.recording', f'{NAME}.conformance', f'{NAME}.carla_vehicle'),
    (f'{NAME}.faults', f'{NAME}.driving'),
    (f'{NAME}.simulation', f'{NAME}.world_model'),
    ('msg_adapters',),
    (f'{NAME}.artifact', f'{NAME}.timing'),
    (f'{NAME}.progress', f'{NAME}.runtime_folder', f'{NAME}.safe_path', f'{NAME}.settings'),
    (f'{NAME}.bounds',),
    (f'{NAME}.contracts',),
    (f'{NAME}.tables', NAME),
)
ROOMS = tuple(room for floor in FLOORS for room in floor)
FLOOR_OF = {room: number for number, floor in enumerate(FLOORS) for room in floor}


def room_of(module: str) -> str | None:
    """The room that a module belongs to; None for what is not ours. Raises KeyError for ours without a room."""
    parts = module.split('.')
    for length in range(len(parts), 0, -1):
        name = '.'.join(parts[:length])
        if name in FLOOR_OF and (name != NAME or length == len(parts)):
            return name
    if parts[0] == NAME:
        raise KeyError(f'{module} is in no room: add it to FLOORS in test/import_rules.py and to docs/architecture.md')
    return None


def module_of(path: Path) -> str:
    parts = path.with_suffix('').parts
    return '.'.join(parts[:-1] if parts[-1] == '__init__' else parts)


def sources() -> dict[str, str]:
    """module -> source of everything that has a room."""
    files = [
        path
        for folder in (NAME, 'msg_adapters', 'benchmarks', 'examples', 'launch')
        for path in sorted((ROOT / folder).rglob('*.py'))
    ]
    return {module_of(path.relative_to(ROOT)): path.read_text(encoding='utf-8') for path in files}


def imports_of(module: str, source: str, known: Mapping[str, str]) -> Iterator[tuple[str, bool]]:
    """(imported module, is it imported when `module` is): wherever in the file the import stands."""
    for owner, name, at_once in _statements(module, source):
        whole = f'{owner}.{name}' if name else owner
        yield whole if whole in known or not name else owner, at_once


@cache
def _statements(module: str, source: str) -> list[tuple[str, str, bool]]:
    """(module, name taken from it or '', at import time?) of every import. Raises ValueError for a relative one."""
    tree = ast.parse(source)
    late = {id(inner) for node in ast.walk(tree) if _is_late(node) for inner in ast.walk(node)}
    found = []
    for node in ast.walk(tree):
        at_once = id(node) not in late
        if isinstance(node, ast.Import):
            found += [(alias.name, '', at_once) for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            if node.level:
                raise ValueError(f'{module}: a relative import; write the whole name')
            found += [(str(node.module), alias.name, at_once) for alias in node.names]
    return found


def _is_late(node: ast.AST) -> bool:
    """A function's body runs later, a block for type checkers never."""
    if isinstance(node, ast.If):
        return isinstance(node.test, ast.Name) and node.test.id == 'TYPE_CHECKING'
    return isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.Lambda)


def violations(known: Mapping[str, str]) -> list[str]:
    """Every import that runs upward or to another room of the same floor."""
    found = []
    for module, source in known.items():
        own = room_of(module)
        for imported, _ in imports_of(module, source, known):
            theirs = room_of(imported)
            if own is None or theirs is None or own == theirs:
                continue
            if FLOOR_OF[theirs] <= FLOOR_OF[own]:
                found.append(f'{module} imports {imported}: {own} stands on floor {-FLOOR_OF[own]}, {theirs} not below')
    return found


def circles(known: Mapping[str, str], *, at_once: bool) -> list[set[str]]:
    """Sets of modules that import each other in a circle; at_once: counting only what is imported at import time."""
    arrows = {
        module: {name for name, now in imports_of(module, source, known) if name in known and (now or not at_once)}
        for module, source in known.items()
    }
    reach: dict[str, set[str]] = {}
    for module in arrows:
        seen, waiting = set(), [module]
        while waiting:
            for name in arrows[waiting.pop()] - seen:
                seen.add(name)
                waiting.append(name)
        reach[module] = seen
    found: list[set[str]] = []
    for module in arrows:
        circle = {name for name in reach[module] if module in reach[name]}
        if circle and circle not in found:
            found.append(circle)
    return found
