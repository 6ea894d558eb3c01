"""Builds with pip and, as an ament_python package, with colcon."""

from pathlib import Path

from setuptools import find_packages, setup

NAME = 'raw2drive_ros'
# MIT; wheels for Linux and Windows on x86-64 only.
CARLA = 'carla>=0.9.15,<0.10; platform_machine == "x86_64" and python_version >= "3.10" and python_version < "3.13"'
SHARE = Path('share') / NAME


def tree(folder: str) -> list[tuple[str, list[str]]]:
    """data_files entries for every file below `folder`."""
    found: dict[str, list[str]] = {}
    for path in sorted(Path(folder).rglob('*')):
        if path.is_file():
            found.setdefault(str(SHARE / path.parent), []).append(str(path))
    return list(found.items())


setup(
    name=NAME,
    version='0.2.0',
    description='End-to-end driving by dual-stream model-based reinforcement learning, as a ROS 2 stack.',
    packages=find_packages(include=[f'{NAME}*', 'msg_adapters*']),
    package_data={NAME: ['py.typed', 'report/*.html'], 'msg_adapters': ['py.typed']},
    data_files=[
        ('share/ament_index/resource_index/packages', [f'resource/{NAME}']),
        (str(SHARE), ['package.xml']),
        (str(SHARE / 'launch'), sorted(str(p) for p in Path('launch').glob('*.launch.py'))),
        *tree('params'),
    ],
    python_requires='>=3.10',
    install_requires=[
        # What rosbags itself unpacks and reads bags with; here the same with limits.
        'apsw>=3.46',
        'backports.zstd>=1; python_version < "3.14"',
        'lz4>=4',
        'av>=13',
        'gymnasium>=1.0',
        'highway-env>=1.12,<1.13',
        'jinja2>=3.1',
        'matplotlib>=3.8',
        'mcap>=1.2',
        'numpy>=1.26',
        'opencv-python-headless>=4.9',
        'psutil>=5.9',
        'pydantic>=2.7',
        'pyyaml>=6',
        'rich>=13',
        # Its storage classes are subclassed.
        'rosbags>=0.11.9,<0.12',
        'safetensors>=0.5',
        'setuptools',
        # Shell completion; pure Python, without dependencies, imported by `raw2drive completion` only.
        'shtab>=1.7,<2',
        'tensorboardX>=2.6',
        'torch>=2.4',
    ],
    extras_require={
        # On a machine with ROS 2 Jazzy installed, leave this extra out: rclpy comes from there.
        'ros': [
            'ros-jazzy-rclpy',
            'ros-jazzy-common-interfaces',
            'ros-jazzy-rmw-fastrtps-cpp',
            'ros-jazzy-lifecycle-msgs',
            'ros-jazzy-rosgraph-msgs',
            'ros-jazzy-rcl-interfaces',
        ],
        'test': [
            'pytest>=8',
            'pytest-xdist>=3.6',
            'hypothesis>=6',
            'mypy>=1.10',
            'ruff>=0.6',
            'coverage>=7.10',
            'mutmut>=3.8,<4',
            'types-PyYAML',
            CARLA,
        ],
        # The client has to be of the server's version.
        'carla': [CARLA],
        # Coverage-guided fuzzing, for Linux: test/fuzz/run.py.
        'fuzz': ['atheris>=3'],
        'build': ['colcon-common-extensions'],
    },
    zip_safe=False,
    entry_points={
        'console_scripts': [
            'raw2drive = raw2drive_ros.cli.main:main',
            # With the prefix, because pip puts them on PATH, where `bridge` or `player` may be somebody else's.
            'raw2drive_bridge = raw2drive_ros.nodes.bridge:main',
            'raw2drive_planner = raw2drive_ros.nodes.planner:main',
            'raw2drive_safety_gate = raw2drive_ros.nodes.safety_gate:main',
            'raw2drive_recorder = raw2drive_ros.nodes.recorder:main',
            'raw2drive_carla_bridge = raw2drive_ros.nodes.carla_bridge:main',
            'raw2drive_command_adapter = raw2drive_ros.nodes.command_adapter:main',
            'raw2drive_fault_injector = raw2drive_ros.nodes.fault_injector:main',
            'raw2drive_vehicle_probe = raw2drive_ros.nodes.vehicle_probe:main',
            'raw2drive_player = raw2drive_ros.nodes.player:main',
        ],
    },
)
