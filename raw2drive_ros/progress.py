"""A progress bar on a terminal, an occasional line elsewhere."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

LINE_EVERY_S = 15.0


@contextmanager
def bar(title: str, total: float, unit: str) -> Iterator[Callable[..., None]]:
    """Yields advance(done, note=''), which takes the absolute amount done. Writes to stderr."""
    if sys.stderr.isatty():
        from rich.console import Console
        from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

        columns = (
            TextColumn('{task.description}'),
            BarColumn(),
            TextColumn('{task.completed:.0f}/{task.total:.0f} ' + unit),
            TimeRemainingColumn(),
            TextColumn('{task.fields[note]}'),
        )
        with Progress(*columns, console=Console(stderr=True)) as progress:
            task = progress.add_task(title, total=total, note='')

            def advance(done: float, note: str = '') -> None:
                progress.update(task, completed=done, note=note)

            yield advance
        return
    last, finished = time.monotonic(), False

    def line(done: float, note: str = '') -> None:
        nonlocal last, finished
        if finished:
            return
        finished = done >= total
        if time.monotonic() - last > LINE_EVERY_S or finished:
            last = time.monotonic()
            print(f'{title}: {done:.0f}/{total:.0f} {unit} {note}'.rstrip(), file=sys.stderr)

    yield line
