"""Simulation, planner and gate with a fault injector between them (real time), for a stock ROS 2 Jazzy machine.

ros2 launch raw2drive_ros faults.launch.py plan:="camera frozen" scenario:=LaneFollowing seed:=1
"""

from pathlib import Path

from ament_index_python.packages import get_package_share_directory
from launch.actions import DeclareLaunchArgument, OpaqueFunction, SetEnvironmentVariable
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node

from launch import LaunchDescription
from raw2drive_ros.contracts import topics
from raw2drive_ros.faults.plan import load_plans, remapping


def nodes(context: object) -> list[Node]:
    """The nodes are made once the plan's name is known, because their remappings depend on the plan."""
    value = LaunchConfiguration
    plans = value('plans').perform(context)
    plan = value('plan').perform(context)
    faults = load_plans(plans).plans[plan]
    share = Path(get_package_share_directory('raw2drive_ros'))
    bundle = str(share / 'params' / 'bundles' / 'laptop')
    simulated = {'use_sim_time': True}

    def node(name: str, parameters: dict, heard: tuple[str, ...] = ()) -> Node:
        remappings = list(remapping(faults, heard).items())
        return Node(
            package='raw2drive_ros',
            executable=f'raw2drive_{name}',
            name=name,
            parameters=[parameters],
            remappings=remappings,
        )

    return [
        node('fault_injector', simulated | {'plans': plans, 'plan': plan}),
        node('safety_gate', simulated | {'clock': 'steady', 'simulated': True}, (topics.PROPOSED, topics.ODOMETRY)),
        node('planner', simulated | {'bundle': bundle}, topics.SENSOR_TOPICS),
        node(
            'bridge',
            {'lock_step': False, 'scenario': value('scenario'), 'seed': value('seed')},
            (topics.COMMAND,),
        ),
    ]


def generate_launch_description() -> LaunchDescription:
    share = Path(get_package_share_directory('raw2drive_ros'))
    return LaunchDescription(
        [
            DeclareLaunchArgument('plans', default_value='matrix', description='file in params/faults, or a YAML file'),
            DeclareLaunchArgument('plan', default_value='camera frozen', description='which of its plans'),
            DeclareLaunchArgument('scenario', default_value='LaneFollowing', description='scenario type'),
            DeclareLaunchArgument('seed', default_value='1', description='seed of the first route'),
            SetEnvironmentVariable('FASTRTPS_DEFAULT_PROFILES_FILE', str(share / 'params' / 'fastdds.xml')),
            OpaqueFunction(function=nodes),
        ]
    )
