"""raw2drive evaluate: closed-loop scores, in process or through the ROS graph."""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import TYPE_CHECKING, Any

from raw2drive_ros.cli.deprecation import warn_old
from raw2drive_ros.cli.driver_options import refuse_for_drivers
from raw2drive_ros.cli.parser import at_least, note, refuse
from raw2drive_ros.cli.route_options import add_route_arguments, chosen_limits, chosen_references, chosen_routes
from raw2drive_ros.evaluation.drivers import CLASS_MARK, driver_entry, driver_help, driver_list
from raw2drive_ros.simulation.protocol import BENCH2DRIVE, PAIRS, PROTOCOLS

if TYPE_CHECKING:
    from raw2drive_ros.evaluation.driver_spec import DriverSpec
    from raw2drive_ros.simulation.route_id import RouteId

EXAMPLES = """examples:
  raw2drive evaluate --driver raw --routes lane-following --seeds 20 --json
  raw2drive evaluate --driver rule --routes all --seeds 5 --weather HardRainNight
  raw2drive evaluate --driver expert --suite b2d220 --workers 2 --out runs/expert.jsonl
  raw2drive evaluate --driver rule --suite b2d220 --seeds 3 --out runs/rule.jsonl     three repetitions
  raw2drive evaluate --driver rule --suite dev10 --graph                              as ROS processes
  raw2drive evaluate faults --seeds 3                                                 what if something breaks?
  raw2drive evaluate --driver privileged --run runs/stage1 --routes lane-following
  raw2drive evaluate --driver rule --suite b2d220 --protocol bench2drive              events alone, loose limits
  raw2drive evaluate --driver my_driver:MyDriver --driver-args gain=0.5 --suite dev10  a class, see docs/gym.md

Then compare: raw2drive report runs/expert.jsonl runs/rule.jsonl --out report.html

Seeds 0, 1, ... are evaluation routes, 50000, ... validation routes (choose checkpoints there); training
bags use seeds from 100000 on. Repetition 0 is the route as drawn; others start up to a metre, a few
decimetres and half a metre per second beside it, with other sensor noise."""
EXAMPLES += f'\n\n{driver_list()}'


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument('--driver', default='raw', help=driver_help())
    parser.add_argument('--bundle', type=Path, help='policy bundle (default: the shipped one)')
    parser.add_argument(
        '--run', dest='training_run', type=Path, help='of driver privileged: run, checkpoint or teacher'
    )
    parser.add_argument(
        '--driver-args', nargs='+', default=(), metavar='KEY=VALUE', help='for the constructor of package.module:Class'
    )
    add_route_arguments(parser)
    parser.add_argument('--blind', action='store_true', help='black out every camera (how much do they matter?)')
    parser.add_argument(
        '--table',
        action='store_true',
        help="turn commands into the policy's 39 actions (what can be imitated at best?)",
    )
    parser.add_argument(
        '--protocol',
        choices=PROTOCOLS,
        default=PAIRS,
        help="pairs of drives within the suite's limits of time, or single drives within Bench2Drive's",
    )
    parser.add_argument('--faults', metavar='PLANS', help=argparse.SUPPRESS)
    parser.add_argument(
        '--bench2drive-compat', action='store_true', help='efficiency and comfort as Bench2Drive computes them'
    )
    parser.add_argument('--quirks', action='store_true', help=argparse.SUPPRESS)
    parser.add_argument('--threads', type=int, default=1, help='torch threads')
    parser.add_argument('--workers', type=int, default=1, help='processes that drive at the same time')
    parser.add_argument('--graph', action='store_true', help='drive through the real ROS graph')
    parser.add_argument('--out', type=Path, help='per-route JSON lines; routes in it already are not driven again')
    parser.add_argument('--json', action='store_true', help='print the result as JSON')


def run(options: argparse.Namespace) -> int:
    import cv2

    from raw2drive_ros.cli.table import print_results
    from raw2drive_ros.contracts.errors import UsageError
    from raw2drive_ros.evaluation.driver_spec import DriverSpec
    from raw2drive_ros.evaluation.evaluate import EvaluationInterrupted
    from raw2drive_ros.settings import default_bundle

    cv2.setNumThreads(1)
    if options.faults is not None:
        return _run_faults(options)
    if options.quirks:
        warn_old('--quirks', '--bench2drive-compat')
        options.bench2drive_compat = True
    _check(options)
    suite, version, routes = chosen_routes(options)
    if options.protocol == BENCH2DRIVE:
        routes = [route for route in routes if not route.twin]
        if not routes:
            raise UsageError(f'{suite} has twins alone, which --protocol {BENCH2DRIVE} does not drive')
    bundle = options.bundle or default_bundle()
    spec = DriverSpec(
        options.driver,
        bundle,
        options.training_run,
        options.threads,
        options.blind,
        options.table,
        tuple(options.driver_args),
    )
    # A driver that cannot be built raises here, before any process starts or any file is written.
    spec.build()
    code = 0
    try:
        result = _drive(options, spec, suite, version, routes)
    except EvaluationInterrupted as stop:
        code, result = 130, stop.result
    if options.json and result is not None:
        print(json.dumps(result))
    elif result is not None:
        print_results(result)
    if code:
        done = len(result['routes']) if result is not None else 0
        resume = 'the same command goes on' if options.out else 'with --out FILE the same command goes on where it was'
        note(f'interrupted: the figures are of {done} of {len(routes)} routes; {resume}')
    return code


def _drive(
    options: argparse.Namespace, spec: DriverSpec, suite: str, version: str, routes: list[RouteId]
) -> dict[str, Any]:
    """Drive the routes with a progress bar. Raises EvaluationInterrupted at Ctrl-C."""
    from raw2drive_ros.evaluation.evaluate import Conditions, evaluate
    from raw2drive_ros.evaluation.metrics import RouteResult
    from raw2drive_ros.evaluation.results import filmstrips_of
    from raw2drive_ros.progress import bar
    from raw2drive_ros.report.filmstrip import FilmstripRecorder

    filmstrips = filmstrips_of(options.out) if options.out else None
    observe = FilmstripRecorder if filmstrips else None
    conditions = Conditions(
        bench2drive_compat=options.bench2drive_compat,
        observe=observe,
        filmstrips=filmstrips,
        limits_s=chosen_limits(options, routes),
        references_s=chosen_references(options, routes),
        protocol=options.protocol,
    )
    with bar('evaluating', len(routes), 'routes') as advance:

        def on_route(done: int, result: RouteResult) -> None:
            advance(done, f'{result.id} {result.route_completion:.0f} %')

        if options.graph:
            from raw2drive_ros.graph.drive import evaluate_graph

            return evaluate_graph(spec, suite, version, routes, conditions, options.out, on_route)
        return evaluate(spec, suite, version, routes, conditions, options.out, on_route, options.workers)


def _check(options: argparse.Namespace) -> None:
    """Raises UsageError for options that do not go together or would be without effect."""
    from raw2drive_ros.contracts.errors import UsageError

    at_least(options, 1, 'workers', 'threads')
    refuse_for_drivers(options, options.driver)
    if options.graph and (options.workers > 1 or options.blind):
        raise UsageError('--graph drives one route after another, with open eyes: no --workers, no --blind')
    if options.graph and CLASS_MARK in options.driver:
        raise UsageError(f'--graph: driver {options.driver} is a class, which drives in process only')
    if options.graph:
        refuse(options, ['threads'], 'the nodes of --graph have one thread each')
    if options.table and (options.graph or driver_entry(options.driver).table):
        raise UsageError('--table is for drivers of continuous commands, in process: expert, rule, idm, constant')


def _run_faults(options: argparse.Namespace) -> int:
    """The old spelling of `raw2drive evaluate faults`."""
    from raw2drive_ros.cli import evaluate_faults
    from raw2drive_ros.contracts.errors import UsageError

    warn_old('evaluate --faults PLANS', 'raw2drive evaluate faults --plans PLANS')
    others = (options.graph, options.blind, options.table, options.bench2drive_compat, options.quirks)
    if options.driver != 'raw' or any(others):
        raise UsageError('--faults is for driver raw, in process and with open eyes')
    options.plans = options.faults
    return evaluate_faults.run(options)
