"""raw2drive evaluate: closed-loop scores, in process or through the ROS graph."""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from raw2drive_ros.simulation.route_id import RouteId

EXAMPLES = """examples:
  raw2drive evaluate --driver raw --routes lane-following --seeds 20 --json
  raw2drive evaluate --driver rule --routes all --seeds 5 --weather HardRainNight
  raw2drive evaluate --driver expert --suite b2d220 --workers 2 --out runs/expert.jsonl
  raw2drive evaluate --driver rule --suite b2d220 --seeds 3 --out runs/rule.jsonl     three repetitions
  raw2drive evaluate --driver rule --suite dev10 --graph                              as ROS processes
  raw2drive evaluate --driver raw --faults matrix --seeds 3                           what if something breaks?
  raw2drive evaluate --driver privileged --run runs/stage1 --routes lane-following

Then compare: raw2drive report runs/expert.jsonl runs/rule.jsonl --out report.html

Seeds 0, 1, ... are evaluation routes, 50000, ... validation routes (choose checkpoints there); training
bags use seeds from 100000 on. Repetition 0 is the route as drawn; others start up to a metre, a few
decimetres and half a metre per second beside it, with other sensor noise."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        '--driver', default='raw', help='raw, privileged, expert, rule, idm, constant, straight or random'
    )
    parser.add_argument('--bundle', type=Path, help='policy bundle (default: the shipped one)')
    parser.add_argument(
        '--run', dest='training_run', type=Path, help='of driver privileged: run, checkpoint or teacher'
    )
    parser.add_argument('--routes', default='lane-following', help='scenario types, abilities, or all')
    parser.add_argument('--suite', help='a versioned list of routes instead of --routes, see raw2drive suite list')
    parser.add_argument('--ability', help='of the suite, only the types that count for this ability')
    parser.add_argument(
        '--seeds', type=int, help='--routes: routes per scenario type (20); --suite: repetitions of each route (1)'
    )
    parser.add_argument('--first-seed', type=int, default=0, help='--routes: seed of the first route')
    parser.add_argument('--weather', help="drive in this weather (default: the suite's own; --routes: ClearNoon)")
    parser.add_argument('--blind', action='store_true', help='black out every camera (how much do they matter?)')
    parser.add_argument(
        '--table',
        action='store_true',
        help="turn commands into the policy's 39 actions (what can be imitated at best?)",
    )
    parser.add_argument(
        '--faults', metavar='PLANS', help='of driver raw: drive under every plan of params/faults/PLANS.yaml or a file'
    )
    parser.add_argument('--quirks', action='store_true', help='efficiency and comfort as Bench2Drive computes them')
    parser.add_argument('--threads', type=int, default=1, help='torch threads')
    parser.add_argument('--workers', type=int, default=1, help='processes that drive at the same time')
    parser.add_argument('--graph', action='store_true', help='drive through the real ROS graph')
    parser.add_argument('--out', type=Path, help='per-route JSON lines; routes in it already are not driven again')
    parser.add_argument('--json', action='store_true', help='print the result as JSON')


def run(options: argparse.Namespace) -> int:
    import cv2

    from raw2drive_ros.cli.table import print_results
    from raw2drive_ros.evaluation.evaluate import Conditions, DriverSpec, evaluate, strips_of
    from raw2drive_ros.evaluation.metrics import RouteResult
    from raw2drive_ros.progress import bar
    from raw2drive_ros.report.strip import StripRecorder
    from raw2drive_ros.settings import default_bundle

    cv2.setNumThreads(1)
    suite, version, routes = _routes(options)
    if options.faults is not None:
        from raw2drive_ros.cli.fault_table import run_under_faults

        return run_under_faults(options, routes)
    bundle = options.bundle or default_bundle()
    spec = DriverSpec(options.driver, bundle, options.training_run, options.threads, options.blind, options.table)
    # Before any process starts or any file is written: can this driver be built at all?
    spec.build()
    strips = strips_of(options.out) if options.out else None
    conditions = Conditions(quirks=options.quirks, observe=StripRecorder if strips else None, strips=strips)
    with bar('evaluating', len(routes), 'routes') as advance:

        def on_route(done: int, result: RouteResult) -> None:
            advance(done, f'{result.id} {result.route_completion:.0f} %')

        if options.graph:
            from raw2drive_ros.cli.graph_drive import evaluate_graph

            result = evaluate_graph(spec, suite, version, routes, conditions, options.out, on_route)
        else:
            result = evaluate(spec, suite, version, routes, conditions, options.out, on_route, options.workers)
    if options.json:
        print(json.dumps(result))
    else:
        print_results(result)
    return 0


def _routes(options: argparse.Namespace) -> tuple[str, str, list[RouteId]]:
    """(suite, version, routes) from either --suite or --routes and --seeds. Raises UsageError."""
    from dataclasses import replace

    from raw2drive_ros.errors import UsageError
    from raw2drive_ros.evaluation.routes import SUITE_VERSION, routes_of
    from raw2drive_ros.evaluation.suites import load_suite
    from raw2drive_ros.simulation.scenario import load_scenarios
    from raw2drive_ros.simulation.weather import CLEAR, get_weather

    if options.workers < 1 or (options.seeds is not None and options.seeds < 1):
        raise UsageError('--workers and --seeds: give 1 or more')
    if options.graph and (options.workers > 1 or options.blind):
        raise UsageError('--graph drives one route after another, with open eyes: no --workers, no --blind')
    if options.table and (options.graph or options.driver in ('raw', 'privileged')):
        raise UsageError('--table is for drivers of continuous commands, in process: expert, rule, idm, constant')
    if options.faults is not None and (options.driver != 'raw' or options.graph or options.blind):
        raise UsageError('--faults is for driver raw, in process and with open eyes')
    if options.weather is not None:
        get_weather(options.weather)
    if options.suite is None:
        if options.ability is not None:
            raise UsageError('--ability goes with --suite; without one use --routes ABILITY')
        seeds = 20 if options.seeds is None else options.seeds
        return (
            options.routes,
            SUITE_VERSION,
            routes_of(options.routes, seeds, options.first_seed, options.weather or CLEAR),
        )
    suite = load_suite(options.suite)
    name, routes = suite.name, list(suite.routes)
    if options.ability is not None:
        known = load_scenarios()
        plain = options.ability.replace('-', '').lower()
        routes = [route for route in routes if plain in (a.lower() for a in known[route.type].abilities)]
        if not routes:
            names = ', '.join(sorted({a for s in known.values() for a in s.abilities}))
            raise UsageError(f'--ability {options.ability}: no such routes in {suite.name}; abilities: {names}')
        name = f'{suite.name}/{options.ability}'
    if options.weather is not None:
        routes = [replace(route, weather=options.weather) for route in routes]
        name = f'{name}/{options.weather}'
    return name, suite.version, [replace(r, repetition=i) for i in range(options.seeds or 1) for r in routes]
