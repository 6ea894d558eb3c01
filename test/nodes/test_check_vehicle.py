"""check-vehicle against our own bridge: every check passes, and it moves the car only if allowed."""

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import cv2
import pytest

from raw2drive_ros.graph.processes import reserve_domain, running_graph

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT / 'test' / 'conformance'))

from planted_faults import FAULTS  # noqa: E402 (of another folder of tests)

BRIDGE = {'lock_step': False, 'wait_for_sensor_subscribers': 0, 'seed': 1}


def check(folder: Path, domain: int, *arguments: str) -> tuple[int, list[dict]]:
    command = [sys.executable, '-m', 'raw2drive_ros.cli.main', 'check-vehicle', '--json']
    command += ['--domain', str(domain), '--seconds', '3', '--mosaic', str(folder / 'new' / 'cameras.png'), *arguments]
    result = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=180, env=os.environ)
    assert result.stdout, result.stderr
    return result.returncode, json.loads(result.stdout)


def start_bridge(graph, domain: int) -> list[str]:
    graph.start('bridge', BRIDGE, sim_time=False)
    return ['--sim-time']


def start_toy(graph, domain: int) -> list[str]:
    return start_script(graph, ROOT / 'examples' / 'vehicle_interface' / 'toy_vehicle.py')


def start_script(graph, *command: Path | str) -> list[str]:
    arguments = [sys.executable, *map(str, command)]
    graph.processes['toy'] = subprocess.Popen(arguments, cwd=ROOT, env=graph.environment | {'PYTHONPATH': str(ROOT)})
    return []


# The car is moved in the long tests only: the programme takes half a minute.
@pytest.mark.parametrize('motion', [False, pytest.param(True, marks=pytest.mark.long)])
@pytest.mark.parametrize('start', [start_bridge, start_toy])
def test_our_bridge_and_the_example_keep_the_contract(tmp_path, start, motion) -> None:
    with reserve_domain(None) as domain, running_graph(tmp_path, domain) as graph:
        arguments = start(graph, domain)
        time.sleep(4.0)
        code, verdicts = check(tmp_path, domain, *arguments, *(['--allow-motion'] if motion else []))
    wrong = [v for v in verdicts if v['severity'] in ('error', 'warning')]
    assert (code, wrong) == (0, [])
    assert len(verdicts) > 60
    moved = [v['check'] for v in verdicts if v['check'] in ('steer left', 'silence stops', 'NaN is refused')]
    assert bool(moved) is motion
    judged = [v for v in verdicts if v['check'].endswith(': motion of the picture') and v['severity'] == 'passed']
    assert len(judged) == (6 if motion else 0)
    if not motion:
        assert [v['check'] for v in verdicts if v['severity'] == 'skipped'][-1] == 'motion'
    assert cv2.imread(str(tmp_path / 'new' / 'cameras.png')).shape == (762, 1472, 3)
    # Time is the vehicle's, told or not: the bridge publishes /clock.
    assert any(v['check'] == 'clock: source' for v in verdicts) is (start is start_bridge)


def test_simulated_time_is_used_without_being_told_and_missed_when_it_is_not_there(tmp_path) -> None:
    with reserve_domain(None) as domain, running_graph(tmp_path, domain) as graph:
        start_bridge(graph, domain)
        time.sleep(4.0)
        code, verdicts = check(tmp_path, domain)
    assert (code, [v for v in verdicts if v['severity'] in ('error', 'warning')]) == (0, [])
    with reserve_domain(None) as domain, running_graph(tmp_path, domain) as graph:
        start_toy(graph, domain)
        time.sleep(4.0)
        code, verdicts = check(tmp_path, domain, '--sim-time')
    assert (code, [v['check'] for v in verdicts if v['severity'] in ('error', 'warning')]) == (1, ['clock: source'])


# Two of the faults of test/conformance/planted_faults.py in a real graph, where messages are rclpy's and time passes.
@pytest.mark.long
@pytest.mark.parametrize('name', ['left and right exchanged', '300 ms of actuator delay'])
def test_a_planted_fault_is_named_in_a_graph(tmp_path, name) -> None:
    fault = next(fault for fault in FAULTS if fault.name == name)
    with reserve_domain(None) as domain, running_graph(tmp_path, domain) as graph:
        start_script(graph, ROOT / 'test' / 'conformance' / 'planted_node.py', name)
        time.sleep(4.0)
        code, verdicts = check(tmp_path, domain, '--allow-motion')
    wrong = [v for v in verdicts if v['severity'] in ('error', 'warning')]
    assert (code, [v['check'] for v in wrong]) == (1, [fault.check]), wrong
    assert fault.words in f'{wrong[0]["text"]} {wrong[0]["remedy"]}'


def test_an_empty_graph_fails_and_is_not_moved(tmp_path) -> None:
    with reserve_domain(None) as domain:
        code, verdicts = check(tmp_path, domain, '--allow-motion')
    assert code == 1
    errors = [v for v in verdicts if v['severity'] == 'error']
    assert any(v['text'].startswith('nobody publishes it') for v in errors)
    assert all(v['remedy'] for v in errors)
    assert [v['severity'] for v in verdicts if v['check'] == 'motion'] == ['skipped']
    assert [v['severity'] for v in verdicts if v['check'] == 'cameras: mosaic'] == ['skipped']


# Prints the speed of the car, from when it has first been above 1 m/s.
WATCH = """
import time
import rclpy
from msg_adapters.sensors import odometry_from_message
from raw2drive_ros.contracts import topics
from raw2drive_ros.nodes.quality import LossCounter, make_subscription
from raw2drive_ros.nodes.transport import configure_transport
configure_transport()
rclpy.init()
node, fast = rclpy.create_node('watch'), False
def look(message):
    global fast
    speed = odometry_from_message(message).speed_mps
    fast = fast or speed > 1.0
    if fast:
        print(round(time.monotonic(), 3), round(speed, 3), flush=True)
make_subscription(node, topics.ODOMETRY, look, LossCounter())
rclpy.spin(node)
"""


@pytest.mark.long
def test_ctrl_c_leaves_a_car_that_stands(tmp_path) -> None:
    with reserve_domain(None) as domain, running_graph(tmp_path, domain) as graph:
        start_toy(graph, domain)
        command = [sys.executable, '-c', WATCH]
        watch = subprocess.Popen(command, cwd=ROOT, env=graph.environment, stdout=subprocess.PIPE, text=True)
        graph.processes['watch'] = watch
        command = [sys.executable, '-m', 'raw2drive_ros.cli.main', 'check-vehicle', '--domain', str(domain)]
        command += ['--mosaic', str(tmp_path / 'cameras.png')]
        probe = subprocess.Popen([*command, '--seconds', '2', '--allow-motion'], cwd=ROOT)
        watch.stdout.readline()
        probe.send_signal(signal.SIGINT)
        assert probe.wait(30.0) == 130
        ended = time.monotonic()
        watch.terminate()
        seen = [tuple(map(float, line.split())) for line in watch.stdout if len(line.split()) == 2]
    # It stood while the probe was still braking, not only 0.3 s after the last command.
    assert min(t for t, speed in seen if speed < 0.1) < ended
