"""raw2drive evaluate: closed-loop scores, in process."""

from __future__ import annotations

import argparse
import json
from pathlib import Path

EXAMPLES = """examples:
  raw2drive evaluate --driver raw --routes lane-following --seeds 20 --json
  raw2drive evaluate --driver rule --routes all --seeds 5
  raw2drive evaluate --driver privileged --run runs/stage1 --routes lane-following

Seeds 0, 1, ... are evaluation routes; training bags use seeds from 100000 on."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument('--driver', default='raw', help='raw, privileged, expert, rule, straight or random')
    parser.add_argument('--bundle', type=Path, help='policy bundle (default: the shipped one)')
    parser.add_argument('--run', dest='training_run', type=Path, help='stage-1 run of driver privileged')
    parser.add_argument('--routes', default='lane-following', help='scenario types, abilities, or all')
    parser.add_argument('--seeds', type=int, default=20, help='routes per scenario type')
    parser.add_argument('--first-seed', type=int, default=0, help='seed of the first route')
    parser.add_argument('--blind', action='store_true', help='black out every camera (how much do they matter?)')
    parser.add_argument('--threads', type=int, default=1, help='torch threads')
    parser.add_argument('--out', type=Path, help='also write per-route JSON lines here')
    parser.add_argument('--json', action='store_true', help='print the result as JSON')


def run(options: argparse.Namespace) -> int:
    import cv2

    from raw2drive_ros.cli.progress import bar
    from raw2drive_ros.cli.table import print_results
    from raw2drive_ros.evaluation.drivers import Blindfold, make_driver
    from raw2drive_ros.evaluation.evaluate import evaluate
    from raw2drive_ros.evaluation.metrics import RouteResult
    from raw2drive_ros.evaluation.routes import routes_of
    from raw2drive_ros.paths import default_bundle

    cv2.setNumThreads(1)
    routes = routes_of(options.routes, options.seeds, options.first_seed)
    bundle = options.bundle or default_bundle()
    driver = make_driver(options.driver, bundle, options.training_run, 0.0, options.threads)
    if options.blind:
        driver = Blindfold(driver)
    with bar('evaluating', len(routes), 'routes') as advance:

        def on_route(index: int, result: RouteResult) -> None:
            advance(index + 1, f'{result.id} {result.route_completion:.0f} %')

        result = evaluate(options.driver, driver, options.routes, routes, lines=options.out, on_route=on_route)
    if options.json:
        print(json.dumps(result))
    else:
        print_results(result)
    return 0
