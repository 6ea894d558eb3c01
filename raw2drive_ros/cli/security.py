"""raw2drive security: access control for SROS2, for a ROS 2 installation that has DDS security."""

from __future__ import annotations

import argparse
from pathlib import Path

from raw2drive_ros.cli.graph_options import add_namespace_argument

EXAMPLES = """examples:
  raw2drive security policies --out security             one file, an enclave for every process of a graph
  raw2drive security policies --out security --namespace car1
  ros2 security generate_artifacts -k keystore -p security/raw2drive.policy.xml

Only the gate's enclave publishes /control/command, only the operator's (service_call) requests an activation.
docs/security.md says how to use them, and why the wheels of PyPI cannot: they are built without DDS security."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument('action', choices=('policies',))
    parser.add_argument('--out', type=Path, required=True, help='folder for the policy file')
    add_namespace_argument(parser)


def run(options: argparse.Namespace) -> int:
    from raw2drive_ros.artifact import write_whole
    from raw2drive_ros.contracts.errors import UsageError
    from raw2drive_ros.graph.security_policy import enclaves, policy_file, policy_text

    path = policy_file(options.out, options.namespace)
    if path.exists():
        raise UsageError(f'{path} exists: remove it, or give another --out')
    options.out.mkdir(parents=True, exist_ok=True)
    write_whole(path, policy_text(options.namespace))
    print(f'{path}: {len(enclaves())} enclaves')
    return 0
