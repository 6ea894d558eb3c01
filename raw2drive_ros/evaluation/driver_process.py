"""The simulator's end of the process that a driver class runs in, see `driving.driver_host`."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import weakref
from collections.abc import Mapping
from multiprocessing import Pipe
from multiprocessing.connection import Connection
from typing import Any

from raw2drive_ros.contracts.errors import DriverClassError, DriverFailedError
from raw2drive_ros.driving.driver_class import PRIVILEGED
from raw2drive_ros.safe_path import safe_path_variables

HOST = 'raw2drive_ros.driving.driver_host'
# Loading a class may mean importing torch and reading weights.
LOADING_S, DECIDING_S, ENDING_S = 180.0, 60.0, 2.0


class DriverProcess:
    """The process of one class. sensors: what the class declares. source: hash of its file.

    arguments: of the constructor; None: only ask what the class declares. A class that declares `privileged` is not
    made there. Raises DriverClassError.
    """

    def __init__(self, name: str, arguments: Mapping[str, Any] | None) -> None:
        self.name = name
        self.link, theirs = Pipe()
        command = [sys.executable, '-m', HOST, str(theirs.fileno()), name, json.dumps(arguments)]
        # Standard output is for results. A session of its own: Ctrl-C is for the evaluation, which closes the link.
        self.process = subprocess.Popen(
            command,
            stdin=subprocess.DEVNULL,
            stdout=2,
            pass_fds=[theirs.fileno()],
            env={**os.environ, **safe_path_variables()},
            start_new_session=True,
        )
        theirs.close()
        self.close = weakref.finalize(self, _end, self.link, self.process)
        hello = self._loaded()
        self.sensors: tuple[str, ...] = tuple(hello['sensors'])
        self.source = str(hello['source'])
        if arguments is None or PRIVILEGED in self.sensors:
            self.close()
        else:
            self._loaded()

    @property
    def alive(self) -> bool:
        return self.close.alive and self.process.poll() is None

    def ask(self, request: Mapping[str, Any], images: bytes | None = None) -> dict[str, Any]:
        """The answer to a request. Raises DriverFailedError."""
        try:
            self.link.send_bytes(json.dumps(request).encode())
            if images is not None:
                self.link.send_bytes(images)
        except OSError as error:
            raise DriverFailedError(f'driver {self.name}: {self._ended()}') from error
        answer = self._received(DECIDING_S)
        if 'fault' in answer:
            raise DriverFailedError(f'driver {self.name}: {answer["fault"]}')
        return answer

    def _loaded(self) -> dict[str, Any]:
        """The next answer while the class is loaded."""
        try:
            answer = self._received(LOADING_S)
        except DriverFailedError as error:
            raise DriverClassError(str(error)) from error
        if 'refused' in answer:
            self.close()
            raise DriverClassError(str(answer['refused']))
        return answer

    def _received(self, timeout_s: float) -> dict[str, Any]:
        try:
            if not self.link.poll(timeout_s):
                self.process.kill()
                self.close()
                raise DriverFailedError(f'driver {self.name}: no answer within {timeout_s:g} s')
            answer = json.loads(self.link.recv_bytes())
        except (EOFError, OSError) as error:
            raise DriverFailedError(f'driver {self.name}: {self._ended()}') from error
        except ValueError as error:
            raise DriverFailedError(f'driver {self.name}: its process answered what is not JSON: {error}') from error
        if not isinstance(answer, dict):
            raise DriverFailedError(f'driver {self.name}: its process answered {type(answer).__name__}')
        return answer

    def _ended(self) -> str:
        self.close()
        return f'its process ended with exit code {self.process.returncode}'


def _end(link: Connection, process: subprocess.Popen[bytes]) -> None:
    """A driver that listens ends when the link is closed."""
    link.close()
    try:
        process.wait(ENDING_S)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()
