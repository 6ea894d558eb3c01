"""Launch files need `launch_ros`, which is not on PyPI: here they run against recording stand-ins."""

import re
import runpy
import sys
import types
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]


@pytest.fixture
def nodes(monkeypatch):
    """Stand-ins for launch and launch_ros that keep every Node's arguments."""
    made: list[dict] = []

    class Anything:
        def __init__(self, *args, **kwargs) -> None:
            self.args = args

    class Node(Anything):
        def __init__(self, **kwargs) -> None:
            super().__init__()
            made.append(kwargs)

    class Opaque(Anything):
        def __init__(self, function) -> None:
            super().__init__()
            function(None)

    class Value(Anything):
        """A launch argument; evaluated, it gives the default of faults.launch.py."""

        def perform(self, context: object) -> str:
            return {'plans': 'matrix', 'plan': 'camera frozen'}[self.args[0]]

    def module(name: str, **content) -> None:
        created = types.ModuleType(name)
        created.__dict__.update(content)
        monkeypatch.setitem(sys.modules, name, created)

    module('launch', LaunchDescription=Anything)
    module('launch.actions', DeclareLaunchArgument=Anything, SetEnvironmentVariable=Anything, OpaqueFunction=Opaque)
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


def test_every_executable_that_lands_on_the_path_has_our_name() -> None:
    """pip puts them beside everybody else's programs: a `bridge` or a `player` of ours would hide theirs."""
    lines = re.findall(r"^\s+'(\S+) = raw2drive_ros\.(\S+):main',$", (ROOT / 'setup.py').read_text(), re.MULTILINE)
    assert len(lines) >= 10
    for executable, module in lines:
        assert executable == 'raw2drive' or executable == f'raw2drive_{module.removeprefix("nodes.")}'
