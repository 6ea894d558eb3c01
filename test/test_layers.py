"""Which room may import which: by syntax tree, and in processes of their own with the forbidden package blocked."""

import itertools
import re
import subprocess
import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parent))

from import_rules import FLOOR_OF, FLOORS, ROOMS, ROOT, circles, imports_of, room_of, sources, violations

from raw2drive_ros.cli.main import VERBS

BLOCK = """
import sys
class Blocker:
    def find_spec(self, name, path=None, target=None):
        if name.split('.')[0] in {blocked!r}:
            raise ImportError('blocked: ' + name)
sys.meta_path.insert(0, Blocker())
import importlib, pkgutil
for package in {packages!r}:
    module = importlib.import_module(package)
    for found in pkgutil.walk_packages(module.__path__, package + '.'):
        importlib.import_module(found.name)
"""


def run_python(code: str) -> subprocess.CompletedProcess:
    return subprocess.run([sys.executable, '-c', code], cwd=ROOT, capture_output=True, text=True, timeout=120)


@pytest.fixture(scope='module')
def known() -> dict[str, str]:
    return sources()


@pytest.mark.parametrize('room', ROOMS)
def test_imports_of_a_room_run_downward(known, room) -> None:
    inside = {module for module in known if room_of(module) == room}
    assert inside, f'{room} is empty: take it out of FLOORS'
    assert [line for line in violations(known) if line.split(' ')[0] in inside] == []


@pytest.mark.parametrize('room', [room for floor in FLOORS[1:] for room in floor])
def test_an_import_that_climbs_is_found_in_every_room(known, room) -> None:
    """Planted in a real file of the room: at its top, in a function, for type checkers only."""
    victim = next(module for module in known if room_of(module) == room)
    above = next(module for module in known if FLOOR_OF[room_of(module)] == FLOOR_OF[room] - 1)
    for planted in (
        f'import {above}',
        f'from {above} import something',
        f'def later():\n    from {above} import something',
        f'from typing import TYPE_CHECKING\nif TYPE_CHECKING:\n    import {above}',
    ):
        found = violations(known | {victim: known[victim] + '\n' + planted + '\n'})
        assert [line for line in found if line.startswith(f'{victim} imports {above}:')], planted


def test_rooms_of_one_floor_do_not_know_each_other(known) -> None:
    planted = known | {'raw2drive_ros.report.html': 'from raw2drive_ros.nodes import runtime'}
    assert 'raw2drive_ros.report.html imports' in violations(planted)[0]
    with pytest.raises(KeyError, match='is in no room'):
        room_of('raw2drive_ros.attic.chest')


def test_the_only_circle_is_one_of_types(known) -> None:
    """The world and its traffic name each other's types; nothing of it runs at import time."""
    names = (
        *('actors', 'background', 'car_following', 'contact', 'ego_route', 'flows', 'free_space', 'leaders'),
        *('right_of_way', 'roadside', 'scenario', 'scripts', 'world', 'world_actors'),
    )
    world = {f'raw2drive_ros.simulation.{name}' for name in names}
    assert circles(known, at_once=False) == [world]
    assert circles(known, at_once=True) == []
    planted = known | {'msg_adapters.stamps': 'import msg_adapters.sensors'}
    assert {'msg_adapters.stamps', 'msg_adapters.sensors'} <= set().union(*circles(planted, at_once=True))


def test_documents_list_the_rooms_in_order() -> None:
    ours = [room for room in ROOMS if room.split('.')[0] in ('raw2drive_ros', 'msg_adapters')]
    folders = [room for room in ours if (ROOT / room.replace('.', '/')).is_dir() and room != 'raw2drive_ros']
    for name in ('docs/architecture.md', 'CONTRIBUTING.md'):
        text = (ROOT / name).read_text()
        rows = re.findall(r'^\|(?: \d+ \|)? `((?:raw2drive_ros|msg_adapters)[\w/]*)/` \|', text, re.MULTILINE)
        listed = [row.replace('/', '.') for row in rows]
        assert sorted(listed) == sorted(folders), name
        assert [FLOOR_OF[room] for room in listed] == sorted(FLOOR_OF[room] for room in listed), name


def walks(text: str) -> list[list[str]]:
    """The chains `a.py` > `b.py` > ... of a text, as module names."""
    chains = re.findall(r'`[\w/]+\.py`(?: > `[\w/]+\.py`)+', text)
    files = [re.findall(r'`([\w/]+)\.py`', chain) for chain in chains]
    return [[f if f.startswith('msg_adapters') else f'raw2drive_ros.{f}' for f in chain] for chain in files]


def test_the_walks_of_the_architecture_go_straight_down(known) -> None:
    found = [[name.replace('/', '.') for name in walk] for walk in walks((ROOT / 'docs/architecture.md').read_text())]
    assert len(found) >= 10
    for walk in found:
        for here, there in itertools.pairwise(walk):
            assert there in {name for name, _ in imports_of(here, known[here], known)}, f'{here} > {there}'
            assert FLOOR_OF[room_of(here)] <= FLOOR_OF[room_of(there)], f'{here} > {there} goes up'
    assert walks('`a/b.py` > `msg_adapters/c.py` and `d.py`') == [['raw2drive_ros.a/b', 'msg_adapters/c']]


@pytest.mark.parametrize(
    ('packages', 'blocked'),
    [
        (
            [
                f'raw2drive_ros.{n}'
                for n in (
                    'simulation',
                    'world_model',
                    'driving',
                    'training',
                    'evaluation',
                    'recording',
                    'faults',
                    'carla_vehicle',
                    'conformance',
                    'report',
                    'graph',
                    'cli',
                )
            ],
            ['rclpy'],
        ),
        (['msg_adapters'], ['rclpy', 'torch', 'highway_env']),
        (['raw2drive_ros.simulation'], ['torch', 'rclpy', 'rosbags']),
        (['raw2drive_ros.world_model'], ['rclpy', 'highway_env', 'rosbags']),
        (['raw2drive_ros.recording'], ['torch', 'rclpy', 'highway_env']),
        (['raw2drive_ros.conformance'], ['torch', 'rclpy', 'highway_env']),
        (['raw2drive_ros.carla_vehicle'], ['torch', 'rclpy', 'highway_env', 'carla']),
        (['raw2drive_ros.faults'], ['torch', 'rclpy', 'highway_env']),
        (['raw2drive_ros.cli'], ['torch', 'highway_env']),
    ],
)
def test_rooms_import_without_what_they_may_not_need(packages, blocked) -> None:
    result = run_python(BLOCK.format(packages=packages, blocked=blocked))
    assert result.returncode == 0, result.stderr[-600:]


def test_rclpy_is_imported_only_by_nodes() -> None:
    pattern = re.compile(r'^\s*(import|from) rclpy', re.MULTILINE)
    offenders = [
        str(path.relative_to(ROOT))
        for folder in ('raw2drive_ros', 'msg_adapters')
        for path in (ROOT / folder).rglob('*.py')
        if pattern.search(path.read_text()) and 'nodes' not in path.parts
    ]
    assert offenders == []


@pytest.mark.parametrize(
    ('node', 'unneeded'),
    [
        ('safety_gate', ('torch', 'highway_env')),
        ('recorder', ('torch', 'highway_env')),
        ('player', ('torch', 'highway_env')),
        ('command_adapter', ('torch', 'highway_env')),
        ('fault_injector', ('torch', 'highway_env')),
        ('bridge', ('torch',)),
    ],
)
def test_the_process_of_a_node_loads_no_more_than_it_needs(node, unneeded) -> None:
    loaded = f'", ".join({set(unneeded)!r} & sys.modules.keys())'
    result = run_python(f'import sys, raw2drive_ros.nodes.{node}\nraise SystemExit({loaded} or 0)')
    assert result.returncode == 0, result.stderr[-600:]


@pytest.mark.parametrize(
    'module',
    [
        'raw2drive_ros.contracts.privileged',
        'msg_adapters.privileged',
        'msg_adapters.privileged_actors',
        'raw2drive_ros.simulation.world',
        'raw2drive_ros.training.privileged',
        'raw2drive_ros.recording.bag_reader',
        'raw2drive_ros.world_model.teacher',
        'raw2drive_ros.world_model.mask_codec',
        'raw2drive_ros.world_model.privileged_inputs',
    ],
)
def test_the_planner_process_cannot_import_privileged_code(module) -> None:
    result = run_python(f'import raw2drive_ros.nodes.planner, importlib; importlib.import_module({module!r})')
    assert result.returncode != 0
    assert 'is privileged and cannot be imported by the planner' in result.stderr


def test_the_planner_process_starts_clean() -> None:
    code = (
        'import sys, raw2drive_ros.nodes.planner as p; from raw2drive_ros.driving.isolation import FORBIDDEN; '
        "raise SystemExit(', '.join(m for m in sys.modules if m.startswith(FORBIDDEN)) or 0)"
    )
    result = run_python(code)
    assert result.returncode == 0, result.stderr[-600:]


def test_the_planner_cannot_subscribe_to_a_privileged_topic() -> None:
    code = """
import rclpy
from sensor_msgs.msg import CompressedImage
from raw2drive_ros.nodes.planner import PlannerNode
rclpy.init(domain_id=97)
node = PlannerNode()
node.create_subscription(CompressedImage, '/privileged/bev', print, 1)
"""
    result = run_python(code)
    assert 'PrivilegedImportError: /privileged/bev is privileged' in result.stderr


@pytest.mark.parametrize('verb', ['', *VERBS])
def test_help_loads_nothing_heavy(verb) -> None:
    code = (
        'import sys; from raw2drive_ros.cli.main import main\n'
        f"try: main([*{verb.split()!r}, '--help'])\nexcept SystemExit: pass\n"
        "raise SystemExit(', '.join({'torch', 'highway_env', 'rclpy', 'pydantic'} & sys.modules.keys()) or 0)"
    )
    result = run_python(code)
    assert result.returncode == 0, result.stderr


def test_versions_agree() -> None:
    from raw2drive_ros import __version__

    assert f"version='{__version__}'" in (ROOT / 'setup.py').read_text()
    assert f'<version>{__version__}</version>' in (ROOT / 'package.xml').read_text()
    assert f'{__version__} (' in (ROOT / 'CHANGELOG.rst').read_text()


def test_topic_documentation_is_generated() -> None:
    from raw2drive_ros.contracts.topics import markdown_table

    assert markdown_table() in (ROOT / 'docs' / 'topics.md').read_text()
