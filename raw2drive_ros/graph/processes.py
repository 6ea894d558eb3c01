"""Starts the graph as separate processes and ends it: no orphans, and SIGKILL for a process that takes too long."""

from __future__ import annotations

import contextlib
import errno
import fcntl
import os
import signal
import socket
import stat
import subprocess
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import IO, Any

from raw2drive_ros.contracts.errors import DomainBusyError, GraphError
from raw2drive_ros.contracts.topics import SHARED
from raw2drive_ros.graph.security_policy import enclave_path
from raw2drive_ros.runtime_folder import runtime_folder

END_WITHIN_S = 1.5
DOMAINS = range(50, 90)


@contextlib.contextmanager
def reserve_domain(wanted: int | None, lock_folder: Path | None = None) -> Iterator[int]:
    """A ROS domain that no other raw2drive graph on this machine uses; `wanted` or the first free one.

    lock_folder: None for the user's runtime folder. Raises DomainBusyError, and RuntimeFolderError.
    """
    folder = lock_folder or runtime_folder()
    for domain in [wanted] if wanted is not None else DOMAINS:
        if not 0 <= domain <= 101:
            raise DomainBusyError(f'ROS domain {domain} is outside 0 .. 101')
        with contextlib.ExitStack() as held:
            try:
                held.enter_context(_locked_file(folder / f'raw2drive_domain_{domain}.lock'))
                held.enter_context(_machine_wide_name(f'raw2drive_domain_{domain}'))
            except OSError:
                continue
            yield domain
            return
    if wanted is not None:
        raise DomainBusyError(
            f'ROS domain {wanted} is used by another raw2drive graph: end it, or choose another with --domain'
        )
    raise DomainBusyError('every ROS domain from 50 to 89 is used by raw2drive graphs; end some of them')


@contextlib.contextmanager
def _locked_file(path: Path) -> Iterator[None]:
    """Hold a lock file of this user. Raises OSError where it is locked, a link, no file, or somebody else's."""
    flags = os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC
    handle = os.open(path, flags, 0o600)
    try:
        found = os.fstat(handle)
        if not stat.S_ISREG(found.st_mode) or found.st_uid != os.geteuid():
            raise OSError(errno.EPERM, 'not a file of this user', str(path))
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        yield
    finally:
        os.close(handle)


@contextlib.contextmanager
def _machine_wide_name(name: str) -> Iterator[None]:
    """Hold a name that all users of the machine see, as they see the domain. Raises OSError where it is held.

    Linux: an abstract socket, which is no file, and gone with its process.
    """
    if not sys.platform.startswith('linux'):
        yield
        return
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as held:
        held.bind(f'\0{name}')
        yield


@dataclass(slots=True)
class Graph:
    """Processes by name, each in its own group, each logging to `<folder>/<name>.log`.

    namespace: '' or as '/car1': of all its nodes, their clock and their diagnostics, so that several cars share a
    domain. patience_s: how long each process may take to end before SIGKILL.
    """

    folder: Path
    environment: dict[str, str]
    namespace: str = ''
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

        With a namespace, both topics are its own. node: the module, where it is not called as the process.
        """
        command = [sys.executable, '-m', f'raw2drive_ros.nodes.{node or name}', '--ros-args']
        for key, value in ({'use_sim_time': sim_time} | parameters).items():
            text = str(value).lower() if isinstance(value, bool) else str(value)
            if isinstance(value, str):
                text = "'" + value.replace("'", "''") + "'"
            command += ['-p', f'{key}:={text}']
        if self.namespace:
            command += ['-r', f'__ns:={self.namespace}']
        for topic, other in (remap or {}).items():
            command += ['-r', f'{self.namespace}{topic}:={self.namespace}{other}']
        for topic in SHARED if self.namespace else ():
            command += ['-r', f'{topic}:={self.namespace}{topic}']
        if self.environment.get('ROS_SECURITY_ENABLE') == 'true':
            command += ['--enclave', enclave_path(name, self.namespace)]
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
def running_graph(folder: Path, domain: int, namespace: str = '') -> Iterator[Graph]:
    """A graph that is ended in whatever way the block is left; namespace: see `Graph`."""
    from raw2drive_ros.nodes.transport import child_environment

    if not 0 <= domain <= 101:
        raise DomainBusyError(f'ROS domain {domain} is outside 0 .. 101')
    graph = Graph(folder, child_environment(domain, folder / 'ros'), namespace)
    try:
        yield graph
    finally:
        graph.end()
