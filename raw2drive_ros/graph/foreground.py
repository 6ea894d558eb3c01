"""Run a few nodes in the foreground until Ctrl-C, SIGTERM, or the end of one of them."""

from __future__ import annotations

import sys
import tempfile
import time
from pathlib import Path
from typing import Any

from raw2drive_ros.contracts.errors import GraphError
from raw2drive_ros.graph.processes import END_WITHIN_S, running_graph

# Enough for a comfortable and then an emergency stop of the gate from 30 m/s, with the shipped brakes.
SURVIVES_S = 8.0


def run_single(
    nodes: dict[str, dict[str, Any]],
    domain: int,
    *,
    namespace: str = '',
    sim_time: bool = True,
    end_within_s: float = END_WITHIN_S,
    survivor: str = '',
) -> int:
    """Start each node with its parameters, pass their log lines on, and end them all together.

    namespace: see `Graph`. survivor: a node that runs on for SURVIVES_S after another one has died, such as the gate to
    stop the car.
    """
    with (
        tempfile.TemporaryDirectory(prefix='raw2drive_') as folder,
        running_graph(Path(folder), domain, namespace) as graph,
    ):
        for name, parameters in nodes.items():
            graph.start(name, parameters, sim_time=sim_time, end_within_s=end_within_s)
        place = f' as {namespace}' if namespace else ''
        print(f'{", ".join(nodes)} running in ROS domain {domain}{place}; Ctrl-C ends', file=sys.stderr)
        offsets = dict.fromkeys(nodes, 0)
        while True:
            # Before the logs are read, so that the last lines of an ended process are read too.
            done = [name for name in nodes if graph.ended(name)]
            for name in nodes:
                offsets[name] = _follow(Path(folder) / f'{name}.log', offsets[name])
            if done:
                if survivor and survivor not in done:
                    print(f'{graph.how_it_ended(done[0])}; {survivor} goes on for {SURVIVES_S:.0f} s', file=sys.stderr)
                    _follow_for(Path(folder) / f'{survivor}.log', offsets[survivor], SURVIVES_S)
                code = graph.processes[done[0]].returncode
                # Its last log lines are on the terminal already.
                if code > 0:
                    raise GraphError(f'{done[0]} ended with code {code}')
                if code < 0:
                    raise GraphError(graph.how_it_ended(done[0]))
                return 0
            time.sleep(0.2)


def _follow_for(path: Path, offset: int, seconds: float) -> None:
    deadline = time.monotonic() + seconds
    while time.monotonic() < deadline:
        offset = _follow(path, offset)
        time.sleep(0.2)


def _follow(path: Path, offset: int) -> int:
    with path.open(errors='replace') as file:
        file.seek(offset)
        text = file.read()
        if text:
            sys.stderr.write(text)
        return file.tell()
