"""Plays planner and vehicle to a gate; run by test_gate_restart.py as a process.

argv: seconds, then `activate` to call the gate's service first. Prints one JSON line: the answer to that call, and the
largest throttle that the gate let pass.
"""

import json
import sys
import time

import rclpy
from std_srvs.srv import Trigger

from msg_adapters.commands import decision_from_message, decision_to_message
from msg_adapters.factory import RclpyFactory
from msg_adapters.sensors import odometry_to_message
from raw2drive_ros.contracts import topics
from raw2drive_ros.contracts.public import Control, Decision, OdometrySample
from raw2drive_ros.driving.single_writer import Sender
from raw2drive_ros.nodes.keys import load_key
from raw2drive_ros.nodes.quality import LossCounter, make_publisher, make_subscription
from raw2drive_ros.nodes.transport import configure_transport

configure_transport()
rclpy.init()
node = rclpy.create_node('gate_probe')
factory, sender = RclpyFactory(), Sender(topics.PROPOSED, load_key(node.context.get_domain_id()))
proposals, odometry = make_publisher(node, topics.PROPOSED), make_publisher(node, topics.ODOMETRY)
throttles: list[float] = []
make_subscription(
    node, topics.COMMAND, lambda m: throttles.append(decision_from_message(m).control.throttle), LossCounter()
)
client = node.create_client(Trigger, '/safety_gate/activate')
answer = None


def publish() -> None:
    now_ns = node.get_clock().now().nanoseconds
    odometry.publish(odometry_to_message(factory, OdometrySample(now_ns, 0.0, 0.0, 0.0, 0.0, 0.0)))
    decision = Decision(now_ns, Control(0.4), sequence=sender.next())
    proposals.publish(sender.sign(decision_to_message(factory, decision)))


while not (proposals.get_subscription_count() and odometry.get_subscription_count() and throttles):
    rclpy.spin_once(node, timeout_sec=0.1)
if 'activate' in sys.argv[2:]:
    client.wait_for_service(20.0)
    publish()
    time.sleep(0.1)
    future = client.call_async(Trigger.Request())
    rclpy.spin_until_future_complete(node, future, timeout_sec=10.0)
    answer = future.result().success
throttles.clear()
deadline = time.monotonic() + float(sys.argv[1])
while time.monotonic() < deadline:
    publish()
    until = time.monotonic() + 0.08
    while time.monotonic() < until:
        rclpy.spin_once(node, timeout_sec=0.02)
print(json.dumps([answer, max(throttles, default=0.0)]))
node.destroy_node()
rclpy.shutdown()
