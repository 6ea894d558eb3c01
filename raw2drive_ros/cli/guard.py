"""Errors that users can cause become one line on stderr; anything else is a bug and keeps its traceback."""

from __future__ import annotations

import argparse
import os
import signal
import sys
from collections.abc import Callable
from types import FrameType

from raw2drive_ros.contracts.errors import UserError
from raw2drive_ros.contracts.texts import shown
from raw2drive_ros.safe_path import safe_path_variables


class Terminated(BaseException):
    """SIGTERM, or SIGHUP from a terminal that is closed: unwinds like Ctrl-C, so that everything is closed."""


def _on_sigterm(number: int, frame: FrameType | None) -> None:
    # A second signal would interrupt the shutdown that the first one began: ignore it.
    for name in (signal.SIGTERM, signal.SIGHUP):
        signal.signal(name, signal.SIG_IGN)
    raise Terminated


def guarded(run: Callable[[argparse.Namespace], int], options: argparse.Namespace) -> int:
    """Run a verb; returns its exit code."""
    # For worker processes, which Python starts itself.
    os.environ.update(safe_path_variables())
    signal.signal(signal.SIGTERM, _on_sigterm)
    # Shell scripts start background jobs with SIGINT ignored, but a gate must hear it, because it has a car to stop.
    if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
        signal.signal(signal.SIGINT, signal.default_int_handler)
    # Under nohup, SIGHUP is ignored and has to stay ignored.
    if signal.getsignal(signal.SIGHUP) is not signal.SIG_IGN:
        signal.signal(signal.SIGHUP, _on_sigterm)
    try:
        return run(options)
    except KeyboardInterrupt:
        print('interrupted', file=sys.stderr)
        return 130
    except Terminated:
        print('terminated', file=sys.stderr)
        return 143
    except BrokenPipeError:
        return 0
    except Exception as error:
        if not isinstance(error, UserError | OSError | MemoryError):
            raise
        print(f'error: {shown(error) or "not enough memory"}', file=sys.stderr)
        return error.exit_code if isinstance(error, UserError) else 1
