"""Publishers and subscriptions of the topic table: losses count at once, incompatible peers are reported."""

import subprocess
import sys
from pathlib import Path

from raw2drive_ros.graph.processes import reserve_domain
from raw2drive_ros.nodes.transport import child_environment

ROOT = Path(__file__).parents[2]
PROGRAM = """
import time
import rclpy
from rclpy.executors import SingleThreadedExecutor
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from nav_msgs.msg import Odometry
from raw2drive_ros.contracts import topics
from raw2drive_ros.nodes.quality import LossCounter, make_publisher, make_subscription, message_class
from raw2drive_ros.nodes.runtime import spin
from raw2drive_ros.nodes.transport import configure_transport

configure_transport()
rclpy.init()
node, losses = rclpy.create_node('quality'), LossCounter()
subscription = make_subscription(node, topics.ODOMETRY, lambda message: None, losses)
publisher, clock = make_publisher(node, topics.CLOCK), message_class(topics.BY_NAME[topics.CLOCK].msgtype)()
time.sleep(1.0 - time.monotonic() % 1.0 + 0.5)  # outside of the window
always = [h for h in subscription.event_handlers + publisher.event_handlers if h.callback_group.can_execute(h)]
print([handler.event_type.name for handler in always])
probe = rclpy.create_node('probe')
probe.create_publisher(Odometry, topics.ODOMETRY, QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT))
late = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
probe.create_subscription(type(clock), topics.CLOCK, lambda message: None, late)
executor, end = SingleThreadedExecutor(), time.monotonic() + 4.0
executor.add_node(node)
spin(node, executor, until=lambda: time.monotonic() > end)
"""


def test_losses_are_looked_for_at_every_message_and_peers_that_do_not_fit_are_named_within_seconds() -> None:
    with reserve_domain(None) as domain:
        child = subprocess.run(
            [sys.executable, '-c', PROGRAM],
            cwd=ROOT,
            env=child_environment(domain),
            capture_output=True,
            text=True,
            timeout=60,
        )
    assert child.returncode == 0, child.stderr[-2000:]
    assert child.stdout.strip() == "['RCL_SUBSCRIPTION_MESSAGE_LOST']"
    assert "New publisher discovered on topic '/vehicle/odometry', offering incompatible QoS" in child.stderr
    assert "New subscription discovered on topic '/clock', requesting incompatible QoS" in child.stderr
