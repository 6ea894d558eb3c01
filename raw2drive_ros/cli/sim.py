"""raw2drive sim: the simulation bridge alone."""

from __future__ import annotations

import argparse
from pathlib import Path

from raw2drive_ros.cli.deprecation import warn_old
from raw2drive_ros.cli.domain_option import add_domain_argument
from raw2drive_ros.cli.graph_options import add_graph_arguments
from raw2drive_ros.cli.parser import at_least

EXAMPLES = """examples:
  raw2drive sim --scenario HardBreakRoute --seed 3            (raw2drive scenario list has the names)
  raw2drive sim --scenario LaneFollowing --real-time          (then, elsewhere: raw2drive drive --sim-time)

While it runs: raw2drive call /bridge/reset --set scenario=Accident --set seed=3
               raw2drive call /bridge/pause true"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add_graph_arguments(parser)
    parser.add_argument('--list', action='store_true', help=argparse.SUPPRESS)
    parser.add_argument('--scenario', default='LaneFollowing')
    parser.add_argument('--seed', type=int, default=0)
    parser.add_argument('--weather', default='ClearNoon', help='weather preset of the camera images')
    parser.add_argument('--picture', type=Path, help=argparse.SUPPRESS)
    parser.add_argument('--size', default='96x160', help='camera images: 96x160, 224x400 or 64x96')
    parser.add_argument('--real-time', action='store_true', help='follow the wall clock instead of lock-step')
    parser.add_argument('--image-transport', choices=('raw', 'compressed'), default='raw', help='image topics in use')
    add_domain_argument(parser)


def run(options: argparse.Namespace) -> int:
    from raw2drive_ros.contracts.errors import UsageError
    from raw2drive_ros.simulation.camera_rig import SIZES
    from raw2drive_ros.simulation.scenario import get_scenario
    from raw2drive_ros.simulation.weather import get_weather

    if options.list:
        from raw2drive_ros.cli.scenario import print_list

        warn_old('sim --list', 'raw2drive scenario list')
        return print_list()
    get_scenario(options.scenario)
    at_least(options, 0, 'seed')
    if options.size not in SIZES:
        raise UsageError(f'--size {options.size}: use one of {", ".join(SIZES)}')
    height, width = SIZES[options.size]
    if options.picture is not None:
        from raw2drive_ros.evaluation.world_drivers import rule_driver
        from raw2drive_ros.report.scene import save_picture
        from raw2drive_ros.simulation.route_id import RouteId

        warn_old('sim --picture', 'raw2drive scenario show TYPE --seed N --picture FILE')
        route = RouteId(options.scenario, options.seed, get_weather(options.weather).name)
        print(save_picture(options.picture, route, (height, width), rule_driver()))
        return 0
    from raw2drive_ros.graph.foreground import run_single

    parameters = {
        'scenario': options.scenario,
        'seed': options.seed,
        'weather': get_weather(options.weather).name,
        'lock_step': not options.real_time,
        'image_height': height,
        'image_width': width,
        'image_transport': options.image_transport,
        # In real time, sensors publish with or without subscribers, as a vehicle's do; lock-step waits for them.
        'wait_for_sensor_subscribers': int(not options.real_time),
    }
    return run_single({'bridge': parameters}, options.domain, namespace=options.namespace, sim_time=False)
