"""The recorder as a process: the ring buffer is saved when the gate stops the car and on request."""

import subprocess
import sys
from pathlib import Path

from raw2drive_ros.contracts import topics
from raw2drive_ros.graph.processes import reserve_domain, running_graph
from raw2drive_ros.recording.bag_info import bag_info

ROOT = Path(__file__).resolve().parents[2]
# Three seconds of odometry and of invalid proposals, then ~/save.
PROBE = """
import time
import rclpy
from std_srvs.srv import Trigger
from msg_adapters.commands import decision_to_message
from msg_adapters.factory import RclpyFactory
from msg_adapters.sensors import odometry_to_message
from raw2drive_ros.contracts import topics
from raw2drive_ros.contracts.public import Control, Decision, OdometrySample
from raw2drive_ros.nodes.quality import make_publisher
from raw2drive_ros.nodes.transport import configure_transport
configure_transport()
rclpy.init()
node, factory = rclpy.create_node('probe'), RclpyFactory()
outputs = {name: make_publisher(node, name) for name in (topics.ODOMETRY, topics.PROPOSED)}
client = node.create_client(Trigger, '/recorder/save')
assert client.wait_for_service(30.0)
# The gate may hear a proposal, and stop, before the recorder has discovered the topic.
deadline = time.monotonic() + 30.0
while min(output.get_subscription_count() for output in outputs.values()) < 2:
    assert time.monotonic() < deadline, 'gate and recorder have not discovered the probe'
    rclpy.spin_once(node, timeout_sec=0.05)
deadline = time.monotonic() + 3.0
while time.monotonic() < deadline:
    now_ns = node.get_clock().now().nanoseconds
    outputs[topics.ODOMETRY].publish(odometry_to_message(factory, OdometrySample(now_ns, 0, 0, 0, 0, 0)))
    outputs[topics.PROPOSED].publish(decision_to_message(factory, Decision(now_ns, Control(float('nan')))))
    rclpy.spin_once(node, timeout_sec=0.05)
future = client.call_async(Trigger.Request())
rclpy.spin_until_future_complete(node, future, timeout_sec=10)
print(future.result().success, future.result().message)
"""


def test_snapshots_are_written_on_a_stop_of_the_gate_and_on_request(tmp_path) -> None:
    with reserve_domain(None) as domain, running_graph(tmp_path, domain) as graph:
        graph.start('recorder', {'bag': str(tmp_path / 'shots'), 'snapshot_s': 2.0}, sim_time=False)
        graph.start('safety_gate', {'clock': 'steady'}, sim_time=False)
        probe = subprocess.run(
            [sys.executable, '-c', PROBE], cwd=ROOT, env=graph.environment, capture_output=True, text=True, timeout=90
        )
        assert probe.returncode == 0, probe.stderr[-2000:]
        graph.check()
    assert probe.stdout.split() == ['True', str(tmp_path / 'shots' / 'snapshot_001')]
    first, second = (bag_info(tmp_path / 'shots' / f'snapshot_{number:03d}') for number in range(2))
    assert first['provenance']['snapshot'].startswith('gate: emergency_stop: invalid proposal')
    assert second['provenance']['snapshot'] == '~/save'
    assert second['duration_s'] <= 2.1
    for info in (first, second):
        assert {topics.ODOMETRY, topics.PROPOSED, topics.COMMAND} <= {row['topic'] for row in info['topics']}
