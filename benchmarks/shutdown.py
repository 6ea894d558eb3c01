"""How long the whole graph takes to end after Ctrl-C and SIGTERM: python -m benchmarks.shutdown"""

from __future__ import annotations

import argparse
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

SIGNALS = (signal.SIGINT, signal.SIGTERM)


def measure(number: signal.Signals, out: Path, start_within_s: float = 120.0) -> tuple[float, int, bool]:
    """(seconds from the signal until the demo has ended, its exit code, whether the bag is closed)."""
    command = [sys.executable, '-m', 'raw2drive_ros.cli.main', 'demo', '--out', str(out), '--no-video']
    process = subprocess.Popen(command, stderr=subprocess.DEVNULL, start_new_session=True)
    deadline = time.monotonic() + start_within_s
    while not (out / 'progress.jsonl').exists() and time.monotonic() < deadline:
        time.sleep(0.1)
    time.sleep(2.0)
    started = time.monotonic()
    process.send_signal(number)
    process.wait(30)
    return time.monotonic() - started, process.returncode, (out / 'bag' / 'metadata.yaml').is_file()


def main() -> None:
    """Stop a running demo with each signal; print a table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('--repeats', type=int, default=3)
    options = parser.parse_args()
    print('| signal | seconds to the end of every process | exit code | bag closed |')
    print('|---|---|---|---|')
    for number in SIGNALS * options.repeats:
        with tempfile.TemporaryDirectory() as folder:
            seconds, code, closed = measure(number, Path(folder) / 'demo')
        print(f'| {number.name} | {seconds:.2f} | {code} | {"yes" if closed else "no"} |', flush=True)


if __name__ == '__main__':
    main()
