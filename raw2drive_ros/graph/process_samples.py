"""Resource usage of processes: memory, file handles, threads, shared-memory segments."""

from __future__ import annotations

from pathlib import Path

import psutil

SHARED_MEMORY = '/dev/shm/'


def process_values(name: str, pid: int) -> dict[str, float]:
    """'name/quantity' -> number; memory that is not shared (USS), in MiB. Empty for a process that has ended."""
    try:
        process = psutil.Process(pid)
        with process.oneshot():
            memory = process.memory_full_info().uss
            segments = {m.path for m in process.memory_maps() if m.path.startswith(SHARED_MEMORY)}
            return {
                f'{name}/memory_mib': memory / 2**20,
                f'{name}/handles': float(process.num_fds()),
                f'{name}/threads': float(process.num_threads()),
                f'{name}/shared_segments': float(len(segments)),
            }
    except psutil.Error:
        return {}


def folder_mib(folder: Path) -> float:
    """Size of all files below, in MiB; files that vanish meanwhile are left out."""
    total = 0
    for path in folder.rglob('*'):
        try:
            total += path.stat().st_size if path.is_file() else 0
        except FileNotFoundError:
            continue
    return total / 2**20
