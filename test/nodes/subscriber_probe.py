"""Subscribers that join a waiting bridge one after another; run by test_simulation_bridge.py as a process.

argv: as JSON, a list of steps, each a list of [node, topic] to subscribe to. Prints one JSON line: for each
step, whether the bridge drove (published /clock) within WATCH_S after every subscription was matched.
"""

import json
import sys
import time

import rclpy
from rclpy.executors import SingleThreadedExecutor

from raw2drive_ros.contracts import topics
from raw2drive_ros.nodes.quality import LossCounter, make_publisher, make_subscription
from raw2drive_ros.nodes.transport import configure_transport

# The bridge waits for another second after it has found all peers.
FIND_S, WATCH_S = 20.0, 2.5

configure_transport()
rclpy.init()
steps = json.loads(sys.argv[1])
nodes = {name: rclpy.create_node(name) for name in ('watch', 'safety_gate', 'planner', 'recorder')}
executor = SingleThreadedExecutor()
for node in nodes.values():
    executor.add_node(node)
clocks, subscriptions, losses = [], [], LossCounter()
make_subscription(nodes['watch'], topics.CLOCK, clocks.append, losses)
command = make_publisher(nodes['safety_gate'], topics.COMMAND)


def spin(seconds: float, until) -> bool:
    deadline = time.monotonic() + seconds
    while time.monotonic() < deadline and not until():
        executor.spin_once(timeout_sec=0.05)
    return until()


driven = []
for step in steps:
    for name, topic in step:
        subscriptions.append(make_subscription(nodes[name], topic, lambda message: None, losses))
    if not spin(FIND_S, lambda: all(s.get_publisher_count() for s in subscriptions)):
        raise TimeoutError([s.topic_name for s in subscriptions if not s.get_publisher_count()])
    driven.append(spin(WATCH_S, lambda: bool(clocks)))
print(json.dumps(driven))
for node in nodes.values():
    node.destroy_node()
rclpy.shutdown()
