"""Planner and safety gate only: for a vehicle interface that is already in the graph.

ros2 launch raw2drive_ros driver.launch.py bundle:=/path/to/bundle gate:=/path/to/gate.yaml

Every option of `raw2drive drive` is an argument here, with an underscore for a hyphen.
"""

from pathlib import Path

from ament_index_python.packages import get_package_share_directory
from launch.actions import DeclareLaunchArgument, OpaqueFunction, SetEnvironmentVariable
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node

from launch import LaunchDescription
from raw2drive_ros.cli.graph_options import namespace as with_slash
from raw2drive_ros.contracts.errors import UsageError
from raw2drive_ros.graph.driver_nodes import DriverOptions, driver_nodes, is_simulated
from raw2drive_ros.graph.processes import SHARED


def is_true(name: str, value: str) -> bool:
    if value.lower() not in ('true', 'false'):
        raise UsageError(f'{name}:={value}: use true or false')
    return value.lower() == 'true'


def nodes(context: object) -> list:
    """Gate and planner, as `raw2drive drive` starts them; made once the arguments are known."""

    def value(name: str) -> str:
        return LaunchConfiguration(name).perform(context)

    options = DriverOptions(
        bundle=Path(value('bundle')),
        lock_step=is_true('lock_step', value('lock_step')),
        sim_time=is_true('sim_time', value('sim_time')),
        image_transport=value('image_transport'),
        sensor_reliability=value('sensor_reliability'),
        interpolate_age=float(value('interpolate_age')),
        camera_skew=float(value('camera_skew')),
        gate=Path(value('gate')) if value('gate') else None,
        monitor=Path(value('monitor')) if value('monitor') else None,
    )
    simulated = {'use_sim_time': is_simulated(options)}
    namespace = with_slash(value('namespace'))
    place = {'namespace': namespace, 'remappings': [(t, namespace + t) for t in SHARED]} if namespace else {}
    # The nodes choose their DDS profile by this variable.
    open_network = '1' if is_true('network', value('network')) else ''
    variables = {'ROS_DOMAIN_ID': value('domain'), 'RAW2DRIVE_NETWORK': open_network}
    return [SetEnvironmentVariable(name, text) for name, text in variables.items() if text] + [
        Node(
            package='raw2drive_ros',
            executable=f'raw2drive_{name}',
            name=name,
            parameters=[parameters | simulated],
            **place,
        )
        for name, parameters in driver_nodes(options).items()
    ]


def argument(name: str, default: str, description: str, *choices: str) -> DeclareLaunchArgument:
    return DeclareLaunchArgument(name, default_value=default, description=description, choices=list(choices) or None)


def generate_launch_description() -> LaunchDescription:
    share = Path(get_package_share_directory('raw2drive_ros'))
    bundle = str(share / 'params' / 'bundles' / 'laptop')
    return LaunchDescription(
        [
            argument('bundle', bundle, 'folder of the policy bundle'),
            argument('lock_step', 'false', 'measure silence by /clock instead of the wall', 'true', 'false'),
            argument('sim_time', 'false', 'stamps are those of /clock, silence goes by the wall', 'true', 'false'),
            argument('image_transport', 'raw', 'image topics in use', 'raw', 'compressed'),
            argument('sensor_reliability', 'reliable', 'QoS of the sensors', 'reliable', 'best_effort'),
            argument('interpolate_age', '0.0', 'interpolate IMU and odometry between samples no further off (s)'),
            argument('camera_skew', '0.0', 'pictures whose stamps differ by no more are one frame (s)'),
            argument('gate', '', 'file like params/gate.yaml: limits and stops of your car'),
            argument('monitor', '', 'file like params/monitor.yaml: what counts as a bad sensor'),
            argument('domain', '', 'ROS domain (default: that of the environment)'),
            argument('namespace', '', 'of nodes and topics, as /car1: several cars in one domain'),
            argument('network', 'false', 'let other machines take part (default: this machine only)', 'true', 'false'),
            OpaqueFunction(function=nodes),
        ]
    )
