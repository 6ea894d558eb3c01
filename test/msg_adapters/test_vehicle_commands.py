"""Commands for other vehicles, through CDR and back; types that are not in common_interfaces are defined here."""

import pytest
from rosbags.typesys import get_types_from_msg

from msg_adapters.factory import RclpyFactory, RosbagsFactory
from msg_adapters.motion import Motion
from msg_adapters.stamps import stamp_ns
from msg_adapters.vehicle_commands import ADAPTERS
from raw2drive_ros.contracts.public import Control

STAMP_NS = 12_345_678_901
CONTROL = Control(0.25, 0.0, 0.5)
MOTION = Motion(6.0, 1.25, 0.3, 0.74)
FIELDS = {
    'ackermann_msgs/msg/AckermannDrive': (
        'float32 steering_angle\nfloat32 steering_angle_velocity\nfloat32 speed\nfloat32 acceleration\nfloat32 jerk'
    ),
    'ackermann_msgs/msg/AckermannDriveStamped': 'std_msgs/Header header\nackermann_msgs/AckermannDrive drive',
    'autoware_control_msgs/msg/Lateral': (
        'builtin_interfaces/Time stamp\nbuiltin_interfaces/Time control_time\nfloat32 steering_tire_angle\n'
        'float32 steering_tire_rotation_rate\nbool is_defined_steering_tire_rotation_rate'
    ),
    'autoware_control_msgs/msg/Longitudinal': (
        'builtin_interfaces/Time stamp\nbuiltin_interfaces/Time control_time\nfloat32 velocity\nfloat32 acceleration\n'
        'float32 jerk\nbool is_defined_acceleration\nbool is_defined_jerk'
    ),
    'autoware_control_msgs/msg/Control': (
        'builtin_interfaces/Time stamp\nbuiltin_interfaces/Time control_time\nautoware_control_msgs/Lateral lateral\n'
        'autoware_control_msgs/Longitudinal longitudinal'
    ),
    'carla_msgs/msg/CarlaEgoVehicleControl': (
        'std_msgs/Header header\nfloat32 throttle\nfloat32 steer\nfloat32 brake\nbool hand_brake\nbool reverse\n'
        'int32 gear\nbool manual_gear_shift'
    ),
}


@pytest.fixture(scope='module')
def factory() -> RosbagsFactory:
    found = RosbagsFactory()
    types = {}
    for name, text in FIELDS.items():
        types.update(get_types_from_msg(text, name))
    found.typestore.register(types)
    return found


def made(factory, output, control=CONTROL, motion=MOTION):
    """The message that a vehicle reads from the bytes."""
    adapter = ADAPTERS[output]
    message = adapter.make(factory, control, motion, STAMP_NS)
    return factory.deserialize(factory.serialize(message, adapter.msgtype), adapter.msgtype)


def test_twist(factory) -> None:
    message = made(factory, 'twist')
    assert (stamp_ns(message.header.stamp), message.header.frame_id) == (STAMP_NS, 'base_link')
    assert (message.twist.linear.x, message.twist.angular.z) == (6.0, 0.74)
    rest = (message.twist.linear.y, message.twist.linear.z, message.twist.angular.x, message.twist.angular.y)
    assert rest == (0.0, 0.0, 0.0, 0.0)


def test_twist_of_the_running_ros() -> None:
    message = ADAPTERS['twist'].make(RclpyFactory(), CONTROL, MOTION, STAMP_NS)
    assert (message.twist.linear.x, message.twist.angular.z) == (6.0, 0.74)


def test_ackermann(factory) -> None:
    message = made(factory, 'ackermann')
    drive = message.drive
    assert stamp_ns(message.header.stamp) == STAMP_NS
    assert (drive.steering_angle, drive.speed, drive.acceleration) == pytest.approx((0.3, 6.0, 1.25))
    assert (drive.steering_angle_velocity, drive.jerk) == (0.0, 0.0)


def test_autoware(factory) -> None:
    message = made(factory, 'autoware')
    stamps = [message.stamp, message.control_time, message.lateral.stamp, message.longitudinal.control_time]
    assert {stamp_ns(stamp) for stamp in stamps} == {STAMP_NS}
    assert message.lateral.steering_tire_angle == pytest.approx(0.3)
    assert message.lateral.is_defined_steering_tire_rotation_rate is False
    assert (message.longitudinal.velocity, message.longitudinal.acceleration) == (6.0, 1.25)
    assert (message.longitudinal.is_defined_acceleration, message.longitudinal.is_defined_jerk) == (True, False)


@pytest.mark.parametrize('reverse', [False, True])
def test_carla_steers_positive_to_the_right(factory, reverse) -> None:
    message = made(factory, 'carla', Control(0.25, 0.125, 0.5, reverse))
    assert (message.throttle, message.brake, message.steer, message.reverse) == (0.25, 0.125, -0.5, reverse)
    assert (message.hand_brake, message.manual_gear_shift) == (False, False)


@pytest.mark.parametrize('output', ['ackermann', 'autoware', 'carla'])
def test_a_package_that_is_not_installed_is_an_import_error(output) -> None:
    with pytest.raises(ImportError):
        ADAPTERS[output].make(RclpyFactory(), CONTROL, MOTION, STAMP_NS)
