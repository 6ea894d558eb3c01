"""raw2drive demo: the whole graph as separate processes, three routes, a bag, a video and a report."""

from __future__ import annotations

import argparse
import json
import shutil
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

EXAMPLES = """examples:
  raw2drive demo
  raw2drive demo --routes LaneFollowing/3,LaneFollowing/7 --out runs/my_demo
  raw2drive demo --real-time --domain 12"""

DEFAULT_ROUTES = 'LaneFollowing/1,LaneFollowing/3,JunctionTurns/1'


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument('--routes', default=DEFAULT_ROUTES, help='comma list of scenario/seed')
    parser.add_argument('--bundle', type=Path, help='policy bundle (default: the shipped one)')
    parser.add_argument('--out', type=Path, default=Path('runs/demo'), help='folder for everything that is made')
    parser.add_argument('--domain', type=int, help='ROS domain (default: the first free one from 50 on)')
    parser.add_argument('--image-transport', choices=('raw', 'compressed'), default='raw', help='image topics in use')
    parser.add_argument('--real-time', action='store_true', help='follow the wall clock instead of lock-step')
    parser.add_argument('--no-video', action='store_true', help='skip MP4 and pictures')
    parser.add_argument('--json', action='store_true', help='print the result as JSON')


def run(options: argparse.Namespace) -> int:
    from raw2drive_ros.cli.graph import reserve_domain
    from raw2drive_ros.cli.table import print_results
    from raw2drive_ros.paths import default_bundle
    from raw2drive_ros.recording.bag_writer import require_space
    from raw2drive_ros.simulation.scenario import get_scenario

    bundle = options.bundle or default_bundle()
    if not (bundle / 'bundle.json').is_file():
        from raw2drive_ros.driving.bundle import load_bundle

        load_bundle(bundle)
    for part in options.routes.split(','):
        get_scenario(part.partition('/')[0].strip())
    require_space(options.out)
    _clear(options.out)
    job = GraphJob(options.out, options.routes, options.real_time, image_transport=options.image_transport)
    with reserve_domain(options.domain) as domain:
        result = drive_graph(job, bundle.resolve(), domain)
    made = {'result': options.out / 'result.json', 'bag': options.out / 'bag'}
    if not options.no_video:
        made |= _pictures(options.out, bundle, result)
    (options.out / 'result.json').write_text(json.dumps(result, indent=2) + '\n')
    if options.json:
        print(json.dumps(result))
    else:
        print_results(result)
        for name, path in made.items():
            print(f'{name}: {path}')
    return 0


def _clear(out: Path) -> None:
    """Remove what an earlier demo made, and nothing else."""
    for name in ('bag', '.bag.partial', 'logs'):
        shutil.rmtree(out / name, ignore_errors=True)
    for name in (
        'result.json',
        'drive.mp4',
        'report.html',
        'progress.jsonl',
        'bridge.json',
        'planner.json',
        'recorder.json',
    ):
        (out / name).unlink(missing_ok=True)
    out.mkdir(parents=True, exist_ok=True)


@dataclass(frozen=True, slots=True)
class GraphJob:
    """out: folder for everything. routes: comma list of scenario/seed. max_ticks: cut each route, 0 = never."""

    out: Path
    routes: str
    real_time: bool = False
    image_size: tuple[int, int] = (96, 160)
    max_ticks: int = 0
    image_transport: str = 'raw'


def drive_graph(job: GraphJob, bundle: Path, domain: int) -> dict[str, Any]:
    """Start recorder, gate, planner and bridge, wait for the bridge to finish, end them; the result."""
    from raw2drive_ros.cli.graph import running_graph
    from raw2drive_ros.evaluation.metrics import RouteResult, summarise
    from raw2drive_ros.evaluation.routes import SUITE_VERSION

    out = job.out
    provenance = json.dumps({'driver': 'raw', 'bundle': bundle.name, 'routes': job.routes})
    with running_graph(out / 'logs', domain) as graph:
        recorder = {'bag': str(out / 'bag'), 'provenance': provenance, 'stats_file': str(out / 'recorder.json')}
        graph.start('recorder', recorder)
        graph.start('safety_gate', {'clock': 'steady' if job.real_time else 'ros'})
        planner = {'bundle': str(bundle), 'stats_file': str(out / 'planner.json')}
        graph.start('planner', planner | {'image_transport': job.image_transport})
        bridge = {
            'episodes': job.routes,
            'lock_step': not job.real_time,
            'image_height': job.image_size[0],
            'image_width': job.image_size[1],
            'image_transport': job.image_transport,
            'max_ticks': job.max_ticks,
            'wait_for_image_subscribers': 2,
            'result_file': str(out / 'bridge.json'),
            'progress_file': str(out / 'progress.jsonl'),
        }
        graph.start('bridge', bridge, sim_time=False)
        _wait(graph, out, len(job.routes.split(',')))
        # The planner and the recorder first write their figures, then the rest may go.
        graph.end(order=('planner', 'recorder'))
    driven, planned, recorded = (json.loads((out / f'{n}.json').read_text()) for n in ('bridge', 'planner', 'recorder'))
    timing = driven['timing']
    timing['planner_ms'] = planned['planner_ms']
    timing['messages_lost'] += planned['messages_lost'] + recorded['messages_lost']
    routes = [RouteResult(**row) for row in driven['routes']]
    return summarise('raw', job.routes, SUITE_VERSION, routes, timing)


def _wait(graph: Any, out: Path, count: int) -> None:
    """Show progress until the bridge has finished. Raises GraphError when any process dies."""
    from raw2drive_ros.cli.progress import bar

    progress = out / 'progress.jsonl'
    with bar('driving', 100.0 * count, '%') as advance:
        while not graph.ended('bridge'):
            graph.check(may_end=('bridge',))
            if progress.exists():
                lines = progress.read_text().splitlines()
                if lines:
                    _show(advance, lines[-1])
            time.sleep(0.3)
        graph.check(may_end=('bridge',))
        advance(100.0 * count)


def _show(advance: Any, line: str) -> None:
    try:
        state = json.loads(line)
    except ValueError:
        return
    done = 100.0 * state['index'] + (100.0 if state['done'] else state['completion'])
    advance(done, f'{state["episode"]} {state["ticks_per_s"]} ticks/s')


def _pictures(out: Path, bundle: Path, result: dict[str, Any]) -> dict[str, Path]:
    from raw2drive_ros.cli.progress import bar
    from raw2drive_ros.report.html import write_report
    from raw2drive_ros.report.video import write_video

    with bar('rendering video', 1.0, '') as advance:
        video = write_video(out / 'bag', bundle, out / 'drive.mp4', advance)
    report = write_report(out / 'report.html', result, video)
    return {'video': video.path, 'report': report}
