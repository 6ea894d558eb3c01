"""Launch files need `launch_ros`, which is not on PyPI: here they run against recording stand-ins."""

import argparse
import re
import runpy
import sys
import types
from pathlib import Path

import pytest

from raw2drive_ros.cli import drive

ROOT = Path(__file__).resolve().parents[1]


@pytest.fixture
def nodes(monkeypatch):
    """Stand-ins for launch and launch_ros that keep every Node's arguments."""
    return stand_ins(monkeypatch, {})


def stand_ins(monkeypatch, given: dict[str, str]) -> list[dict]:
    """given: arguments of the launch; others have their defaults. `given` then holds all that were declared."""
    made: list[dict] = []

    class Anything:
        def __init__(self, *args, **kwargs) -> None:
            self.args = args

    class Argument(Anything):
        def __init__(self, name, default_value, description, choices=None) -> None:
            super().__init__()
            given.setdefault(name, default_value)
            assert description
            assert choices is None or given[name] in choices

    class Node(Anything):
        def __init__(self, **kwargs) -> None:
            super().__init__()
            made.append(kwargs)

    class Opaque(Anything):
        def __init__(self, function) -> None:
            super().__init__()
            function(None)

    class Value(Anything):
        """A launch argument; evaluated, it gives its value."""

        def perform(self, context: object) -> str:
            return given[self.args[0]]

    def module(name: str, **content) -> None:
        created = types.ModuleType(name)
        created.__dict__.update(content)
        monkeypatch.setitem(sys.modules, name, created)

    module('launch', LaunchDescription=Anything)
    module('launch.actions', DeclareLaunchArgument=Argument, SetEnvironmentVariable=Anything, OpaqueFunction=Opaque)
    module('launch.conditions', IfCondition=Anything)
    module('launch.substitutions', LaunchConfiguration=Value)
    module('launch_ros', actions=None)
    module('launch_ros.actions', Node=Node)
    module('ament_index_python.packages', get_package_share_directory=lambda name: str(ROOT))
    return made


@pytest.mark.parametrize('file', sorted((ROOT / 'launch').glob('*.launch.py')), ids=lambda p: p.name)
def test_launch_file_starts_executables_and_parameters_that_exist(file, nodes) -> None:
    runpy.run_path(str(file))['generate_launch_description']()
    assert {node['executable'] for node in nodes} >= {'raw2drive_planner', 'raw2drive_safety_gate'}
    setup = (ROOT / 'setup.py').read_text()
    for node in nodes:
        module = node['executable'].removeprefix('raw2drive_')
        assert f"'{node['executable']} = raw2drive_ros.nodes.{module}:main'" in setup
        source = (ROOT / 'raw2drive_ros' / 'nodes' / f'{module}.py').read_text()
        for parameters in node.get('parameters', []):
            for name in parameters:
                assert name == 'use_sim_time' or f"'{name}': (" in source, name


def options_of_drive() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser()
    drive.add_arguments(parser)
    return parser


def test_the_driver_takes_every_option_of_the_verb_and_no_other(monkeypatch) -> None:
    declared: dict[str, str] = {}
    stand_ins(monkeypatch, declared)
    runpy.run_path(str(ROOT / 'launch' / 'driver.launch.py'))['generate_launch_description']()
    assert set(declared) == set(vars(options_of_drive().parse_args([])))


@pytest.mark.parametrize(
    ('given', 'arguments'),
    [
        ({}, []),
        ({'lock_step': 'true'}, ['--lock-step']),
        ({'sim_time': 'true', 'image_transport': 'compressed'}, ['--sim-time', '--image-transport', 'compressed']),
        (
            {'sensor_reliability': 'best_effort', 'interpolate_age': '0.05', 'camera_skew': '0.02'},
            ['--sensor-reliability', 'best_effort', '--interpolate-age', '0.05', '--camera-skew', '0.02'],
        ),
        (
            {'gate': 'params/gate.yaml', 'monitor': 'params/monitor.yaml', 'domain': '7'},
            ['--gate', 'params/gate.yaml', '--monitor', 'params/monitor.yaml', '--domain', '7'],
        ),
    ],
)
def test_launch_file_and_verb_start_the_same_nodes(monkeypatch, given, arguments) -> None:
    monkeypatch.chdir(ROOT)
    verb: list[dict] = []

    def start(nodes, domain, *, sim_time, **rest) -> int:
        verb.extend(
            {'executable': f'raw2drive_{name}', 'parameters': [parameters | {'use_sim_time': sim_time}]}
            for name, parameters in nodes.items()
        )
        return 0

    monkeypatch.setattr('raw2drive_ros.graph.foreground.run_single', start)
    assert drive.run(options_of_drive().parse_args(arguments)) == 0
    made = stand_ins(monkeypatch, given)
    runpy.run_path(str(ROOT / 'launch' / 'driver.launch.py'))['generate_launch_description']()
    assert [{name: node[name] for name in ('executable', 'parameters')} for node in made] == verb


def test_the_nodes_of_a_namespace_have_a_clock_of_their_own(monkeypatch) -> None:
    made = stand_ins(monkeypatch, {'namespace': 'car1'})
    runpy.run_path(str(ROOT / 'launch' / 'driver.launch.py'))['generate_launch_description']()
    own = [('/clock', '/car1/clock'), ('/diagnostics', '/car1/diagnostics')]
    assert [(node['namespace'], node['remappings']) for node in made] == [('/car1', own)] * 2


def test_every_executable_that_lands_on_the_path_has_our_name() -> None:
    """pip puts them beside everybody else's programs: a `bridge` or a `player` of ours would hide theirs."""
    lines = re.findall(r"^\s+'(\S+) = raw2drive_ros\.(\S+):main',$", (ROOT / 'setup.py').read_text(), re.MULTILINE)
    assert len(lines) >= 10
    for executable, module in lines:
        assert executable == 'raw2drive' or executable == f'raw2drive_{module.removeprefix("nodes.")}'
