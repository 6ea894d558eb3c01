"""Links, files, modules, make targets, verbs and options that documents name exist.

`docs/lab_notes.md` and `CHANGELOG.rst` are left out: they tell history, in the names of its time.
"""

import argparse
import importlib
import re
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import pytest

from raw2drive_ros.cli.main import VERBS

ROOT = Path(__file__).resolve().parents[1]
DOCUMENTS = [
    ROOT / 'README.md',
    ROOT / 'CONTRIBUTING.md',
    ROOT / 'SECURITY.md',
    ROOT / 'bags/README.md',
    *(path for path in sorted(ROOT.glob('docs/**/*.md')) if path.name != 'lab_notes.md'),
]
# A path of a document is relative to one of these.
BASES = (ROOT, ROOT / 'raw2drive_ros', ROOT / 'test')
CODE_FOLDERS = ('raw2drive_ros', 'msg_adapters', 'benchmarks', 'examples', 'launch', 'test', 'tools')
# What begins with one of these is a path of the repository, whatever its ending.
FOLDERS = (*CODE_FOLDERS, 'params', 'docs', 'bags')
# Names of files that only others have.
FOREIGN = {'rclpy.py'}
FENCE = re.compile(r'^```.*?^```', re.MULTILINE | re.DOTALL)
COMMENT = re.compile(r'\s#.*')
LINK = re.compile(r'\]\(([^)\s]+)\)')
# Words of shell syntax end a command; so does a comment.
COMMAND = re.compile(r'raw2drive +([^|&;#]*)')


class OptionNames(argparse.ArgumentParser):
    """Collects the options of a verb that its help shows; old spellings are hidden there."""

    def __init__(self) -> None:
        self.names: set[str] = set()
        super().__init__()

    def add_argument(self, *names, **options):
        if options.get('help') != argparse.SUPPRESS:
            self.names |= set(names)
        return super().add_argument(*names, **options)


@cache
def options_of(verb: str) -> set[str]:
    parser = OptionNames()
    importlib.import_module(f'raw2drive_ros.cli.{VERBS[verb][0]}').add_arguments(parser)
    return parser.names


@cache
def python_files() -> set[str]:
    return {'setup.py', *(path.name for folder in CODE_FOLDERS for path in (ROOT / folder).rglob('*.py'))}


@cache
def make_targets() -> set[str]:
    return set(re.findall(r'^([\w-]+):', (ROOT / 'Makefile').read_text(), re.MULTILINE))


def code_of(text: str) -> list[str]:
    """Lines of fenced blocks, and what stands between backticks, on one line."""
    fences = FENCE.findall(text)
    spans = re.findall(r'`([^`]+)`', FENCE.sub('', text))
    lines = [line for fence in fences for line in fence.splitlines()[1:-1]]
    return [COMMENT.sub('', line) for line in lines] + [' '.join(span.split()) for span in spans]


def broken_links(text: str, folder: Path) -> Iterator[str]:
    for target in LINK.findall(re.sub(r'`[^`]+`', '', FENCE.sub('', text))):
        path = target.partition('#')[0]
        if not re.match(r'[a-z]+:', target) and path and not (folder / path).exists():
            yield f'link {target}'


def missing_files(code: str) -> Iterator[str]:
    """Python files by path or bare name, and paths that begin with a folder of the project. NAME is a placeholder."""
    for word in re.findall(r'[\w./*-]+', code):
        name = word.rstrip('.')
        first = name.split('/')[0]
        is_path = '/' in name and first in FOLDERS
        if 'NAME' in name or '...' in word or name in FOREIGN or not (name.endswith('.py') or is_path):
            continue
        if not ('/' not in name and name in python_files()) and not any(
            next(base.glob(name), None) for base in BASES if not name.startswith('/')
        ):
            yield f'file {name}'


def unknown_modules_and_targets(code: str) -> Iterator[str]:
    for module in re.findall(r'python -m ((?:raw2drive_ros|msg_adapters|benchmarks)[\w.]*)', code):
        path = ROOT / module.replace('.', '/')
        if 'NAME' not in module and not path.with_suffix('.py').is_file() and not (path / '__init__.py').is_file():
            yield f'module {module}'
    for target in re.findall(r'(?:^|\s)make ([\w-]+)', code):
        if target not in make_targets():
            yield f'make {target}'


def unknown_verbs(code: str) -> Iterator[str]:
    """Verbs, and options that the verb's help does not show. VERB is a placeholder."""
    for command in COMMAND.findall(code):
        words = command.split()
        if not words or words[0] in ('VERB', '...') or words[0].startswith('-'):
            continue
        verb = ' '.join(words[:2]) if ' '.join(words[:2]) in VERBS else words[0]
        if verb not in VERBS:
            yield f'verb {verb}'
            continue
        named = {match[1] for word in words if (match := re.match(r'\[?(--[a-z][\w-]*)', word))}
        yield from (f'option {verb} {name}' for name in sorted(named - options_of(verb)))


def faults(text: str, folder: Path = ROOT) -> list[str]:
    """Everything that a document in `folder` names and that does not exist."""
    checks = (missing_files, unknown_modules_and_targets, unknown_verbs)
    found = [fault for code in code_of(text) for check in checks for fault in check(code)]
    return [*broken_links(text, folder), *found]


@pytest.mark.parametrize('document', DOCUMENTS, ids=lambda path: str(path.relative_to(ROOT)))
def test_whatever_a_document_names_exists(document) -> None:
    assert faults(document.read_text(), document.parent) == []


@pytest.mark.parametrize(
    ('text', 'fault'),
    [
        ('see [the map](docs/nowhere.md)', 'link docs/nowhere.md'),
        ('see [a part](docs/nowhere.md#part)', 'link docs/nowhere.md#part'),
        ('![picture](docs/nothing.jpg)', 'link docs/nothing.jpg'),
        ('in `evaluation/strips.py`', 'file evaluation/strips.py'),
        ('in `raw2drive_ros/driving/drivers.py`.', 'file raw2drive_ros/driving/drivers.py'),
        ('in `drivers_of_old.py`', 'file drivers_of_old.py'),
        ('in `params/nothing.yaml`', 'file params/nothing.yaml'),
        ('in `docs/*.nothing`', 'file docs/*.nothing'),
        ('run `pytest test/nodes/test_peers.py -k one`', 'file test/nodes/test_peers.py'),
        ('```\npython -m pytest test/nowhere/test_x.py::test_y\n```', 'file test/nowhere/test_x.py'),
        ('`python -m benchmarks.nothing --seconds 3`', 'module benchmarks.nothing'),
        ('`make nothing`', 'make nothing'),
        ('`raw2drive facts list`', 'verb facts'),
        ('`raw2drive\nfacts list`', 'verb facts'),
        ('```\ncd x && raw2drive facts    # old\n```', 'verb facts'),
        ('`raw2drive evaluate --quirks`', 'option evaluate --quirks'),
        ('`raw2drive evaluate faults --faults x`', 'option evaluate faults --faults'),
        ('```\nraw2drive report a.jsonl --strips 3\n```', 'option report --strips'),
        ('`raw2drive calibration --run RUN [--jsonl]`', 'option calibration --jsonl'),
    ],
)
def test_a_planted_fault_is_found(text, fault) -> None:
    assert faults(text) == [fault]


@pytest.mark.parametrize(
    'text',
    [
        'see [the map](docs/architecture.md#rooms), [the paper](https://example.org/x.md), [above](#rooms)',
        'in `driving/gate.py`, `gate.py`, `test/test_layers.py`, `nodes/test_graph.py`, `params/suites/*.json`',
        '`cli/NAME.py`, `benchmarks/NAME.py`, `raw2drive VERB --help`; `runs/x/metrics.jsonl`, `/control/command`',
        '`setup.py`, `CONTRIBUTING.md`',
        '```\nraw2drive evaluate faults --seeds 3    # not --nothing\nmake demo\n[no link](nowhere.md)\n```',
        '`raw2drive evaluate ... --seeds 20`, `raw2drive`, `python -m benchmarks.graph`, `python -m pytest -q`',
    ],
)
def test_what_exists_and_placeholders_are_no_faults(text) -> None:
    assert faults(text) == []
