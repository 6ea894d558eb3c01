"""Control as the messages that other vehicles take: TwistStamped, Ackermann, Autoware, CARLA.

Only TwistStamped is part of common_interfaces; the packages of the others are imported when a message is made.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from msg_adapters.factory import MessageFactory
from msg_adapters.motion import Motion
from msg_adapters.sensors import BASE_FRAME
from msg_adapters.stamps import set_stamp
from raw2drive_ros.contracts.public import Control

Make = Callable[[MessageFactory, Control, Motion, int], Any]


@dataclass(frozen=True, slots=True)
class CommandAdapter:
    """topic: default of such vehicles. make: one of the functions below. about: for help texts."""

    msgtype: str
    topic: str
    make: Make
    about: str


def twist_to_message(factory: MessageFactory, control: Control, motion: Motion, time_ns: int) -> Any:
    """TwistStamped in `base_link` (REP-103): linear.x m/s, angular.z rad/s, left positive."""
    message = _stamped(factory, 'geometry_msgs/msg/TwistStamped', time_ns)
    message.twist.linear.x, message.twist.angular.z = motion.speed_mps, motion.yaw_rate_radps
    return message


def ackermann_to_message(factory: MessageFactory, control: Control, motion: Motion, time_ns: int) -> Any:
    """AckermannDriveStamped: angle of the virtual front wheel (left positive), speed and acceleration.

    Steering rate and jerk stay 0, which leaves them to the vehicle.
    """
    message = _stamped(factory, 'ackermann_msgs/msg/AckermannDriveStamped', time_ns)
    drive = message.drive
    drive.steering_angle, drive.speed = motion.wheel_angle_rad, motion.speed_mps
    drive.acceleration = motion.acceleration_mps2
    return message


def autoware_to_message(factory: MessageFactory, control: Control, motion: Motion, time_ns: int) -> Any:
    """autoware_control_msgs/Control; Autoware takes the gear on another topic, which this does not publish."""
    message = factory.new('autoware_control_msgs/msg/Control')
    for part in (message, message.lateral, message.longitudinal):
        set_stamp(part.stamp, time_ns)
        set_stamp(part.control_time, time_ns)
    message.lateral.steering_tire_angle = motion.wheel_angle_rad
    message.longitudinal.velocity = motion.speed_mps
    message.longitudinal.acceleration = motion.acceleration_mps2
    message.longitudinal.is_defined_acceleration = True
    return message


def carla_to_message(factory: MessageFactory, control: Control, motion: Motion, time_ns: int) -> Any:
    """CarlaEgoVehicleControl of carla-ros-bridge: pedals as they are; CARLA steers positive to the RIGHT."""
    message = _stamped(factory, 'carla_msgs/msg/CarlaEgoVehicleControl', time_ns)
    message.throttle, message.brake, message.steer = control.throttle, control.brake, 0.0 - control.steer
    message.reverse = control.reverse
    return message


def _stamped(factory: MessageFactory, msgtype: str, time_ns: int) -> Any:
    message = factory.new(msgtype)
    set_stamp(message.header.stamp, time_ns)
    message.header.frame_id = BASE_FRAME
    return message


ADAPTERS = {
    'twist': CommandAdapter('geometry_msgs/msg/TwistStamped', '/cmd_vel', twist_to_message, 'speed and yaw rate'),
    'ackermann': CommandAdapter(
        'ackermann_msgs/msg/AckermannDriveStamped', '/ackermann_cmd', ackermann_to_message, 'wheel angle and speed'
    ),
    'autoware': CommandAdapter(
        'autoware_control_msgs/msg/Control',
        '/control/command/control_cmd',
        autoware_to_message,
        'wheel angle, speed and acceleration',
    ),
    'carla': CommandAdapter(
        'carla_msgs/msg/CarlaEgoVehicleControl',
        '/carla/ego_vehicle/vehicle_control_cmd',
        carla_to_message,
        'pedals and steering of carla-ros-bridge',
    ),
}
