"""The command adapter between real processes: what a car with TwistStamped receives."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

from raw2drive_ros.graph.processes import reserve_domain, running_graph

PROBE = Path(__file__).with_name('adapter_probe.py')
ROOT = PROBE.parents[2]


def test_commands_silence_nan_and_lost_odometry(tmp_path) -> None:
    with reserve_domain(None) as domain, running_graph(tmp_path, domain) as graph:
        graph.start('command_adapter', {'output': 'twist', 'topic': '/car/cmd_vel'}, sim_time=False)
        probe = subprocess.run(
            [sys.executable, str(PROBE)], cwd=ROOT, env=graph.environment, capture_output=True, text=True, timeout=60
        )
        assert probe.returncode == 0, probe.stderr[-2000:]
        graph.check()
        log = (tmp_path / 'command_adapter.log').read_text()
    outputs = json.loads(probe.stdout.splitlines()[-1])
    assert all(len(messages) >= 5 for messages in outputs.values()), 'it keeps publishing in every phase'
    # 8 m/s, 0.5 s ahead: full throttle of 5 m/s2, or the brake's 0.6 of 8 m/s2.
    for phase, speed in {
        'before': 5.6,
        'left': 10.5,
        'silence': 5.6,
        'nan': 5.6,
        'still stopped': 5.6,
        'activated': 10.5,
        'a stranger': 5.6,
        'activated again': 10.5,
        'no odometry': 0,
    }.items():
        assert {round(message[0], 6) for message in outputs[phase]} == {speed}, phase
    assert all(yaw_rate > 0.5 for _, yaw_rate in outputs['left'])
    assert 'was refused: named values: not finite: throttle is nan' in log
    assert 'was refused: not signed; publishers: /adapter_probe; end the other publisher' in log
    for said in (
        'no command: braking',
        'stopped: braking',
        'the gate was activated',
        'passing commands on',
        'no odometry: asking for a standstill',
    ):
        assert said in log


@pytest.mark.parametrize(
    ('parameters', 'words'),
    [
        ({'output': 'ackermann'}, 'output ackermann needs the ROS package ackermann_msgs: install and source it'),
        ({'output': 'pigeon'}, "parameter output is 'pigeon'; use one of twist, ackermann, autoware, carla"),
        ({'horizon_s': 0.0}, 'parameter horizon_s is 0.0; use 0 to 5 s'),
    ],
)
def test_unusable_parameters_end_it_at_once_with_the_reason(tmp_path, parameters, words) -> None:
    with reserve_domain(None) as domain, running_graph(tmp_path, domain) as graph:
        graph.start('command_adapter', parameters, sim_time=False)
        assert graph.processes['command_adapter'].wait(30) == 1
        assert graph.last_words('command_adapter') == words
