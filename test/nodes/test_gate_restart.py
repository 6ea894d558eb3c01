"""A gate that is killed, by whatever, leaves a stop for the one that is started after it."""

import json
import re
import signal
import subprocess
import sys
from pathlib import Path

from raw2drive_ros.graph.processes import Graph, reserve_domain, running_graph
from raw2drive_ros.nodes.latch_file import LatchFile
from raw2drive_ros.runtime_folder import runtime_folder

PROBE = Path(__file__).with_name('gate_probe.py')
ROOT = PROBE.parents[2]


def probe(graph: Graph, *arguments: str):
    done = subprocess.run(
        [sys.executable, str(PROBE), *arguments],
        cwd=ROOT,
        env=graph.environment,
        capture_output=True,
        text=True,
        timeout=60,
    )
    assert done.returncode == 0, done.stderr[-2000:]
    return json.loads(done.stdout.splitlines()[-1])


def restart(graph: Graph, number: int) -> None:
    process = graph.processes['safety_gate']
    process.send_signal(number)
    process.wait(20)
    graph.start('safety_gate', {}, sim_time=False)


def test_a_stop_outlives_the_gate(tmp_path) -> None:
    with reserve_domain(None) as domain, running_graph(tmp_path, domain) as graph:
        graph.start('safety_gate', {}, sim_time=False)
        assert probe(graph, '1.5') == [None, 0.4], 'a car that stands may be driven'
        restart(graph, signal.SIGKILL)
        assert probe(graph, '1.5') == [None, 0.0]
        said = (tmp_path / 'safety_gate.log').read_text()
        # It was killed while it drove, or after it had noticed that the planner fell silent.
        assert re.search(
            'emergency_stop: stopped before this gate was started: (the gate before|no valid proposal)', said
        )
        restart(graph, signal.SIGKILL)
        assert probe(graph, '1.5', 'activate') == [True, 0.4]
        graph.check()


def test_the_file_keeps_the_last_reason_until_it_is_cleared(tmp_path, monkeypatch) -> None:
    monkeypatch.setenv('XDG_RUNTIME_DIR', str(tmp_path))
    latch = LatchFile(7, '/car1/safety_gate')
    assert latch.read() == ''
    latch.write('the first')
    latch.write('x' * 1000)
    assert LatchFile(7, '/car1/safety_gate').read() == 'x' * 500
    assert LatchFile(7, '/car2/safety_gate').read() == ''
    assert latch.path.parent == runtime_folder()
    latch.clear()
    latch.clear()
    assert latch.read() == ''
    latch.path.mkdir()
    assert latch.read().startswith('unknown ('), 'what cannot be read is a stop'
    latch.path.rmdir()
    latch.path.write_text('')
    assert latch.read() == 'unknown'
