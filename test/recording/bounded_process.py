"""Runs the command line in a process with a limit of memory and time, as a hostile file may not exceed them."""

import os
import resource
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
MEMORY_BYTES = 2**30
SECONDS = 10


def run_bounded(
    *arguments: object, code: str = '', memory_bytes: int = MEMORY_BYTES
) -> tuple[int, list[str], list[str]]:
    """(exit code, lines of stdout, lines of stderr) of `raw2drive ARGUMENTS`, or of Python code with these arguments.

    More CPU time than the limit kills the process, which fails the test; the wall clock depends on other processes.
    memory_bytes: of address space, or 0: of resident memory, for what maps more than it uses.
    """

    def limits() -> None:
        resource.setrlimit(resource.RLIMIT_CPU, (SECONDS, SECONDS))
        if memory_bytes:
            resource.setrlimit(resource.RLIMIT_AS, (memory_bytes, memory_bytes))

    start = ['-c', code] if code else ['-m', 'raw2drive_ros.cli.main']
    environment = os.environ | {'PYTHONPATH': str(ROOT), 'OPENBLAS_NUM_THREADS': '1', 'OMP_NUM_THREADS': '1'}
    done = subprocess.run(
        [sys.executable, *start, *map(str, arguments)],
        cwd=ROOT,
        env=environment,
        capture_output=True,
        text=True,
        errors='replace',
        timeout=120,
        preexec_fn=limits,
        check=False,
    )
    assert 'Traceback' not in done.stderr, done.stderr[-3000:]
    assert done.returncode >= 0, f'killed by signal {-done.returncode}: {done.stderr[-300:]}'
    return done.returncode, done.stdout.splitlines(), done.stderr.splitlines()
