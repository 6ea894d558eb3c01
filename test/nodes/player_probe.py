"""Controls a player through its services and prints the /clock stamps meanwhile; run by test_player.py."""

import json
import time

import rclpy
from rcl_interfaces.msg import Parameter, ParameterType, ParameterValue
from rcl_interfaces.srv import SetParameters
from rosgraph_msgs.msg import Clock
from std_srvs.srv import SetBool, Trigger

from raw2drive_ros.contracts import topics
from raw2drive_ros.nodes.quality import profile_of
from raw2drive_ros.nodes.transport import configure_transport

configure_transport()
rclpy.init()
node = rclpy.create_node('probe')
stamps: list[int] = []
node.create_subscription(
    Clock,
    topics.CLOCK,
    lambda m: stamps.append(m.clock.sec * 1_000_000_000 + m.clock.nanosec),
    profile_of(topics.BY_NAME[topics.CLOCK], 1000),
)


def listen(seconds: float) -> list[int]:
    """Listen for `seconds`; the stamps since the last call."""
    deadline = time.monotonic() + seconds
    while time.monotonic() < deadline:
        rclpy.spin_once(node, timeout_sec=0.05)
    heard = list(stamps)
    stamps.clear()
    return heard


def call(kind, name, request):
    client = node.create_client(kind, name)
    assert client.wait_for_service(timeout_sec=30.0), name
    future = client.call_async(request)
    rclpy.spin_until_future_complete(node, future, timeout_sec=10.0)
    return future.result()


def set_double(name: str, value: float) -> bool:
    double = ParameterValue(type=ParameterType.PARAMETER_DOUBLE, double_value=value)
    request = SetParameters.Request(parameters=[Parameter(name=name, value=double)])
    return call(SetParameters, '/player/set_parameters', request).results[0].successful


call(SetBool, '/player/pause', SetBool.Request(data=True))
listen(0.5)
observed = {'step while paused': call(Trigger, '/player/step', Trigger.Request()).success}
observed['one step'] = listen(1.0)
observed['nothing'] = listen(0.5)
observed['wrong rate'] = set_double('rate', -1.0)
observed['rate'] = set_double('rate', 2.0)
call(SetBool, '/player/pause', SetBool.Request(data=False))
observed['playing'] = listen(1.0)
call(SetBool, '/player/pause', SetBool.Request(data=True))
listen(0.3)
observed['paused'] = listen(0.5)
observed['step while playing'] = None
observed['start'] = set_double('start_s', 0.5)
call(Trigger, '/player/seek', Trigger.Request())
observed['after seek'] = listen(0.5)
call(SetBool, '/player/pause', SetBool.Request(data=False))
observed['step while playing'] = call(Trigger, '/player/step', Trigger.Request()).success
observed['again'] = listen(6.0)
print(json.dumps(observed))
node.destroy_node()
rclpy.shutdown()
