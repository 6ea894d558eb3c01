"""Starts the graph as separate processes and ends it: no orphans, and SIGKILL for a process that takes too long."""

from __future__ import annotations

import contextlib
import fcntl
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import IO, Any

from raw2drive_ros.contracts.errors import DomainBusyError, GraphError

END_WITHIN_S = 1.5
DOMAINS = range(50, 90)


@contextlib.contextmanager
def reserve_domain(wanted: int | None, lock_folder: Path = Path('/tmp')) -> Iterator[int]:
    """A ROS domain that no other raw2drive graph on this machine uses; `wanted` or the first free one.

    Raises DomainBusyError.
    """
    for domain in [wanted] if wanted is not None else DOMAINS:
        if not 0 <= domain <= 101:
            raise DomainBusyError(f'ROS domain {domain} is outside 0 .. 101')
        handle = (lock_folder / f'raw2drive_domain_{domain}.lock').open('w')
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            handle.close()
            continue
        try:
            yield domain
        finally:
            handle.close()
        return
    if wanted is not None:
        raise DomainBusyError(
            f'ROS domain {wanted} is used by another raw2drive graph: end it, or choose another with --domain'
        )
    raise DomainBusyError('every ROS domain from 50 to 89 is used by raw2drive graphs; end some of them')


@dataclass(slots=True)
class Graph:
    """Processes by name, each in its own group, each logging to `<folder>/<name>.log`.

    patience_s: how long each process may take to end before SIGKILL.
    """

    folder: Path
    environment: dict[str, str]
    processes: dict[str, subprocess.Popen[bytes]] = field(default_factory=dict)
    logs: list[IO[bytes]] = field(default_factory=list)
    patience_s: dict[str, float] = field(default_factory=dict)

    def start(
        self,
        name: str,
        parameters: dict[str, Any],
        *,
        sim_time: bool = True,
        remap: dict[str, str] | None = None,
        end_within_s: float = END_WITHIN_S,
        node: str = '',
    ) -> None:
        """`python -m raw2drive_ros.nodes.<name>` with ROS parameters; remap: topic -> the one to use in its place.

        node: the module, where it is not called as the process.
        """
        command = [sys.executable, '-m', f'raw2drive_ros.nodes.{node or name}', '--ros-args']
        for key, value in ({'use_sim_time': sim_time} | parameters).items():
            text = str(value).lower() if isinstance(value, bool) else str(value)
            if isinstance(value, str):
                text = "'" + value.replace("'", "''") + "'"
            command += ['-p', f'{key}:={text}']
        for topic, other in (remap or {}).items():
            command += ['-r', f'{topic}:={other}']
        self.folder.mkdir(parents=True, exist_ok=True)
        log = (self.folder / f'{name}.log').open('wb')
        self.logs.append(log)
        self.patience_s[name] = end_within_s
        self.processes[name] = subprocess.Popen(
            command,
            env=self.environment,
            stdin=subprocess.DEVNULL,
            stdout=log,
            stderr=subprocess.STDOUT,
            start_new_session=True,
        )

    def check(self, *, may_end: tuple[str, ...] = ()) -> None:
        """Raises GraphError when a process has died that should not have."""
        for name, process in self.processes.items():
            code = process.poll()
            if code is not None and not (name in may_end and code == 0):
                raise GraphError(self.how_it_ended(name))

    def ended(self, name: str) -> bool:
        return self.processes[name].poll() is not None

    def how_it_ended(self, name: str) -> str:
        """For a process that has ended: its exit code and last log line, or the signal that killed it."""
        code = self.processes[name].returncode
        if code < 0:
            hint = '; `raw2drive bag recover` saves what it wrote' if name == 'recorder' else ''
            return f'{name} was killed by {signal.Signals(-code).name}{hint}'
        return f'{name} ended with code {code}: {self.last_words(name)}'

    def last_words(self, name: str) -> str:
        """The last error line of a process's log, or else its last line."""
        text = (self.folder / f'{name}.log').read_text(errors='replace').strip().splitlines()
        errors = [line for line in text if line.startswith('error:') or '[ERROR]' in line]
        return (errors or text or ['it said nothing'])[-1].removeprefix('error: ')

    def end(self, order: tuple[str, ...] = ()) -> None:
        """SIGINT to all (those in `order` first and waited for), then SIGKILL to what is left."""
        for name in order:
            if name in self.processes:
                self._interrupt([name])
        self._interrupt(list(self.processes))
        for log in self.logs:
            log.close()
        self.logs.clear()

    def _interrupt(self, names: list[str]) -> None:
        running = {n: self.processes[n] for n in names if self.processes[n].poll() is None}
        for process in running.values():
            with contextlib.suppress(ProcessLookupError):
                process.send_signal(signal.SIGINT)
        started = time.monotonic()
        for name, process in running.items():
            try:
                process.wait(max(0.0, started + self.patience_s.get(name, END_WITHIN_S) - time.monotonic()))
            except subprocess.TimeoutExpired:
                with contextlib.suppress(ProcessLookupError):
                    os.killpg(process.pid, signal.SIGKILL)
                process.wait()


@contextlib.contextmanager
def running_graph(folder: Path, domain: int) -> Iterator[Graph]:
    """A graph that is ended in whatever way the block is left."""
    from raw2drive_ros.nodes.transport import child_environment

    if not 0 <= domain <= 101:
        raise DomainBusyError(f'ROS domain {domain} is outside 0 .. 101')
    graph = Graph(folder, child_environment(domain, folder / 'ros'))
    try:
        yield graph
    finally:
        graph.end()
