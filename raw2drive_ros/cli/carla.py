"""raw2drive carla: a car of a CARLA server as the vehicle."""

from __future__ import annotations

import argparse
from pathlib import Path

from raw2drive_ros.cli.domain_option import add_domain_argument
from raw2drive_ros.cli.graph_options import add_graph_arguments
from raw2drive_ros.cli.parser import at_least

EXAMPLES = """examples:
  raw2drive carla                                          the server at localhost:2000, its map, its first spawn point
  raw2drive carla --host 10.0.0.7 --town Town05 --spawn-point 12 --seed 3
  raw2drive drive --lock-step                              in another terminal: planner and gate
  raw2drive check-vehicle --sim-time                       in another terminal: is it a vehicle?

Needs the package carla in the version of the server (pip install 'raw2drive_ros[carla]'). The bridge ticks the server
and waits for each command (lock-step); --real-time follows the wall clock."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add_graph_arguments(parser)
    from raw2drive_ros.carla_vehicle.client import CarlaSettings

    usual = CarlaSettings()
    parser.add_argument('--host', default=usual.host, help='of the CARLA server')
    parser.add_argument('--port', type=int, default=usual.port, help='of the CARLA server')
    parser.add_argument(
        '--timeout', type=float, default=usual.timeout_s, help='seconds that the server may take to answer'
    )
    parser.add_argument('--town', default=usual.town, help='map to load (default: the one that is loaded)')
    parser.add_argument('--vehicle', default=usual.vehicle, help='blueprint of the car')
    parser.add_argument('--spawn-point', type=int, default=usual.spawn_point, help='where to start')
    parser.add_argument('--route-m', type=float, default=usual.route_m, help='length of the route along the lanes')
    parser.add_argument('--seed', type=int, default=usual.seed, help="of the route's choices at junctions")
    parser.add_argument(
        '--bundle', type=Path, help='policy bundle whose cameras are mounted (default: the shipped one)'
    )
    parser.add_argument('--image-transport', choices=('raw', 'compressed'), default='raw', help='image topics')
    parser.add_argument('--real-time', action='store_true', help='follow the wall clock')
    add_domain_argument(parser)


def run(options: argparse.Namespace) -> int:
    from raw2drive_ros.contracts.errors import UsageError
    from raw2drive_ros.graph.foreground import run_single

    if not (options.route_m > 0 and options.timeout > 0):
        raise UsageError('--route-m and --timeout must be positive')
    at_least(options, 0, 'seed', 'spawn_point')
    parameters = {
        'host': options.host,
        'port': options.port,
        'timeout_s': options.timeout,
        'town': options.town,
        'vehicle': options.vehicle,
        'spawn_point': options.spawn_point,
        'route_m': options.route_m,
        'seed': options.seed,
        'bundle': str(options.bundle.resolve()) if options.bundle else '',
        'image_transport': options.image_transport,
        'lock_step': not options.real_time,
    }
    # The bridge removes its actors one by one, and the server may take --timeout to finish its current tick.
    grace_s = options.timeout + 10.0
    return run_single(
        {'carla_bridge': parameters}, options.domain, namespace=options.namespace, sim_time=False, end_within_s=grace_s
    )
