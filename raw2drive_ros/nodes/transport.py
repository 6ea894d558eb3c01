"""The DDS transport: what stays on this machine, what a network may see, and warnings where others have decided that.

Must run before `rclpy.init()`; importing rclpy is harmless, initialising it is not.
"""

from __future__ import annotations

import ctypes
import os
import signal
import sys
from pathlib import Path

from raw2drive_ros.safe_path import safe_path_variables
from raw2drive_ros.settings import params_folder

PROFILE_VARIABLE = 'FASTRTPS_DEFAULT_PROFILES_FILE'
OTHER_PROFILE_VARIABLE = 'FASTDDS_DEFAULT_PROFILES_FILE'
# Otherwise Fast DDS also reads a profile from the working directory, which may open every interface.
SKIP_WORKING_DIRECTORY_VARIABLE = 'SKIP_DEFAULT_XML_FILE'
RANGE_VARIABLE = 'ROS_AUTOMATIC_DISCOVERY_RANGE'
LOCALHOST_ONLY_VARIABLE = 'ROS_LOCALHOST_ONLY'
# 1: nodes talk to other machines. The verbs' option --network sets it.
NETWORK_VARIABLE = 'RAW2DRIVE_NETWORK'
# Process that started the graph; its nodes end when it does, however it ends.
PARENT_VARIABLE = 'RAW2DRIVE_PARENT_PID'
PR_SET_PDEATHSIG = 1


def network_is_open() -> bool:
    """Whether RAW2DRIVE_NETWORK asks for nodes that other machines can reach."""
    return os.environ.get(NETWORK_VARIABLE, '') not in ('', '0')


def shipped_profile() -> Path:
    """Path of the Fast DDS profile that comes with the package: for this machine only, or for the network."""
    return params_folder() / ('fastdds_network.xml' if network_is_open() else 'fastdds.xml')


def profile_in_force() -> str | None:
    """Path of the profile that Fast DDS will read, or None."""
    return os.environ.get(PROFILE_VARIABLE) or os.environ.get(OTHER_PROFILE_VARIABLE)


def configure_transport() -> list[str]:
    """Choose the shipped profile and the range of discovery where the user has set nothing; returns warnings."""
    warnings = []
    os.environ.setdefault(SKIP_WORKING_DIRECTORY_VARIABLE, '1')
    current = profile_in_force()
    if current is None or _is_shipped(Path(current)):
        # Fast DDS 2 reads the first, Fast DDS 3 the second.
        os.environ[PROFILE_VARIABLE] = os.environ[OTHER_PROFILE_VARIABLE] = str(shipped_profile())
        warnings += _open_discovery() if network_is_open() else _close_discovery()
    else:
        warnings.append(
            f'Fast DDS profile {current} is in force instead of {shipped_profile()}; with small shared-memory segments '
            'images get lost, and it decides alone whether other machines can take part'
        )
        os.environ[PROFILE_VARIABLE] = current
        os.environ.setdefault(RANGE_VARIABLE, 'LOCALHOST')
    rmw = os.environ.get('RMW_IMPLEMENTATION')
    if rmw and rmw != 'rmw_fastrtps_cpp':
        warnings.append(
            f'RMW_IMPLEMENTATION={rmw}: the profile, which keeps everything on this machine and images whole, applies '
            'to rmw_fastrtps_cpp only'
        )
    if os.environ.get('ROS_SECURITY_ENABLE') == 'true' and os.environ.get('ROS_SECURITY_STRATEGY') != 'Enforce':
        warnings.append('without ROS_SECURITY_STRATEGY=Enforce, a node that finds no keys starts without security')
    return warnings


def _is_shipped(path: Path) -> bool:
    """Also the other one of the two: launch files and parents may have set it before the choice was made."""
    return path.resolve() in {(params_folder() / name).resolve() for name in ('fastdds.xml', 'fastdds_network.xml')}


def _close_discovery() -> list[str]:
    """The profile does it: rmw's own LOCALHOST would add a transport with sockets on every interface."""
    os.environ.pop(LOCALHOST_ONLY_VARIABLE, None)
    given = os.environ.get(RANGE_VARIABLE)
    if given == 'OFF':
        return []
    os.environ[RANGE_VARIABLE] = 'SYSTEM_DEFAULT'
    if given == 'SUBNET' or os.environ.get('ROS_STATIC_PEERS'):
        asked = f'{RANGE_VARIABLE}={given}' if given == 'SUBNET' else 'ROS_STATIC_PEERS is set'
        return [f'{asked}, but nodes stay on this machine; --network or {NETWORK_VARIABLE}=1 opens them to others']
    return []


def _open_discovery() -> list[str]:
    if os.environ.get(RANGE_VARIABLE) in (None, '', 'SYSTEM_DEFAULT'):
        os.environ[RANGE_VARIABLE] = 'SUBNET'
    if os.environ[RANGE_VARIABLE] == 'SUBNET' and os.environ.get(LOCALHOST_ONLY_VARIABLE) in (None, '', '0'):
        return []
    return [f'open to the network, but {RANGE_VARIABLE} or {LOCALHOST_ONLY_VARIABLE} keeps discovery on this machine']


def child_environment(domain: int, log_folder: Path | None = None) -> dict[str, str]:
    """Environment for the graph's processes: profile, domain, safe path, one thread per numeric library."""
    configure_transport()
    environment = os.environ | safe_path_variables()
    environment['ROS_DOMAIN_ID'] = str(domain)
    environment[PARENT_VARIABLE] = str(os.getpid())
    environment['RMW_IMPLEMENTATION'] = 'rmw_fastrtps_cpp'
    environment.setdefault('OMP_NUM_THREADS', '1')
    # Otherwise glibc maps and unmaps memory for every large buffer.
    environment.setdefault('MALLOC_MMAP_THRESHOLD_', '268435456')
    environment.setdefault('MALLOC_TRIM_THRESHOLD_', '1073741824')
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
