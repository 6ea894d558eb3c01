"""Names are resolved before anything is counted or refused: namespaces and remapping apply to every topic."""

import json
import subprocess
import sys
from pathlib import Path

from raw2drive_ros.graph.processes import reserve_domain
from raw2drive_ros.nodes.transport import child_environment
from raw2drive_ros.settings import default_bundle

ROOT = Path(__file__).parents[2]
# A remapped node and a stranger on the remapped topic, in one process.
PROGRAM = """
import json, sys, time
import rclpy
from raw2drive_ros.contracts import topics
from raw2drive_ros.nodes import quality
from raw2drive_ros.nodes.diagnostics import DiagnosticsPublisher

rclpy.init(args=sys.argv)
node, losses = rclpy.create_node('probe'), quality.LossCounter()
names = {name: quality.make_publisher(node, name).topic_name for name in topics.BY_NAME}
heard = {name: quality.make_subscription(node, name, print, losses).topic_name for name in topics.BY_NAME}
stranger = rclpy.create_node('stranger', use_global_arguments=False)
command = quality.message_class(topics.BY_NAME[topics.COMMAND].msgtype)
publisher = stranger.create_publisher(command, names[topics.COMMAND], 1)
deadline = time.monotonic() + 10.0
while quality.publisher_count(node, topics.COMMAND) < 2 and time.monotonic() < deadline:
    rclpy.spin_once(node, timeout_sec=0.1)
counts = quality.publisher_count(node, topics.COMMAND), quality.subscriber_count(node, topics.COMMAND)
print(json.dumps([names, heard == names, counts, DiagnosticsPublisher(node, None).name]))
"""


def run_probe(*ros_arguments: str):
    with reserve_domain(None) as domain:
        child = subprocess.run(
            [sys.executable, '-c', PROGRAM, *ros_arguments],
            cwd=ROOT,
            env=child_environment(domain),
            capture_output=True,
            text=True,
            timeout=60,
        )
    assert child.returncode == 0, child.stderr[-2000:]
    return json.loads(child.stdout.splitlines()[-1])


def test_without_a_namespace_the_names_are_those_of_the_table() -> None:
    names, same_for_subscriptions, counts, diagnosed = run_probe()
    assert all(name == resolved for name, resolved in names.items())
    assert (same_for_subscriptions, counts, diagnosed) == (True, [2, 1], 'probe')


def test_a_namespace_moves_every_topic_but_the_shared_ones_and_counts_follow_remapping() -> None:
    arguments = ('--ros-args', '-r', '__ns:=/car1', '-r', 'control/command:=/wheels', '-r', '/clock:=/car1/clock')
    names, same_for_subscriptions, counts, diagnosed = run_probe(*arguments)
    moved = {'/control/command': '/wheels', '/diagnostics': '/diagnostics'}
    assert names == {name: moved.get(name, f'/car1{name}') for name in names}
    assert (same_for_subscriptions, counts, diagnosed) == (True, [2, 1], '/car1/probe')


def test_the_planner_refuses_a_privileged_topic_by_remapping_too() -> None:
    command = [sys.executable, '-m', 'raw2drive_ros.nodes.planner', '--ros-args', '-p', f'bundle:={default_bundle()}']
    command += ['-r', '/planning/route:=/car2/privileged/ego']
    with reserve_domain(None) as domain:
        planner = subprocess.run(
            command, cwd=ROOT, env=child_environment(domain), capture_output=True, text=True, timeout=120
        )
    assert planner.returncode == 1
    assert 'error: /car2/privileged/ego is privileged; the planner may not subscribe to it' in planner.stderr
