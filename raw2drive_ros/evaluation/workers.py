"""The same work on many jobs, in this process or in several, with the results in the order of the jobs."""

from __future__ import annotations

import multiprocessing
from collections.abc import Callable, Iterator, Sequence
from typing import Any, TypeVar

from raw2drive_ros.evaluation.evaluate import without_interrupts

Job = TypeVar('Job')
Result = TypeVar('Result')
_state: Any = None


def in_order(
    make: Callable[[], Any], work: Callable[[Any, Job], Result], jobs: Sequence[Job], workers: int
) -> Iterator[Result]:
    """`work(make(), job)` of every job; `make` is called once per process. Both have to be picklable with workers."""
    if workers <= 1 or len(jobs) < 2:
        state = make() if jobs else None
        for job in jobs:
            yield work(state, job)
        return
    # Spawned, not forked: torch's threads do not survive a fork.
    with without_interrupts():
        pool = multiprocessing.get_context('spawn').Pool(workers, _start, (make,))
    with pool:
        yield from pool.imap(_call, [(work, job) for job in jobs])


def _start(make: Callable[[], Any]) -> None:
    global _state
    import cv2

    cv2.setNumThreads(1)
    _state = make()


def _call(item: tuple[Callable[[Any, Any], Any], Any]) -> Any:
    work, job = item
    return work(_state, job)
