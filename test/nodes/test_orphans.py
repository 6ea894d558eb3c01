"""However a command that started nodes ends, its nodes end with it, and a recorder among them closes its bag."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import psutil
import pytest

from raw2drive_ros.graph.processes import reserve_domain

ROOT = Path(__file__).resolve().parents[2]


def not_under_nohup() -> None:
    """Restore the default of SIGHUP: the command would inherit that it is ignored where the tests run under nohup."""
    signal.signal(signal.SIGHUP, signal.SIG_DFL)


@pytest.mark.parametrize('number', [signal.SIGHUP, signal.SIGKILL])
def test_nodes_end_with_the_command_that_started_them(tmp_path, number) -> None:
    bag = tmp_path / 'bag'
    with reserve_domain(None) as domain:
        command = [sys.executable, '-m', 'raw2drive_ros.cli.main', 'record', '--out', str(bag), '--domain', str(domain)]
        record = subprocess.Popen(command, cwd=ROOT, stderr=subprocess.DEVNULL, preexec_fn=not_under_nohup)
        deadline = time.monotonic() + 60.0
        while not list(tmp_path.rglob('*.mcap')):
            assert time.monotonic() < deadline
            time.sleep(0.2)
        nodes = psutil.Process(record.pid).children(recursive=True)
        assert nodes
        os.kill(record.pid, number)
        record.wait(30.0)
        assert psutil.wait_procs(nodes, timeout=30.0)[1] == []
    assert (bag / 'metadata.yaml').is_file()
