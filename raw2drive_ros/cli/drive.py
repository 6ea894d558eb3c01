"""raw2drive drive: planner and safety gate on whatever vehicle is in the graph."""

from __future__ import annotations

import argparse
from pathlib import Path

from raw2drive_ros.cli.domain_option import add_domain_argument
from raw2drive_ros.cli.graph_options import add_graph_arguments

EXAMPLES = """examples:
  raw2drive drive                                   the shipped policy, wall-clock gate
  raw2drive drive --bundle runs/bundle --lock-step  for a bridge in lock-step
  raw2drive drive --gate my_car.yaml                your car's limits (a copy of params/gate.yaml)
  raw2drive drive --sim-time                        for a simulation in real time: stamps are those of /clock
  raw2drive drive --sensor-reliability best_effort --interpolate-age 0.05 --camera-skew 0.02
                                                    sensors that offer best effort and share no trigger

When the planner dies, the gate stops the car before everything ends, and so it does on Ctrl-C.
The gate's stop is latched; once the car stands: raw2drive call /safety_gate/activate [--domain N]"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add_graph_arguments(parser)
    parser.add_argument('--bundle', type=Path, help='policy bundle (default: the shipped one)')
    parser.add_argument('--lock-step', action='store_true', help='measure silence by /clock instead of the wall')
    parser.add_argument('--sim-time', action='store_true', help='stamps are those of /clock, silence goes by the wall')
    parser.add_argument('--image-transport', choices=('raw', 'compressed'), default='raw', help='image topics in use')
    parser.add_argument(
        '--sensor-reliability', choices=('reliable', 'best_effort'), default='reliable', help='QoS of the sensors'
    )
    parser.add_argument(
        '--interpolate-age',
        type=float,
        default=0.0,
        metavar='S',
        help='interpolate IMU and odometry to the pictures between samples no further off (default 0: equal stamps)',
    )
    parser.add_argument(
        '--camera-skew',
        type=float,
        default=0.0,
        metavar='S',
        help='pictures whose stamps differ by no more are one frame (default 0: equal stamps)',
    )
    parser.add_argument('--gate', type=Path, help='file like params/gate.yaml: limits and stops of your car')
    parser.add_argument('--monitor', type=Path, help='file like params/monitor.yaml: what counts as a bad sensor')
    add_domain_argument(parser)


def run(options: argparse.Namespace) -> int:
    from raw2drive_ros.driving.bundle import load_bundle
    from raw2drive_ros.driving.gate_config import load_gate_config
    from raw2drive_ros.driving.monitor_config import load_monitor_config
    from raw2drive_ros.driving.synchronisation import Synchronisation
    from raw2drive_ros.graph.driver_nodes import DriverOptions, driver_nodes, is_simulated
    from raw2drive_ros.graph.foreground import run_single
    from raw2drive_ros.settings import default_bundle

    chosen = DriverOptions(
        bundle=(options.bundle or default_bundle()).resolve(),
        lock_step=options.lock_step,
        sim_time=options.sim_time,
        image_transport=options.image_transport,
        sensor_reliability=options.sensor_reliability,
        interpolate_age=options.interpolate_age,
        camera_skew=options.camera_skew,
        gate=options.gate,
        monitor=options.monitor,
    )
    load_bundle(chosen.bundle)
    load_gate_config(chosen.gate)
    load_monitor_config(chosen.monitor)
    Synchronisation(chosen.interpolate_age, chosen.camera_skew)
    # The gate stops the car before it ends, both when the planner dies and when it is asked to end.
    return run_single(
        driver_nodes(chosen),
        options.domain,
        namespace=options.namespace,
        sim_time=is_simulated(chosen),
        end_within_s=10.0,
        survivor='safety_gate',
    )
