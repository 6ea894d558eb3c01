"""Simulation, planner, safety gate and recorder in one graph, for a stock ROS 2 Jazzy machine.

ros2 launch raw2drive_ros simulation.launch.py bundle:=/path/to/bundle scenario:=LaneFollowing seed:=3
"""

from pathlib import Path

from ament_index_python.packages import get_package_share_directory
from launch.actions import DeclareLaunchArgument, SetEnvironmentVariable
from launch.conditions import IfCondition
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node

from launch import LaunchDescription


def generate_launch_description() -> LaunchDescription:
    share = Path(get_package_share_directory('raw2drive_ros'))
    bundle = str(share / 'params' / 'bundles' / 'laptop')
    value = LaunchConfiguration
    arguments = [
        DeclareLaunchArgument('bundle', default_value=bundle, description='folder of the policy bundle'),
        DeclareLaunchArgument('scenario', default_value='LaneFollowing', description='scenario type'),
        DeclareLaunchArgument('seed', default_value='0', description='seed of the first route'),
        DeclareLaunchArgument('weather', default_value='ClearNoon', description='weather preset of the cameras'),
        DeclareLaunchArgument('lock_step', default_value='true', description='wait for each command'),
        DeclareLaunchArgument('gate_clock', default_value='ros', description='ros in lock-step, else steady'),
        DeclareLaunchArgument('record', default_value='false', description='record everything'),
        DeclareLaunchArgument('bag', default_value='raw2drive_bag', description='folder of the bag'),
    ]
    simulated = {'use_sim_time': True}
    return LaunchDescription(
        [
            *arguments,
            SetEnvironmentVariable('FASTRTPS_DEFAULT_PROFILES_FILE', str(share / 'params' / 'fastdds.xml')),
            Node(
                package='raw2drive_ros',
                executable='raw2drive_bridge',
                name='bridge',
                parameters=[
                    {name: value(name) for name in ('scenario', 'seed', 'weather', 'lock_step')},
                ],
            ),
            Node(
                package='raw2drive_ros',
                executable='raw2drive_safety_gate',
                name='safety_gate',
                parameters=[simulated | {'clock': value('gate_clock'), 'simulated': True}],
            ),
            Node(
                package='raw2drive_ros',
                executable='raw2drive_planner',
                name='planner',
                parameters=[simulated | {'bundle': value('bundle')}],
            ),
            Node(
                package='raw2drive_ros',
                executable='raw2drive_recorder',
                name='recorder',
                condition=IfCondition(value('record')),
                parameters=[simulated | {'bag': value('bag')}],
            ),
        ]
    )
