"""A probe that sends invalid requests and messages to a planner and a gate; run by test_probes.py as a process.

Prints one JSON line: the answer to each invalid request, and whether both nodes still work afterwards.
"""

import json
import sys
import time

import rclpy
from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState, GetState
from rcl_interfaces.msg import Parameter, ParameterType, ParameterValue
from rcl_interfaces.srv import SetParameters
from sensor_msgs.msg import Image, Imu, JointState
from std_srvs.srv import Trigger

from raw2drive_ros.contracts import topics
from raw2drive_ros.nodes.transport import configure_transport

configure_transport()
rclpy.init()
node = rclpy.create_node('probe')


def call(kind, name, request):
    client = node.create_client(kind, name)
    if not client.wait_for_service(timeout_sec=30.0):
        raise TimeoutError(name)
    future = client.call_async(request)
    rclpy.spin_until_future_complete(node, future, timeout_sec=10.0)
    node.destroy_client(client)
    return future.result()


def change(transition: int):
    request = ChangeState.Request()
    request.transition.id = transition
    answer = call(ChangeState, '/planner/change_state', request)
    return None if answer is None else answer.success


def set_parameter(owner: str, name: str, text: str):
    value = ParameterValue(type=ParameterType.PARAMETER_STRING, string_value=text)
    request = SetParameters.Request(parameters=[Parameter(name=name, value=value)])
    (result,) = call(SetParameters, f'/{owner}/set_parameters', request).results
    return [result.successful, result.reason]


def state() -> str:
    return call(GetState, '/planner/get_state', GetState.Request()).current_state.label


answers = {'before': state()}
answers['activate again'] = change(Transition.TRANSITION_ACTIVATE)
answers['configure again'] = change(Transition.TRANSITION_CONFIGURE)
answers['no transition'] = change(99)
answers['late parameter'] = set_parameter('planner', 'bundle', '/tmp')
answers['wrong type'] = set_parameter('planner', 'threads', 'many')

publishers = {
    Image: node.create_publisher(Image, topics.image_topic('front'), 1),
    Imu: node.create_publisher(Imu, topics.IMU, 1),
    JointState: node.create_publisher(JointState, topics.PROPOSED, 1),
}
deadline = time.monotonic() + 3.0
while time.monotonic() < deadline:
    bad = Image(height=3, width=5, encoding='noise', step=7)
    publishers[Image].publish(bad)
    imu = Imu()
    imu.linear_acceleration.x = float('nan')
    publishers[Imu].publish(imu)
    publishers[JointState].publish(JointState(name=['steer', 'steer'], position=[1.0]))
    rclpy.spin_once(node, timeout_sec=0.1)

answers['after'] = state()
answers['gate'] = call(Trigger, '/safety_gate/activate', Trigger.Request()).success
answers['deactivate'] = change(Transition.TRANSITION_DEACTIVATE)
answers['end'] = state()
answers['activated'] = change(Transition.TRANSITION_ACTIVATE)
answers['listening'] = node.count_subscribers(topics.IMU)
answers['shutdown'] = change(Transition.TRANSITION_ACTIVE_SHUTDOWN)
time.sleep(1.0)
answers['still listening'] = node.count_subscribers(topics.IMU)
print(json.dumps(answers))
node.destroy_node()
rclpy.shutdown()
sys.exit(0)
