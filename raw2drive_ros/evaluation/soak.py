"""Does a graph that runs for hours leak? Samples of the resources of its processes, and a verdict per quantity."""

from __future__ import annotations

import json
import os
import statistics
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from raw2drive_ros.bounds import MAX_RESULTS_BYTES, read_regular
from raw2drive_ros.contracts.errors import SoakError

# Memory grows while every scenario type is driven for the first time; after this much simulated time it may not.
WARM_UP_H = 1.0
MAX_POINTS = 400
MEMORY_MIB_PER_H, LOG_MIB_PER_H = 1.0, 1.0


@dataclass(frozen=True, slots=True)
class Sample:
    """part: counts the starts of the graph; all processes are new in each. values: 'process/quantity' -> number."""

    part: int
    simulated_s: float
    wall_s: float
    episodes: int
    values: dict[str, float]


@dataclass(frozen=True, slots=True)
class Trend:
    """A quantity of one part after warm-up. per_hour: Theil-Sen slope over simulated time. steady: within `allowed`."""

    part: int
    name: str
    first: float
    last: float
    highest: float
    per_hour: float
    allowed: float

    @property
    def steady(self) -> bool:
        return self.per_hour <= self.allowed


def theil_sen(x: Sequence[float], y: Sequence[float]) -> float:
    """Median of the slopes between all pairs of points (at most MAX_POINTS, evenly thinned); 0 for fewer than two."""
    thin = np.unique(np.linspace(0, len(x) - 1, min(len(x), MAX_POINTS)).round().astype(int)) if len(x) else []
    a, b = np.asarray(x, np.float64)[thin], np.asarray(y, np.float64)[thin]
    left, right = np.triu_indices(len(a), 1)
    apart = a[right] > a[left]
    if not apart.any():
        return 0.0
    return float(np.median(((b[right] - b[left])[apart]) / (a[right] - a[left])[apart]))


def trends(samples: Iterable[Sample], warm_up_h: float = WARM_UP_H) -> list[Trend]:
    """One trend per part and quantity; parts that lasted less than twice the warm-up have none.

    Handles, threads and shared-memory segments may not grow at all; memory and logs by MEMORY_MIB_PER_H, LOG_MIB_PER_H.
    """
    found, parts = [], {}
    for sample in samples:
        parts.setdefault(sample.part, []).append(sample)
    for part, rows in parts.items():
        rows = [row for row in rows if row.simulated_s >= warm_up_h * 3600.0]
        if not rows or rows[-1].simulated_s < 2.0 * warm_up_h * 3600.0:
            continue
        for name in rows[0].values:
            # The last sample lacks the quantities of a process that was just ending.
            hours, values = zip(*((row.simulated_s / 3600.0, row.values[name]) for row in rows if name in row.values))
            quarter = max(1, len(values) // 4)
            first, last = statistics.median(values[:quarter]), statistics.median(values[-quarter:])
            found.append(Trend(part, name, first, last, max(values), theil_sen(hours, values), allowance(name)))
    return found


def allowance(name: str) -> float:
    """Growth per simulated hour that still counts as steady."""
    if name.endswith('memory_mib'):
        return MEMORY_MIB_PER_H
    return LOG_MIB_PER_H if name.endswith('logs_mib') else 0.0


def totals(samples: Sequence[Sample]) -> dict[str, float]:
    """Simulated and wall hours, episodes and parts, summed over parts."""
    last: dict[int, Sample] = {sample.part: sample for sample in samples}
    return {
        'simulated_h': sum(s.simulated_s for s in last.values()) / 3600.0,
        'wall_h': sum(s.wall_s for s in last.values()) / 3600.0,
        'episodes': sum(s.episodes for s in last.values()),
        'parts': len(last),
    }


def read_samples(path: Path) -> list[Sample]:
    """Whole lines of a samples file; none for a file that does not exist. Raises SoakError that names the line."""
    if not path.exists():
        return []
    found = []
    try:
        text = read_regular(path, MAX_RESULTS_BYTES).decode()
    except (OSError, UnicodeDecodeError) as error:
        raise SoakError(f'{path}: cannot be read: {error}') from error
    # A killed writer leaves half a line at the end.
    for number, line in enumerate(text[: text.rfind('\n') + 1].splitlines(), 1):
        try:
            found.append(Sample(**json.loads(line)))
        except (ValueError, TypeError, RecursionError) as error:
            raise SoakError(f'{path}, line {number}: not a sample of a soak: {error}') from error
    return found


def append_sample(path: Path, sample: Sample) -> None:
    """Append it as one JSON line."""
    with path.open('a') as file:
        file.write(json.dumps(asdict(sample)) + '\n')


def drop_half_line(path: Path) -> None:
    """Cut off what a killed writer left of its last line."""
    if path.exists():
        data = path.read_bytes()
        os.truncate(path, data.rfind(b'\n') + 1)


def to_json(trend: Trend) -> dict[str, Any]:
    """Its fields, and the verdict `steady`."""
    return asdict(trend) | {'steady': trend.steady}
