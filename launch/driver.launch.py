"""Planner and safety gate only: for a vehicle interface that is already in the graph.

ros2 launch raw2drive_ros driver.launch.py bundle:=/path/to/bundle
"""

from pathlib import Path

from ament_index_python.packages import get_package_share_directory
from launch.actions import DeclareLaunchArgument, SetEnvironmentVariable
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node

from launch import LaunchDescription


def generate_launch_description() -> LaunchDescription:
    share = Path(get_package_share_directory('raw2drive_ros'))
    bundle = str(share / 'params' / 'bundles' / 'laptop')
    return LaunchDescription(
        [
            DeclareLaunchArgument('bundle', default_value=bundle, description='folder of the policy bundle'),
            SetEnvironmentVariable('FASTRTPS_DEFAULT_PROFILES_FILE', str(share / 'params' / 'fastdds.xml')),
            Node(package='raw2drive_ros', executable='raw2drive_safety_gate', name='safety_gate'),
            Node(
                package='raw2drive_ros',
                executable='raw2drive_planner',
                name='planner',
                parameters=[{'bundle': LaunchConfiguration('bundle')}],
            ),
        ]
    )
