"""Runs whole graphs in lock-step for hours and samples them periodically, for `raw2drive soak`.

Bridge (all routes of a suite, again and again), planner, gate, and a recorder that keeps the last seconds in memory.
The samples are evaluated in `evaluation.soak`.
"""

from __future__ import annotations

import shutil
import time
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path

from raw2drive_ros.driving.bundle import load_bundle
from raw2drive_ros.evaluation.soak import Sample, append_sample
from raw2drive_ros.evaluation.suites import load_suite
from raw2drive_ros.graph.drive import Tail
from raw2drive_ros.graph.process_samples import folder_mib, process_values
from raw2drive_ros.graph.processes import Graph, reserve_domain, running_graph
from raw2drive_ros.tables.rates import DECISION_HZ

SNAPSHOT_S = 5.0
KEPT_SNAPSHOTS = 3
POLL_S = 0.5
SAMPLES = 'samples.jsonl'


@dataclass(frozen=True, slots=True)
class SoakPlan:
    """out: folder of `SAMPLES` and of a folder per graph. graphs: number that run in parallel and share the hours, each
    as a part, numbered from `first_part`. domain: None for the first free one."""

    out: Path
    suite: str
    bundle: Path
    first_part: int = 1
    graphs: int = 1
    sample_every_s: float = 20.0
    domain: int | None = None


def soak(plan: SoakPlan, hours: float, on_progress: Callable[[float, str], None]) -> None:
    """Start the graphs and sample them until they have driven `hours` (simulated) together, then end them.

    on_progress: simulated seconds so far, and a note. Raises GraphError when a process ends.
    """
    wanted_s = hours * 3600.0
    with ExitStack() as stack:
        parts = []
        for number in range(plan.first_part, plan.first_part + plan.graphs):
            folder = plan.out / f'part_{number:02d}'
            domain = stack.enter_context(reserve_domain(plan.domain))
            parts.append(_Part(number, folder, stack.enter_context(running_graph(folder / 'logs', domain))))
            _start(parts[-1].graph, folder, plan)
        due, driven_s = 0.0, 0.0
        while driven_s < wanted_s:
            time.sleep(POLL_S)
            for each in parts:
                each.follow()
            driven_s = sum(each.simulated_s for each in parts)
            if time.monotonic() >= due or driven_s >= wanted_s:
                due = time.monotonic() + plan.sample_every_s
                for each in parts:
                    each.sample(plan.out / SAMPLES)
                notes = (f'{each.episodes} episodes, {each.ticks_per_s} ticks/s' for each in parts)
                on_progress(min(driven_s, wanted_s), '; '.join(notes))


class _Part:
    """A graph, how far its bridge has driven, and the resource usage of its processes."""

    def __init__(self, number: int, folder: Path, graph: Graph) -> None:
        self.number, self.folder, self.graph = number, folder, graph
        self.progress, self.started = Tail(folder / 'progress.jsonl'), time.monotonic()
        self.driven_ticks, self.episodes, self.simulated_s, self.ticks_per_s = 0, 0, 0.0, 0.0

    def follow(self) -> None:
        """Read the bridge's new progress lines. Raises GraphError when a process has ended."""
        self.graph.check()
        for state in self.progress.new():
            self.ticks_per_s = state['ticks_per_s']
            self.simulated_s = (self.driven_ticks + state['ticks']) / DECISION_HZ
            if state['done']:
                self.episodes, self.driven_ticks = self.episodes + 1, self.driven_ticks + state['ticks']

    def sample(self, file: Path) -> None:
        """Append the current resource usage of the graph's processes."""
        _drop_old(self.folder / 'snapshots')
        values = {'graph/logs_mib': folder_mib(self.folder / 'logs')}
        for name, process in self.graph.processes.items():
            values |= process_values(name, process.pid)
        wall_s = time.monotonic() - self.started
        append_sample(file, Sample(self.number, self.simulated_s, wall_s, self.episodes, values))


def _start(graph: Graph, folder: Path, plan: SoakPlan) -> None:
    rig = load_bundle(plan.bundle).rig
    graph.start('recorder', {'bag': str(folder / 'snapshots'), 'snapshot_s': SNAPSHOT_S})
    graph.start('safety_gate', {'clock': 'ros', 'simulated': True})
    graph.start('planner', {'bundle': str(plan.bundle)})
    bridge = {
        'episodes': ','.join(map(str, load_suite(plan.suite).routes)),
        'loop': True,
        'image_height': rig[0].height,
        'image_width': rig[0].width,
        'wait_for_sensor_subscribers': 2,
        'rows_file': str(folder / 'rows.jsonl'),
        'progress_file': str(folder / 'progress.jsonl'),
    }
    graph.start('bridge', bridge, sim_time=False)


def _drop_old(snapshots: Path) -> None:
    """Delete old snapshots: every stop of the gate makes a bag of some 50 MB, and these are not what is tested here."""
    for bag in sorted(snapshots.glob('snapshot_*'), key=lambda path: int(path.name.split('_')[-1]))[:-KEPT_SNAPSHOTS]:
        shutil.rmtree(bag, ignore_errors=True)
