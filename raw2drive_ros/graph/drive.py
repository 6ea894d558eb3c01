"""Drives routes through the real ROS graph, one process per node, in lock-step or real time; scores as in process."""

from __future__ import annotations

import json
import tempfile
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from raw2drive_ros.simulation.protocol import PAIRS

if TYPE_CHECKING:
    from raw2drive_ros.evaluation.driver_spec import DriverSpec
    from raw2drive_ros.evaluation.evaluate import Conditions
    from raw2drive_ros.evaluation.metrics import RouteResult
    from raw2drive_ros.graph.processes import Graph
    from raw2drive_ros.simulation.route_id import RouteId

OnRow = Callable[['RouteResult'], None]
OnProgress = Callable[[float, str], None]
POLL_S = 0.3


@dataclass(frozen=True, slots=True)
class GraphJob:
    """out: folder for everything. max_ticks: end each route after that; 0: never. bundle: of the planner; without one
    the bridge's `sim_driver` (of stage-1 run `run`) drives. record: to `out`/bag. faults: (file of plans, plan) for a
    fault injector between vehicle, planner and gate. limits_s: time limits of routes; the others have their scene's
    own. protocol: see `simulation.protocol`."""

    out: Path
    routes: tuple[RouteId, ...]
    bundle: Path | None = None
    sim_driver: str = ''
    run: Path | None = None
    real_time: bool = False
    image_size: tuple[int, int] = (96, 160)
    max_ticks: int = 0
    image_transport: str = 'raw'
    record: bool = True
    bench2drive_compat: bool = False
    faults: tuple[str, str] | None = None
    limits_s: Mapping[RouteId, float] = field(default_factory=dict)
    protocol: str = PAIRS


def drive_graph(
    job: GraphJob,
    domain: int,
    on_progress: OnProgress = lambda done, note: None,
    on_row: OnRow = lambda row: None,
) -> tuple[list[RouteResult], dict[str, Any]]:
    """Start the nodes, wait for the bridge to finish, end them: (rows, timing).

    on_progress: percent of all routes, and a note. on_row: each row as soon as its route is driven.
    Raises GraphError when any process dies, ResultsError for a malformed row.
    """
    from raw2drive_ros.evaluation.results import result_from_row
    from raw2drive_ros.graph.processes import running_graph

    out = job.out
    with running_graph(out / 'logs', domain) as graph:
        _start(graph, job)
        _wait(graph, out, len(job.routes), on_progress, on_row)
        # The planner and the recorder first write their statistics; then the rest may end.
        graph.end(order=('planner', 'recorder'))
    driven = json.loads((out / 'bridge.json').read_text())
    rows = [result_from_row(row, f'{out / "bridge.json"}: row {n}') for n, row in enumerate(driven['routes'], 1)]
    timing: dict[str, Any] = driven['timing']
    if job.bundle is not None:
        planned = json.loads((out / 'planner.json').read_text())
        timing['planner_ms'] = planned['planner_ms']
        timing['messages_lost'] += planned['messages_lost']
    if job.record:
        timing['messages_lost'] += json.loads((out / 'recorder.json').read_text())['messages_lost']
    return rows, timing


def _start(graph: Graph, job: GraphJob) -> None:
    from raw2drive_ros.contracts import topics
    from raw2drive_ros.evaluation.suites import limits_text
    from raw2drive_ros.faults.plan import load_plans, remapping

    out, routes = job.out, ','.join(map(str, job.routes))
    if job.record:
        bundle = job.bundle.name if job.bundle else ''
        provenance = json.dumps({'driver': job.sim_driver or 'raw', 'bundle': bundle, 'routes': routes})
        recorder = {'bag': str(out / 'bag'), 'provenance': provenance, 'stats_file': str(out / 'recorder.json')}
        graph.start('recorder', recorder)
    faults = []
    if job.faults is not None:
        file, plan = job.faults
        graph.start('fault_injector', {'plans': file, 'plan': plan})
        faults = load_plans(file).plans[plan]
    heard = remapping(faults, (topics.PROPOSED, topics.ODOMETRY))
    gate = {'clock': 'steady' if job.real_time else 'ros', 'simulated': True}
    graph.start('safety_gate', gate, remap=heard)
    if job.bundle is not None:
        planner = {'bundle': str(job.bundle.resolve()), 'stats_file': str(out / 'planner.json')}
        heard = remapping(faults, topics.SENSOR_TOPICS)
        graph.start('planner', planner | {'image_transport': job.image_transport}, remap=heard)
    bridge = {
        'episodes': routes,
        'time_limits': limits_text({route: s for route, s in job.limits_s.items() if route in job.routes}),
        'sim_driver': job.sim_driver,
        'sim_driver_run': str(job.run.resolve()) if job.run else '',
        'bench2drive_compat': job.bench2drive_compat,
        'protocol': job.protocol,
        'lock_step': not job.real_time,
        'image_height': job.image_size[0],
        'image_width': job.image_size[1],
        'image_transport': job.image_transport,
        'bev': job.record or job.sim_driver == 'privileged',
        'max_ticks': job.max_ticks,
        'wait_for_sensor_subscribers': 1 + job.record,
        'result_file': str(out / 'bridge.json'),
        'rows_file': str(out / 'rows.jsonl'),
        'progress_file': str(out / 'progress.jsonl'),
    }
    graph.start('bridge', bridge, sim_time=False, remap=remapping(faults, (topics.COMMAND,)))


def _wait(graph: Graph, out: Path, count: int, on_progress: OnProgress, on_row: OnRow) -> None:
    """Wait until the bridge has finished. Raises GraphError when any process dies, ResultsError for a malformed row."""
    from raw2drive_ros.evaluation.results import result_from_line

    progress, rows = Tail(out / 'progress.jsonl'), Tail(out / 'rows.jsonl')
    running = True
    while running:
        running = not graph.ended('bridge')
        graph.check(may_end=('bridge',))
        for number, line in rows.lines():
            on_row(result_from_line(line, f'{rows.path}: line {number}'))
        for state in progress.new()[-1:]:
            done = state['index'] + (1.0 if state['done'] else state['completion'] / 100.0)
            on_progress(100.0 * done / count, f'{state["episode"]} {state["ticks_per_s"]} ticks/s')
        if running:
            time.sleep(POLL_S)
    on_progress(100.0, '')


class Tail:
    """JSON lines that another process appends."""

    def __init__(self, path: Path) -> None:
        self.path, self.read, self.count = path, 0, 0

    def new(self) -> list[dict[str, Any]]:
        """The records of `lines`."""
        return [json.loads(line) for _, line in self.lines()]

    def lines(self) -> list[tuple[int, bytes]]:
        """Whole lines since the last call, each with its number in the file, from 1 on."""
        if not self.path.exists():
            return []
        with self.path.open('rb') as file:
            file.seek(self.read)
            data = file.read()
        whole = data[: data.rfind(b'\n') + 1]
        self.read += len(whole)
        found = list(enumerate(whole.splitlines(), self.count + 1))
        self.count += len(found)
        return found


def evaluate_graph(
    spec: DriverSpec,
    suite: str,
    version: str,
    routes: Sequence[RouteId],
    conditions: Conditions,
    lines: Path | None,
    on_route: Callable[[int, RouteResult], None],
) -> dict[str, Any]:
    """`evaluate`, but through the graph: the raw driver in the planner node, others as the bridge's sim driver."""
    from raw2drive_ros.evaluation.evaluate import conditions_header, interruptible
    from raw2drive_ros.evaluation.results import RowsFile
    from raw2drive_ros.evaluation.statistics import summarise, timing_of
    from raw2drive_ros.graph.processes import reserve_domain

    file = RowsFile(lines, conditions_header(spec, suite, version, routes, conditions))
    left = tuple(route for route in routes if route not in file.rows)
    timing = timing_of([])

    def on_row(result: RouteResult) -> None:
        row = conditions.with_reference(result)
        file.add(row)
        on_route(len(file.rows), row)

    if left:
        raw = spec.name == 'raw'
        with tempfile.TemporaryDirectory(prefix='raw2drive_') as folder, reserve_domain(None) as domain:
            job = GraphJob(
                Path(folder),
                left,
                spec.bundle if raw else None,
                '' if raw else spec.name,
                None if raw else spec.run,
                image_size=conditions.image_size,
                record=False,
                bench2drive_compat=conditions.bench2drive_compat,
                limits_s=conditions.limits_s,
                protocol=conditions.protocol,
            )
            with interruptible(spec.name, suite, version, file, [], conditions.protocol):
                timing = drive_graph(job, domain, on_row=on_row)[1]
    return summarise(spec.name, suite, version, routes, list(file.rows.values()), timing, conditions.protocol)
