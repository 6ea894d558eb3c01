"""Sends a command adapter commands, silence, NaN, unsigned ones; prints its output; run by test_command_adapter.py."""

import json
import math
import time

import rclpy
from geometry_msgs.msg import TwistStamped

from msg_adapters.commands import ACTIVATION, decision_to_message
from msg_adapters.factory import RclpyFactory
from msg_adapters.sensors import odometry_to_message
from raw2drive_ros.contracts import topics
from raw2drive_ros.contracts.public import Control, Decision, OdometrySample
from raw2drive_ros.driving.single_writer import Sender
from raw2drive_ros.nodes.keys import load_key
from raw2drive_ros.nodes.quality import make_publisher
from raw2drive_ros.nodes.transport import configure_transport

configure_transport()
rclpy.init()
node = rclpy.create_node('adapter_probe')
factory = RclpyFactory()
commands, odometry = make_publisher(node, topics.COMMAND), make_publisher(node, topics.ODOMETRY)
heard: list[tuple[float, float]] = []
node.create_subscription(
    TwistStamped, '/car/cmd_vel', lambda m: heard.append((m.twist.linear.x, m.twist.angular.z)), 10
)
gate = Sender(topics.COMMAND, load_key(node.context.get_domain_id()))
sample = OdometrySample(1, 0.0, 0.0, 0.0, 8.0, 0.0)


def phase(
    seconds: float, control: Control | None, *, moving: bool = True, activation: float = 0.0, sender: Sender = gate
) -> list[tuple[float, float]]:
    """(speed, yaw rate) of the output in the second half of a phase."""
    begin = time.monotonic()
    while (spent := time.monotonic() - begin) < seconds:
        if spent < seconds / 2:
            heard.clear()
        if moving:
            odometry.publish(odometry_to_message(factory, sample))
        if control is not None:
            decision = Decision(1, control, sequence=sender.next())
            commands.publish(sender.sign(decision_to_message(factory, decision, {ACTIVATION: activation})))
        rclpy.spin_once(node, timeout_sec=0.05)
    return list(heard)


while not (commands.get_subscription_count() and odometry.get_subscription_count() and heard):
    rclpy.spin_once(node, timeout_sec=0.1)
outputs = {
    'before': phase(1.0, None),
    'left': phase(1.0, Control(1.0, 0.0, 0.5)),
    'silence': phase(1.6, None),
    'nan': phase(1.6, Control(math.nan, 0.0, 0.0)),
    'still stopped': phase(1.0, Control(1.0, 0.0, 0.5)),
    'activated': phase(1.0, Control(1.0, 0.0, 0.5), activation=1.0),
    'a stranger': phase(1.0, Control(1.0, 0.0, 0.5), activation=2.0, sender=Sender(topics.COMMAND)),
    'activated again': phase(1.0, Control(1.0, 0.0, 0.5), activation=2.0),
    'no odometry': phase(2.0, Control(1.0, 0.0, 0.5), moving=False, activation=2.0),
}
print(json.dumps(outputs))
node.destroy_node()
rclpy.shutdown()
