"""Nodes survive invalid transitions, parameters and messages, and give the reason of a refusal."""

import json
import subprocess
import sys
from pathlib import Path

from raw2drive_ros.graph.processes import reserve_domain, running_graph
from raw2drive_ros.nodes.transport import child_environment

PROBE = Path(__file__).with_name('planner_probe.py')
ROOT = PROBE.parents[2]


def test_wrong_requests_parameters_and_messages_end_no_node(bundle, tmp_path) -> None:
    with reserve_domain(None) as domain, running_graph(tmp_path, domain) as graph:
        graph.start('safety_gate', {'clock': 'steady'}, sim_time=False)
        graph.start('planner', {'bundle': str(bundle)}, sim_time=False)
        probe = subprocess.run(
            [sys.executable, str(PROBE)], cwd=ROOT, env=graph.environment, capture_output=True, text=True, timeout=120
        )
        assert probe.returncode == 0, probe.stderr[-2000:]
        answers = json.loads(probe.stdout.splitlines()[-1])
        graph.check()
        logs = {name: (tmp_path / f'{name}.log').read_text() for name in ('planner', 'safety_gate')}
    assert answers['before'] == answers['after'] == 'active'
    assert not any(answers[wrong] for wrong in ('activate again', 'configure again', 'no transition'))
    assert answers['late parameter'] == [
        False,
        'bundle is read when the node starts; start it again with another value',
    ]
    assert answers['wrong type'][0] is False
    assert (answers['deactivate'], answers['end']) == (True, 'inactive')
    assert (answers['activated'], answers['listening']) == (True, 1)
    assert (answers['shutdown'], answers['still listening']) == (True, 0), 'a shut down planner proposes nothing'
    assert "front refused: image encoding 'noise' is not supported" in logs['planner']
    assert 'imu refused' in logs['planner']
    assert 'emergency_stop: invalid proposal: not signed' in logs['safety_gate']
    assert answers['gate'] is False, 'there are two publishers of proposals'


def test_a_planner_that_cannot_configure_stays_unconfigured_and_says_why(tmp_path) -> None:
    with reserve_domain(None) as domain, running_graph(tmp_path, domain) as graph:
        graph.start('planner', {'bundle': str(tmp_path / 'nowhere'), 'autostart': False}, sim_time=False)
        code = (
            'import rclpy, sys;'
            'from lifecycle_msgs.srv import ChangeState, GetState;'
            'from raw2drive_ros.nodes.transport import configure_transport;'
            'configure_transport(); rclpy.init(); node = rclpy.create_node("probe");'
            'client = node.create_client(ChangeState, "/planner/change_state"); client.wait_for_service(30);'
            'request = ChangeState.Request(); request.transition.id = 1;'
            'future = client.call_async(request); rclpy.spin_until_future_complete(node, future, timeout_sec=30);'
            'state = node.create_client(GetState, "/planner/get_state"); state.wait_for_service(30);'
            'label = state.call_async(GetState.Request());'
            'rclpy.spin_until_future_complete(node, label, timeout_sec=30);'
            'print(future.result().success, label.result().current_state.label)'
        )
        probe = subprocess.run(
            [sys.executable, '-c', code], cwd=ROOT, env=graph.environment, capture_output=True, text=True, timeout=120
        )
        graph.check()
        log = (tmp_path / 'planner.log').read_text()
    assert probe.stdout.split() == ['False', 'unconfigured'], probe.stderr[-2000:]
    assert 'no policy bundle there' in log


def test_a_mistyped_parameter_is_an_error_and_not_a_default(tmp_path) -> None:
    command = [sys.executable, '-m', 'raw2drive_ros.nodes.safety_gate', '--ros-args', '-p', 'confg:=my_car.yaml']
    with reserve_domain(None) as domain:
        gate = subprocess.run(
            command, cwd=ROOT, env=child_environment(domain, tmp_path), capture_output=True, text=True, timeout=60
        )
    assert gate.returncode == 1
    assert gate.stderr.startswith('error: no such parameter: confg; safety_gate knows clock, simulated, config, ')
    assert len(gate.stderr.splitlines()) == 1
