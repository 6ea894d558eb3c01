"""raw2drive demo: the whole graph as separate processes, three routes, a bag, a video and a report."""

from __future__ import annotations

import argparse
import json
import shutil
from pathlib import Path
from typing import Any

from raw2drive_ros.cli.domain_option import add_domain_argument
from raw2drive_ros.cli.graph_options import add_network_argument
from raw2drive_ros.cli.parser import note, refuse

EXAMPLES = """examples:
  raw2drive demo
  raw2drive demo --routes LaneFollowing/3,LaneFollowing/7 --out runs/my_demo
  raw2drive demo --real-time --domain 12
  raw2drive demo --fault 'camera frozen' --routes LaneFollowing/1     what the whole graph does about it"""

DEFAULT_ROUTES = 'LaneFollowing/1,LaneFollowing/3,JunctionTurns/1'


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add_network_argument(parser)
    parser.add_argument('--routes', default=DEFAULT_ROUTES, help='comma list of TYPE/SEED or TYPE/SEED/WEATHER')
    parser.add_argument('--bundle', type=Path, help='policy bundle (default: the shipped one)')
    parser.add_argument('--out', type=Path, default=Path('runs/demo'), help='folder for everything that is made')
    add_domain_argument(parser, free=True)
    parser.add_argument('--image-transport', choices=('raw', 'compressed'), default='raw', help='image topics in use')
    parser.add_argument('--real-time', action='store_true', help='follow the wall clock instead of lock-step')
    parser.add_argument(
        '--fault', metavar='PLAN', help='a plan of faults between all nodes, see raw2drive faults list (real time)'
    )
    parser.add_argument(
        '--fault-plans', default='matrix', metavar='PLANS', help='name or YAML file that holds the plan'
    )
    parser.add_argument('--no-video', action='store_true', help='skip MP4 and pictures')
    parser.add_argument('--json', action='store_true', help='print the result as JSON')


def run(options: argparse.Namespace) -> int:
    from raw2drive_ros.cli.table import print_events, print_results
    from raw2drive_ros.driving.bundle import load_bundle
    from raw2drive_ros.evaluation.routes import SUITE_VERSION
    from raw2drive_ros.evaluation.statistics import summarise
    from raw2drive_ros.graph.drive import GraphJob, drive_graph
    from raw2drive_ros.graph.processes import reserve_domain
    from raw2drive_ros.progress import bar
    from raw2drive_ros.recording.bag_writer import require_space
    from raw2drive_ros.recording.events import events_of
    from raw2drive_ros.settings import default_bundle
    from raw2drive_ros.simulation.route_id import RouteId
    from raw2drive_ros.simulation.scenario import get_scenario

    # Whatever the user may have got wrong is found before anything of an earlier demo is removed.
    routes = tuple(RouteId.parse(part) for part in options.routes.split(','))
    for route in routes:
        get_scenario(route.type)
    faults = _faults(options)
    require_space(options.out)
    bundle = options.bundle or default_bundle()
    load_bundle(bundle)
    real_time = options.real_time or faults is not None
    job = GraphJob(
        options.out, routes, bundle, real_time=real_time, image_transport=options.image_transport, faults=faults
    )
    with reserve_domain(options.domain) as domain:
        _clear(options.out)
        note(f'driving in ROS domain {domain}')
        with bar('driving', 100.0, '%') as advance:
            rows, timing = drive_graph(job, domain, advance)
    result = summarise('raw', options.routes, SUITE_VERSION, routes, rows, timing)
    made = {'result': options.out / 'result.json', 'bag': options.out / 'bag'}
    if not options.no_video:
        made |= _pictures(options.out, bundle, result)
    (options.out / 'result.json').write_text(json.dumps(result, indent=2) + '\n')
    if options.json:
        print(json.dumps(result))
    else:
        print_results(result)
        if faults is not None:
            print(f'what happened ({options.fault}; raw2drive bag events {options.out / "bag"}):')
            print_events(events_of(options.out / 'bag'))
        for name, path in made.items():
            print(f'{name}: {path}')
    return 0


def _faults(options: argparse.Namespace) -> tuple[str, str] | None:
    """Raises ConfigError or UsageError before any process starts."""
    from raw2drive_ros.contracts.errors import UsageError
    from raw2drive_ros.faults.plan import load_plan

    if options.fault is None:
        refuse(options, ['fault_plans'], 'goes with --fault PLAN')
        return None
    if options.image_transport == 'compressed':
        raise UsageError('--fault goes with raw images')
    load_plan(options.fault_plans, options.fault)
    return options.fault_plans, options.fault


def _clear(out: Path) -> None:
    """Remove what an earlier demo made, and nothing else."""
    for name in ('bag', '.bag.partial', 'logs'):
        shutil.rmtree(out / name, ignore_errors=True)
    for name in (
        'result.json',
        'drive.mp4',
        'report.html',
        'progress.jsonl',
        'rows.jsonl',
        'bridge.json',
        'planner.json',
        'recorder.json',
    ):
        (out / name).unlink(missing_ok=True)
    out.mkdir(parents=True, exist_ok=True)


def _pictures(out: Path, bundle: Path, result: dict[str, Any]) -> dict[str, Path]:
    from raw2drive_ros.progress import bar
    from raw2drive_ros.report.html import write_report
    from raw2drive_ros.report.video import write_video

    with bar('rendering video', 1.0, '') as advance:
        video = write_video(out / 'bag', bundle, out / 'drive.mp4', advance)
    report = write_report(out / 'report.html', result, video)
    return {'video': video.path, 'report': report}
