"""Can a suite be won without looking? Drives the sightless drivers over its pairs and judges it by the result."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

from raw2drive_ros.evaluation.cheat_tuning import Course, Trials
from raw2drive_ros.evaluation.cheats import FAMILIES, SCRIPT, SIGHTLESS, Tuned, decider
from raw2drive_ros.evaluation.fairness import Difference, first_difference
from raw2drive_ros.evaluation.quick_drive import quick_drive, sensorless_env
from raw2drive_ros.evaluation.suites import Pair, Suite
from raw2drive_ros.evaluation.workers import in_order
from raw2drive_ros.simulation.environment import DrivingEnv

# Pair success (percent) above which a suite fails; that of the drivers which choose among all others is higher.
BAR_PERCENT = 5.0
BARS_PERCENT = {SCRIPT: 12.0, 'profile': 12.0}
# A type is soft for a driver that wins more than this share of its pairs; no driver may find more soft types.
SOFT_SHARE, SOFT_TYPES = 0.4, 3
HINDSIGHT = 'hindsight'


@dataclass(frozen=True, slots=True)
class AuditRow:
    """What one driver did on one pair. won: per drive (event, twin). causes: why the others were lost, '' if won."""

    driver: str
    type: str
    seed: int
    won: tuple[bool, ...]
    causes: tuple[str, ...]
    way: dict[str, Any]

    @property
    def pair(self) -> bool:
        return all(self.won)


@dataclass(frozen=True, slots=True)
class Alike:
    """Where the twin of a type's first pair begins to differ from its event; None: nowhere."""

    type: str
    difference: Difference | None

    def __str__(self) -> str:
        found = self.difference
        return 'never' if found is None else f'{found.way_m:.0f} m ({found.what})'


@dataclass(frozen=True, slots=True)
class Cell:
    """pairs: won, of `of`. events: first drives won."""

    pairs: int
    events: int
    of: int


@dataclass(frozen=True, slots=True)
class _Job:
    pair: Pair
    limits_s: tuple[float | None, ...]


@dataclass(slots=True)
class _Auditor:
    env: DrivingEnv
    drivers: tuple[str, ...]
    tuned: Tuned


def audit(
    suite: Suite,
    tuned: Tuned,
    drivers: Sequence[str] = SIGHTLESS,
    types: Iterable[str] | None = None,
    workers: int = 1,
    on_pair: Callable[[int, str], None] = lambda done, note: None,
) -> Iterator[AuditRow]:
    """Every driver on every pair. drivers: of `SIGHTLESS`, and `HINDSIGHT`: whether any profile at all wins."""
    wanted = None if types is None else set(types)
    pairs = [pair for pair in suite.pairs if wanted is None or pair.type in wanted]
    jobs = [_Job(pair, tuple(suite.limit_s(route) for route in pair.drives)) for pair in pairs]
    make = partial(_make_auditor, tuple(drivers), tuned)
    for done, rows in enumerate(in_order(make, _audit_pair, jobs, workers), 1):
        on_pair(done, f'{rows[0].type}/{rows[0].seed}' if rows else '')
        yield from rows


def _make_auditor(drivers: tuple[str, ...], tuned: Tuned) -> _Auditor:
    return _Auditor(sensorless_env(), drivers, tuned)


def _audit_pair(auditor: _Auditor, job: _Job) -> list[AuditRow]:
    pair = job.pair
    memories = [memory for memory in auditor.tuned.memories if memory.type == pair.type]
    known: dict[Any, tuple[tuple[bool, ...], tuple[str, ...]]] = {}
    rows = []
    for driver in auditor.drivers:
        if driver == HINDSIGHT:
            rows.append(_hindsight(auditor.env, job))
            continue
        way = auditor.tuned.choice(driver, pair.type).way
        if way not in known:
            verdicts = [
                quick_drive(auditor.env, decider(way, memories), route, limit_s)
                for route, limit_s in zip(pair.drives, job.limits_s, strict=True)
            ]
            known[way] = tuple(v.success for v in verdicts), tuple(v.cause for v in verdicts)
        rows.append(AuditRow(driver, pair.type, pair.seed, *known[way], way.stored()))
    return rows


def _hindsight(env: DrivingEnv, job: _Job) -> AuditRow:
    """The first profile that wins the whole pair; chosen on the pair itself, so this bounds what tuning can reach."""
    trials = Trials(env, [Course(job.pair.drives, job.limits_s)])
    event = False
    for way in FAMILIES['profile'].ways():
        whole, first = trials.wins(way, 0)
        event = event or first
        if whole:
            won = (True,) * len(job.pair.drives)
            return AuditRow(HINDSIGHT, job.pair.type, job.pair.seed, won, ('',) * len(won), way.stored())
    won = (event, *(False for _ in job.pair.drives[1:]))
    return AuditRow(HINDSIGHT, job.pair.type, job.pair.seed, won, ('no profile',) * len(won), {})


def first_differences(suite: Suite, types: Iterable[str]) -> list[Alike]:
    """For the first pair of each type that has twins: how far does the ego drive until the two can be told apart?"""
    pairs = {pair.type: pair for pair in reversed(suite.pairs) if len(pair.drives) > 1}
    return [Alike(kind, first_difference(kind, pairs[kind].seed)) for kind in types if kind in pairs]


def table_of(rows: Iterable[AuditRow]) -> dict[str, dict[str, Cell]]:
    """driver -> type -> what it won."""
    found: dict[str, dict[str, list[AuditRow]]] = {}
    for row in rows:
        found.setdefault(row.driver, {}).setdefault(row.type, []).append(row)
    return {
        driver: {
            kind: Cell(sum(row.pair for row in of_type), sum(row.won[0] for row in of_type), len(of_type))
            for kind, of_type in types.items()
        }
        for driver, types in found.items()
    }


def percent_of(cells: Iterable[Cell]) -> float:
    """Pairs won, in percent."""
    listed = list(cells)
    return 100.0 * sum(cell.pairs for cell in listed) / max(1, sum(cell.of for cell in listed))


def bar_percent(driver: str) -> float:
    """The pair success that a sightless driver may have at most; hindsight has none."""
    return 100.0 if driver == HINDSIGHT else BARS_PERCENT.get(driver, BAR_PERCENT)


def soft_types(cells: dict[str, Cell]) -> list[str]:
    """Types of which a driver wins more than `SOFT_SHARE` of the pairs."""
    return sorted(kind for kind, cell in cells.items() if cell.pairs > SOFT_SHARE * cell.of)


def faults_of(table: dict[str, dict[str, Cell]]) -> list[str]:
    """Why the suite is too soft, one line per reason; nothing for a suite that holds."""
    found = []
    for driver, cells in table.items():
        percent, bar = percent_of(cells.values()), bar_percent(driver)
        if percent > bar:
            found.append(f'{driver} wins {percent:.1f} % of the pairs: more than {bar:.0f} %')
        soft = soft_types(cells)
        if driver != HINDSIGHT and len(soft) > SOFT_TYPES:
            found.append(f'{driver} wins more than 2 of 5 pairs of {len(soft)} types: {", ".join(soft)}')
    return found
