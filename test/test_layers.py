"""Which room may import which: each rule in a process of its own, with the forbidden package blocked."""

import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
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
                )
            ],
            ['rclpy'],
        ),
        (['msg_adapters'], ['rclpy', 'torch', 'highway_env']),
        (['raw2drive_ros.simulation'], ['torch', 'rclpy', 'rosbags']),
        (['raw2drive_ros.carla_vehicle'], ['torch', 'rclpy', 'highway_env', 'carla']),
        (['raw2drive_ros.faults'], ['torch', 'rclpy', 'highway_env']),
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


def test_the_safety_gate_process_needs_no_torch() -> None:
    result = run_python(
        'import sys, raw2drive_ros.nodes.safety_gate\n'
        "raise SystemExit('torch' in sys.modules or 'highway_env' in sys.modules)"
    )
    assert result.returncode == 0, result.stderr[-600:]


@pytest.mark.parametrize(
    'module', ['raw2drive_ros.privileged_contract', 'msg_adapters.privileged', 'raw2drive_ros.simulation.world']
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


def test_help_does_not_import_torch() -> None:
    code = (
        'import sys; from raw2drive_ros.cli.main import main\n'
        "try: main(['--help'])\nexcept SystemExit: pass\nraise SystemExit('torch' in sys.modules)"
    )
    assert run_python(code).returncode == 0


def test_versions_agree() -> None:
    from raw2drive_ros import __version__

    assert f"version='{__version__}'" in (ROOT / 'setup.py').read_text()
    assert f'<version>{__version__}</version>' in (ROOT / 'package.xml').read_text()
    assert f'{__version__} (' in (ROOT / 'CHANGELOG.rst').read_text()


def test_topic_documentation_is_generated() -> None:
    from raw2drive_ros.topics import markdown_table

    assert markdown_table() in (ROOT / 'docs' / 'topics.md').read_text()
