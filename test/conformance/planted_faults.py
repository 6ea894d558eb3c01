"""The table of planted faults: what a stranger gets wrong, and what check-vehicle must call it.

python test/conformance/planted_faults.py prints for each fault what was found, and how many were named rightly.
"""

import math
from dataclasses import replace
from typing import Any

import numpy as np
from planted_vehicle import HEALTHY, Fault, check

from raw2drive_ros.conformance.observation import Verdict
from raw2drive_ros.conformance.views import other_lens
from raw2drive_ros.contracts import topics

DEGREES = 180.0 / math.pi
EXCHANGED = {'front_left': 'front_right', 'front_right': 'front_left'}
# Focal length of a lens of 90 degrees by that of one of 70.
WIDE = math.tan(math.radians(35.0)) / math.tan(math.radians(45.0))


def imu(change):
    """Change IMU messages only."""

    def message(topic: str, message: Any) -> None:
        if topic == topics.IMU:
            change(message)

    return message


def odometry(change):
    def message(topic: str, message: Any) -> None:
        if topic == topics.ODOMETRY:
            change(message.pose.pose, message.twist.twist)

    return message


def info(camera: str, change):
    def message(topic: str, message: Any) -> None:
        if topic == topics.camera_info_topic(camera):
            change(message)

    return message


def without_gravity(message: Any) -> None:
    message.linear_acceleration.z -= 9.81


def in_g(message: Any) -> None:
    force = message.linear_acceleration
    force.x, force.y, force.z = force.x / 9.81, force.y / 9.81, force.z / 9.81


def backwards(message: Any) -> None:
    force = message.linear_acceleration
    force.x, force.y = -force.x, -force.y


def gyro(factor: float):
    def change(message: Any) -> None:
        message.angular_velocity.z *= factor

    return change


def offset_in_degrees(message: Any) -> None:
    message.angular_velocity.z = message.angular_velocity.z * DEGREES + 0.3


def map_axes(pose: Any, twist: Any) -> None:
    yaw, speed = 2.0 * math.atan2(pose.orientation.z, pose.orientation.w), twist.linear.x
    twist.linear.x, twist.linear.y = speed * math.cos(yaw), speed * math.sin(yaw)


def speed(factor: float):
    def change(pose: Any, twist: Any) -> None:
        twist.linear.x *= factor

    return change


def yaw_rate(factor: float):
    def change(pose: Any, twist: Any) -> None:
        twist.angular.z *= factor

    return change


def heading_reversed(pose: Any, twist: Any) -> None:
    pose.orientation.z = -pose.orientation.z


def scaled_k(message: Any) -> None:
    message.k = np.array([130.0, 0.0, 80.0, 0.0, 130.0, 48.0, 0.0, 0.0, 1.0])


def distorted(message: Any) -> None:
    message.d = np.array([-0.3, 0.1, 0.0, 0.0, 0.0])


def frame(topic: str, message: Any) -> None:
    if topic == topics.ODOMETRY:
        message.header.frame_id = 'odom'


FAULTS = (
    # What was found before.
    Fault('steering to the right', 'steer left', 'turns LEFT', control=lambda c: replace(c, steer=-c.steer)),
    Fault('no gravity in the IMU', 'imu: units', 'gravity is missing', message=imu(without_gravity)),
    Fault('accelerometer in g', 'imu: units', 'not g', message=imu(in_g)),
    Fault('frame of odometry', '/vehicle/odometry: frame', 'frame_id map', 'warning', message=frame),
    Fault('stamps 1.5 s late', 'clock: stamps', 'too old', age_s=1.5),
    Fault('stamps 1.5 s in the future', 'clock: stamps', 'in the future', age_s=-1.5),
    Fault('cameras at 15 Hz', 'rate, 12 times', 'whole multiple', camera_hz=15),
    Fault(
        'lens distortion', 'camera front: calibration', 'lens distortion', 'warning', message=info('front', distorted)
    ),
    Fault('another K than the bundle', 'camera front: calibration', 'intrinsics 15', message=info('front', scaled_k)),
    Fault('best effort', 'QoS, 14 times', 'reliability RELIABLE', reliable=False),
    Fault('brake does nothing', 'brake stops', 'must stop the car', control=lambda c: replace(c, brake=0.0)),
    # What was missed.
    Fault(
        'pictures of another lens than K',
        'camera front: motion of the picture',
        'different lenses',
        look=lambda name, look, rig: look(other_lens(rig[name], WIDE) if name == 'front' else rig[name]),
    ),
    Fault(
        'a camera upside down',
        'camera back_left: motion of the picture',
        'upside down',
        look=lambda name, look, rig: look(rig[name])[::-1, ::-1] if name == 'back_left' else look(rig[name]),
    ),
    Fault(
        'left and right exchanged',
        'cameras front_left and front_right: exchanged',
        'exchange their topics',
        look=lambda name, look, rig: look(rig[EXCHANGED.get(name, name)]),
    ),
    Fault(
        'BGR as RGB',
        'cameras: order of the colours',
        'the bytes are BGR',
        look=lambda name, look, rig: look(rig[name])[..., ::-1],
    ),
    Fault('odometry twist in map axes', 'odometry: twist', 'axes of map', message=odometry(map_axes)),
    Fault(
        'odometry twist in map axes, heading north',
        'odometry: twist',
        'axes of map',
        message=odometry(map_axes),
        yaw_rad=math.pi / 2,
    ),
    Fault('300 ms of actuator delay', 'actuator delay', 'shorten the way', delay_s=0.3),
    Fault('IMU yaw sign', 'imu: yaw rate', 'to the left is positive', message=imu(gyro(-1.0))),
    Fault('gyroscope in degrees', 'imu: yaw rate', 'degrees per second', message=imu(gyro(DEGREES))),
    Fault('gyroscope in degrees, standing', 'imu: at rest', 'not degrees', 'warning', message=imu(offset_in_degrees)),
    Fault(
        'odometry yaw rate in degrees', 'odometry: yaw rate', 'degrees per second', message=odometry(yaw_rate(DEGREES))
    ),
    Fault(
        'yaw rate sign of odometry', 'odometry: yaw rate', 'to the left is positive', message=odometry(yaw_rate(-1.0))
    ),
    Fault('speed in km/h', 'odometry: twist', 'km/h', message=odometry(speed(3.6))),
    Fault('heading to the right', 'odometry: heading', 'heading of the pose', message=odometry(heading_reversed)),
    Fault('IMU mounted backwards', 'imu: forward acceleration', 'looks backwards', message=imu(backwards)),
    Fault('cameras at 30 Hz', 'rate, 12 times', 'one picture in 3', 'warning', camera_hz=30),
    Fault('a stranger can drive it', 'a foreign command is refused', 'obey one publisher', obeys_strangers=True),
)
# These show while the car stands.
STANDING = ('gyroscope in degrees, standing',)


def found(fault: Fault) -> list[Verdict]:
    """Errors and warnings of check-vehicle on a car with this fault, causes first."""
    verdicts = check(fault, motion=fault.name not in STANDING)
    return [verdict for verdict in verdicts if verdict.severity in ('error', 'warning')]


def names_it(fault: Fault, verdicts: list[Verdict]) -> bool:
    """Whether the first finding is the fault itself."""
    if not verdicts:
        return False
    first = verdicts[0]
    return (first.check, first.severity) == (
        fault.check,
        fault.severity,
    ) and fault.words in f'{first.text} {first.remedy}'


def main() -> int:
    """Print the table and return the exit code."""
    named = 0
    print(f'{"planted":42} {"named":6} {"others":6} found')
    for fault in FAULTS:
        verdicts = found(fault)
        good = names_it(fault, verdicts)
        named += good
        first = f'{verdicts[0].check}: {verdicts[0].remedy}' if verdicts else 'nothing'
        print(f'{fault.name:42} {"yes" if good else "NO":6} {max(0, len(verdicts) - 1):<6} {first}', flush=True)
    print(f'{"healthy":42} {"":6} {len(found(HEALTHY)):<6}')
    print(f'{named} of {len(FAULTS)} named by the right cause')
    return int(named < len(FAULTS))


if __name__ == '__main__':
    raise SystemExit(main())
