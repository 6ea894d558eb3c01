"""Ctrl-C and SIGTERM during training: the step is finished and a checkpoint written before the process ends."""

from __future__ import annotations

import signal
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from types import FrameType

SIGNALS = (signal.SIGINT, signal.SIGTERM)


@dataclass(slots=True)
class Interrupts:
    """number: the signal that has arrived, 0 for none."""

    number: int = 0

    @property
    def requested(self) -> bool:
        return self.number != 0

    def deliver(self) -> None:
        """Let the signal do what it did before; without one, nothing. Call it outside of `noted_interrupts`."""
        if self.requested:
            signal.raise_signal(self.number)


@contextmanager
def noted_interrupts(*, wanted: bool = True) -> Iterator[Interrupts]:
    """Inside the block the first signal is only noted, and the second one acts at once.

    A step that is cut off in its middle leaves optimisers and random generators between two steps, where no checkpoint
    may be written. Not wanted, or outside of the main thread, signals act as before.
    """
    found = Interrupts()
    if not wanted or threading.current_thread() is not threading.main_thread():
        yield found
        return
    handlers = {number: signal.getsignal(number) for number in SIGNALS}
    # What is ignored stays ignored; None is a handler that was not set from Python.
    before = {number: handler for number, handler in handlers.items() if handler not in (signal.SIG_IGN, None)}

    def on_signal(number: int, frame: FrameType | None) -> None:
        found.number = number
        print('ends after this step, with a checkpoint; once more ends at once, without', file=sys.stderr)
        for each, handler in before.items():
            signal.signal(each, handler)

    for number in before:
        signal.signal(number, on_signal)
    try:
        yield found
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
