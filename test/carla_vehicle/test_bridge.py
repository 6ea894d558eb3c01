"""The CARLA bridge in a graph with the real planner and gate; only the server is a stand-in."""

import json
import subprocess
import sys
import time
from pathlib import Path

import pytest

from raw2drive_ros.graph.processes import reserve_domain, running_graph
from raw2drive_ros.settings import default_bundle

pytest.importorskip('carla', reason='extra carla')
BRIDGE = [sys.executable, str(Path(__file__).with_name('stand_in_bridge.py')), '--ros-args', '-p']
ROOT = Path(__file__).resolve().parents[2]


def test_planner_and_gate_drive_it_in_lock_step(tmp_path) -> None:
    with reserve_domain(None) as domain, running_graph(tmp_path, domain) as graph:
        graph.start('safety_gate', {'clock': 'ros'}, sim_time=True)
        graph.start('planner', {'bundle': str(default_bundle())}, sim_time=True)
        bridge = subprocess.run(
            [*BRIDGE, 'max_ticks:=20'], env=graph.environment, capture_output=True, text=True, timeout=120
        )
        graph.check()
    assert bridge.returncode == 0, bridge.stderr[-2000:]
    assert 'client 0.9.16 and server 0.9.15 differ' in bridge.stderr
    assert 'no command for' not in bridge.stderr
    first, *driven = json.loads(bridge.stdout.splitlines()[-1])
    assert first == [0.0, 1.0, 0.0]
    assert len(driven) == 20
    # The policy cannot tell that the images are noise, and accelerates.
    assert max(throttle for throttle, _, _ in driven) > 0.2


def test_it_keeps_the_contract_of_a_vehicle(tmp_path) -> None:
    with reserve_domain(None) as domain, running_graph(tmp_path, domain) as graph:
        graph.processes['carla'] = subprocess.Popen([*BRIDGE, 'lock_step:=false'], env=graph.environment)
        time.sleep(4.0)
        command = [sys.executable, '-m', 'raw2drive_ros.cli.main', 'check-vehicle', '--json', '--sim-time']
        command += ['--domain', str(domain), '--seconds', '3']
        result = subprocess.run(command, cwd=ROOT, env=graph.environment, capture_output=True, text=True, timeout=120)
    verdicts = json.loads(result.stdout)
    wrong = [v for v in verdicts if v['severity'] in ('error', 'warning')]
    assert wrong == []
    assert len(verdicts) > 60
