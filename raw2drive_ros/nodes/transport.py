"""The DDS transport: the shipped profile, local discovery, and warnings where something else is in force.

Must run before `rclpy.init()`; importing rclpy is harmless, initialising it is not.
"""

from __future__ import annotations

import ctypes
import os
import signal
import sys
from pathlib import Path

from raw2drive_ros.settings import params_folder

PROFILE_VARIABLE = 'FASTRTPS_DEFAULT_PROFILES_FILE'
OTHER_PROFILE_VARIABLE = 'FASTDDS_DEFAULT_PROFILES_FILE'
# Process that started the graph; its nodes end when it does, however it ends.
PARENT_VARIABLE = 'RAW2DRIVE_PARENT_PID'
PR_SET_PDEATHSIG = 1


def shipped_profile() -> Path:
    """Path of the Fast DDS profile that comes with the package."""
    return params_folder() / 'fastdds.xml'


def profile_in_force() -> str | None:
    """Path of the profile that Fast DDS will read, or None."""
    return os.environ.get(PROFILE_VARIABLE) or os.environ.get(OTHER_PROFILE_VARIABLE)


def configure_transport() -> list[str]:
    """Set the shipped profile and local discovery where the user has set nothing; returns warnings."""
    warnings = []
    current = profile_in_force()
    if current is None:
        os.environ[PROFILE_VARIABLE] = str(shipped_profile())
    elif Path(current).resolve() != shipped_profile().resolve():
        warnings.append(
            f'Fast DDS profile {current} is in force instead of {shipped_profile()}; '
            'with small shared-memory segments images get lost'
        )
    rmw = os.environ.get('RMW_IMPLEMENTATION')
    if rmw and rmw != 'rmw_fastrtps_cpp':
        warnings.append(f'RMW_IMPLEMENTATION={rmw}: the image profile applies to rmw_fastrtps_cpp only')
    os.environ.setdefault('ROS_AUTOMATIC_DISCOVERY_RANGE', 'LOCALHOST')
    return warnings


def child_environment(domain: int, log_folder: Path | None = None) -> dict[str, str]:
    """Environment for the graph's processes: profile, domain, one thread per numeric library."""
    configure_transport()
    environment = dict(os.environ)
    environment['ROS_DOMAIN_ID'] = str(domain)
    environment[PARENT_VARIABLE] = str(os.getpid())
    environment['RMW_IMPLEMENTATION'] = 'rmw_fastrtps_cpp'
    environment.setdefault('OMP_NUM_THREADS', '1')
    # Otherwise glibc maps and unmaps memory for every large buffer.
    environment.setdefault('MALLOC_MMAP_THRESHOLD_', '268435456')
    environment.setdefault('MALLOC_TRIM_THRESHOLD_', '1073741824')
    root = str(Path(__file__).resolve().parents[2])
    parts = [p for p in (root, environment.get('PYTHONPATH', '')) if p]
    environment['PYTHONPATH'] = os.pathsep.join(parts)
    if log_folder is not None:
        environment['ROS_LOG_DIR'] = str(log_folder)
    return environment


def end_with_parent() -> bool:
    """Receive SIGINT when the process that started the graph ends, even by SIGKILL (Linux); False if it has ended.

    Nodes that were started otherwise (ros2 run, launch files) are left alone.
    """
    parent = int(os.environ.get(PARENT_VARIABLE, '0'))
    if not parent or not sys.platform.startswith('linux'):
        return True
    ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, signal.SIGINT)
    return os.getppid() == parent or Path(f'/proc/{parent}').exists()


def warn(messages: list[str]) -> None:
    """Print each message as a warning on stderr."""
    for message in messages:
        print(f'warning: {message}', file=sys.stderr)
