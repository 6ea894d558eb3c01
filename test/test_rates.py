"""The rates of decisions, physics, route and diagnostics are numbers in `tables/rates.py`, and nowhere else."""

import ast
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

from raw2drive_ros.contracts.errors import ConfigError
from raw2drive_ros.settings import params_folder
from raw2drive_ros.tables import rates
from raw2drive_ros.timing import load_timing

ROOT = Path(__file__).resolve().parents[1]
FOLDERS = ('raw2drive_ros', 'msg_adapters', 'examples', 'launch', 'benchmarks')
RATE_NAME = re.compile(r'(?i)((^|_)(hz|substeps)|(^|_)(tick|decision|physics)_n?s)$')
# Rates that one file alone uses: how often delayed messages are delivered, how fast lamps and legs change in images.
OTHER_RATES = {'DELIVER_HZ', 'PHASE_HZ'}


def is_number(node: ast.expr | None) -> bool:
    """A number other than 0, or arithmetic on numbers alone."""
    names = [n for n in ast.walk(node) if isinstance(n, ast.Name | ast.Call | ast.Attribute)] if node else []
    numbers = [n.value for n in ast.walk(node) if isinstance(n, ast.Constant)] if node else []
    return not names and any(isinstance(n, int | float) and n for n in numbers)


def assignments(tree: ast.AST) -> Iterator[tuple[str, ast.expr | None]]:
    """(name, value) of variables, fields, defaults of parameters, keyword arguments, dictionary entries."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Assign):
            for target in node.targets:
                pairs = [(target, node.value)]
                if isinstance(target, ast.Tuple) and isinstance(node.value, ast.Tuple):
                    pairs = list(zip(target.elts, node.value.elts, strict=True))
                yield from ((ast.unparse(name), value) for name, value in pairs)
        elif isinstance(node, ast.AnnAssign):
            yield ast.unparse(node.target), node.value
        elif isinstance(node, ast.keyword) and node.arg:
            yield node.arg, node.value
        elif isinstance(node, ast.Dict):
            yield from ((str(k.value), v) for k, v in zip(node.keys, node.values) if isinstance(k, ast.Constant))
        elif isinstance(node, ast.arguments):
            positional = [*node.posonlyargs, *node.args]
            yield from ((a.arg, d) for a, d in zip(reversed(positional), reversed(node.defaults)))
            yield from ((a.arg, d) for a, d in zip(node.kwonlyargs, node.kw_defaults))


def numeric_rates(source: str) -> list[str]:
    return [name for name, value in assignments(ast.parse(source)) if RATE_NAME.search(name) and is_number(value)]


@pytest.mark.parametrize(
    'source',
    [
        'PHYSICS_HZ = 20',
        'PHYSICS_HZ, OTHER = 20, 3',
        'self.rate_hz = 10.0',
        'class A:\n    decision_rate_hz: float = 10.0',
        'TopicSpec(name=CLOCK, rate_hz=20)',
        'def f(rate_hz=10): pass',
        'def f(*, tick_s=1 / 20): pass',
        "{'policy_frequency_hz': 10}",
        'TICK_NS = 1_000_000_000 // 10',
        'SUBSTEPS = 2',
    ],
)
def test_a_copy_is_found(source) -> None:
    assert len(numeric_rates(source)) == 1


@pytest.mark.parametrize('source', ['TICK_S = 1.0 / PHYSICS_HZ', 'rate_hz=topics.RATE', 'f(rate_hz=DECISION_HZ)'])
def test_a_reference_is_none(source) -> None:
    assert numeric_rates(source) == []


def test_no_file_has_a_copy_of_a_rate() -> None:
    files = [path for folder in FOLDERS for path in (ROOT / folder).rglob('*.py')]
    found = {str(p.relative_to(ROOT)): set(numeric_rates(p.read_text())) - OTHER_RATES for p in files}
    assert {path: names for path, names in found.items() if names} == {
        'raw2drive_ros/tables/rates.py': {'DECISION_HZ', 'PHYSICS_HZ', 'ROUTE_HZ', 'DIAGNOSTICS_HZ'}
    }


def test_a_decision_is_a_whole_number_of_physics_steps_and_of_nanoseconds() -> None:
    assert (rates.DECISION_HZ, rates.PHYSICS_HZ, rates.SUBSTEPS, rates.ROUTE_EVERY_TICKS) == (10, 20, 2, 10)
    assert rates.SUBSTEPS * rates.DECISION_HZ == rates.PHYSICS_HZ
    assert rates.DECISION_NS == rates.SUBSTEPS * rates.PHYSICS_NS == 100_000_000


@pytest.mark.parametrize('key', ['decision_rate_hz', 'physics_rate_hz'])
def test_a_timing_file_that_sets_a_rate_that_nobody_reads_is_an_error(tmp_path, key) -> None:
    old = tmp_path / 'timing.yaml'
    old.write_text((params_folder() / 'timing.yaml').read_text() + f'{key}: 15.0\n')
    with pytest.raises(ConfigError, match=f'{key}: no such key'):
        load_timing(old)
