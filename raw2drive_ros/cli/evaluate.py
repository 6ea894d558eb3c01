"""raw2drive evaluate: closed-loop scores, in process."""

from __future__ import annotations

import argparse
import json
from pathlib import Path

EXAMPLES = """examples:
  raw2drive evaluate --driver raw --routes lane-following --seeds 20 --json
  raw2drive evaluate --driver rule --routes all --seeds 5
  raw2drive evaluate --driver expert --suite b2d220 --workers 2 --out runs/expert.jsonl
  raw2drive evaluate --driver privileged --run runs/stage1 --routes lane-following

Seeds 0, 1, ... are evaluation routes, 50000, ... validation routes (choose checkpoints there); training
bags use seeds from 100000 on."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        '--driver', default='raw', help='raw, privileged, expert, rule, idm, constant, straight or random'
    )
    parser.add_argument('--bundle', type=Path, help='policy bundle (default: the shipped one)')
    parser.add_argument('--run', dest='training_run', type=Path, help='stage-1 run of driver privileged')
    parser.add_argument('--routes', default='lane-following', help='scenario types, abilities, or all')
    parser.add_argument('--suite', help='a versioned list of routes instead of --routes, see raw2drive suite list')
    parser.add_argument('--ability', help='of the suite, only the types that count for this ability')
    parser.add_argument('--seeds', type=int, default=20, help='routes per scenario type')
    parser.add_argument('--first-seed', type=int, default=0, help='seed of the first route')
    parser.add_argument('--blind', action='store_true', help='black out every camera (how much do they matter?)')
    parser.add_argument('--threads', type=int, default=1, help='torch threads')
    parser.add_argument('--workers', type=int, default=1, help='processes that drive at the same time')
    parser.add_argument('--out', type=Path, help='per-route JSON lines; routes in it already are not driven again')
    parser.add_argument('--json', action='store_true', help='print the result as JSON')


def run(options: argparse.Namespace) -> int:
    import cv2

    from raw2drive_ros.cli.progress import bar
    from raw2drive_ros.cli.table import print_results
    from raw2drive_ros.evaluation.evaluate import DriverSpec, evaluate
    from raw2drive_ros.evaluation.metrics import RouteResult
    from raw2drive_ros.paths import default_bundle

    cv2.setNumThreads(1)
    suite, version, routes = _routes(options)
    bundle = options.bundle or default_bundle()
    spec = DriverSpec(options.driver, bundle, options.training_run, options.threads, options.blind)
    # Before any process starts or any file is written: can this driver be built at all?
    spec.build()
    with bar('evaluating', len(routes), 'routes') as advance:

        def on_route(done: int, result: RouteResult) -> None:
            advance(done, f'{result.id} {result.route_completion:.0f} %')

        result = evaluate(spec, suite, version, routes, lines=options.out, on_route=on_route, workers=options.workers)
    if options.json:
        print(json.dumps(result))
    else:
        print_results(result)
    return 0


def _routes(options: argparse.Namespace) -> tuple[str, str, list[tuple[str, int]]]:
    """(suite, version, routes) from either --suite or --routes and --seeds. Raises UsageError."""
    from raw2drive_ros.cli.errors import UsageError
    from raw2drive_ros.evaluation.routes import SUITE_VERSION, routes_of
    from raw2drive_ros.evaluation.suites import load_suite
    from raw2drive_ros.simulation.scenario import load_scenarios

    if options.workers < 1 or options.seeds < 1:
        raise UsageError('--workers and --seeds: give 1 or more')
    if options.suite is None:
        if options.ability is not None:
            raise UsageError('--ability goes with --suite; without one use --routes ABILITY')
        return options.routes, SUITE_VERSION, routes_of(options.routes, options.seeds, options.first_seed)
    suite = load_suite(options.suite)
    routes = list(suite.routes)
    if options.ability is None:
        return suite.name, suite.version, routes
    known = load_scenarios()
    plain = options.ability.replace('-', '').lower()
    routes = [(kind, seed) for kind, seed in routes if plain in (a.lower() for a in known[kind].abilities)]
    if not routes:
        names = ', '.join(sorted({a for s in known.values() for a in s.abilities}))
        raise UsageError(f'--ability {options.ability}: no such routes in {suite.name}; abilities: {names}')
    return f'{suite.name}/{options.ability}', suite.version, routes
