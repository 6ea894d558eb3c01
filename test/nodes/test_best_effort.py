"""Sensors that offer best effort only: heard where the planner asks for no more."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

from raw2drive_ros.contracts import topics
from raw2drive_ros.graph.processes import reserve_domain, running_graph

ROOT = Path(__file__).resolve().parents[2]
PROBE = """
import json, time
import rclpy
from rclpy.qos import QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import Imu
from raw2drive_ros.contracts import topics
from raw2drive_ros.nodes.transport import configure_transport
configure_transport()
rclpy.init()
node = rclpy.create_node('sensor')
output = node.create_publisher(Imu, topics.IMU, QoSProfile(depth=5, reliability=ReliabilityPolicy.BEST_EFFORT))
names = (topics.IMU, topics.ODOMETRY, topics.ROUTE, topics.image_topic('front'), topics.extrinsics_topic('front'))
deadline, seen = time.monotonic() + 60.0, {}
while time.monotonic() < deadline and len(seen) < len(names):
    seen = {n: i[0].qos_profile.reliability.name for n in names if (i := node.get_subscriptions_info_by_topic(n))}
    time.sleep(0.1)
bad = Imu()
bad.linear_acceleration.x = float('nan')
for _ in range(30):
    output.publish(bad)
    time.sleep(0.1)
print(json.dumps(seen))
"""


@pytest.mark.parametrize('reliability', ['reliable', 'best_effort'])
def test_best_effort_sensors_are_heard_by_parameter(bundle, tmp_path, reliability) -> None:
    with reserve_domain(None) as domain, running_graph(tmp_path, domain) as graph:
        graph.start('planner', {'bundle': str(bundle), 'sensor_reliability': reliability}, sim_time=False)
        probe = subprocess.run(
            [sys.executable, '-c', PROBE], cwd=ROOT, env=graph.environment, capture_output=True, text=True, timeout=120
        )
        graph.check()
        log = (tmp_path / 'planner.log').read_text()
    assert probe.returncode == 0, probe.stderr[-2000:]
    seen = json.loads(probe.stdout.splitlines()[-1])
    sensors = (topics.IMU, topics.ODOMETRY, topics.image_topic('front'))
    assert {seen[name] for name in sensors} == {reliability.upper()}
    # What is latched is kept for late subscribers, which needs reliable ones.
    assert {seen[name] for name in (topics.ROUTE, topics.extrinsics_topic('front'))} == {'RELIABLE'}
    assert ('imu refused' in log) == (reliability == 'best_effort')
