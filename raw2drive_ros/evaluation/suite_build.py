"""Draws a suite: pairs of the right split, fair, no two alike, with the time limits of their drives.

Every draw depends on its type and seed alone, so the file does not depend on the number of workers; what is found is
kept beside the file until that is whole, so that a call that was interrupted is continued by the next one.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Mapping
from contextlib import suppress
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Any

from raw2drive_ros.artifact import write_whole
from raw2drive_ros.contracts.errors import UnfairScenarioError
from raw2drive_ros.evaluation.fairness import is_fair, weather_of
from raw2drive_ros.evaluation.reference import ReferenceRunner, References
from raw2drive_ros.evaluation.scene_distance import SceneKey, apart, scene_key
from raw2drive_ros.evaluation.suite_plans import EVENT, TWIN, SuitePlan
from raw2drive_ros.evaluation.suites import FORMAT, LimitRule, drives_of
from raw2drive_ros.evaluation.workers import in_order
from raw2drive_ros.simulation.route_id import RouteId

DRAW_LIMIT = 60
# Scenes of one suite that differ by less (share of a key parameter's range) are the same task twice.
ALIKE = 0.02
UNFAIR, UNSOLVED, DUPLICATE = 'unfair', 'unsolved', 'too like another'


@dataclass(frozen=True, slots=True)
class Examined:
    """A drawn route. reason: why it is rejected, or ''. reference_s, by: time and driver of each of its drives."""

    type: str
    seed: int
    reason: str = ''
    reference_s: tuple[float, ...] = ()
    by: tuple[str, ...] = ()


@dataclass(slots=True)
class Built:
    """entries: type -> entries of the file. rejected: reason -> how many draws."""

    entries: dict[str, list[dict[str, Any]]]
    rejected: dict[str, int]


def build_suite(
    plan: SuitePlan,
    references: References,
    journal: Path | None = None,
    workers: int = 1,
    on_route: Callable[[int, str], None] = lambda done, note: None,
    rule: LimitRule | None = None,
) -> Built:
    """Draw the routes of a plan. journal: keeps what was examined, see module.

    Raises UnfairScenarioError for a type of which `DRAW_LIMIT` draws are rejected, UnknownDriverError.
    """
    rule = rule or LimitRule()
    settings = {'drives': plan.drives, 'timed': plan.timed, 'references': references.names(), 'format': FORMAT}
    known = _Journal(journal, settings)
    accepted: dict[str, list[Examined]] = {kind: [] for kind in plan.types}
    keys: dict[str, list[SceneKey]] = {kind: [] for kind in plan.types}
    following = dict.fromkeys(plan.types, plan.first_seed)
    rejected = dict.fromkeys((UNFAIR, UNSOLVED, DUPLICATE), 0)
    while jobs := _next_jobs(plan, accepted, following):
        for found in known.examine(jobs, plan, references, workers):
            reason = found.reason
            if not reason:
                key = scene_key(found.type, found.seed)
                reason = DUPLICATE * any(_alike(key, other) for other in keys[found.type])
            if reason:
                rejected[reason] += 1
                continue
            accepted[found.type].append(found)
            keys[found.type].append(key)
            on_route(sum(map(len, accepted.values())), f'{found.type}/{found.seed}')
    entries = {kind: [_entry(found, rule) for found in of_type] for kind, of_type in accepted.items()}
    return Built(entries, {reason: count for reason, count in rejected.items() if count})


def _next_jobs(
    plan: SuitePlan, accepted: Mapping[str, list[Examined]], following: dict[str, int]
) -> list[tuple[str, int]]:
    """As many seeds of every type as it lacks routes."""
    jobs = []
    for kind in plan.types:
        lacks = plan.per_type - len(accepted[kind])
        if lacks and following[kind] - plan.first_seed - len(accepted[kind]) >= DRAW_LIMIT:
            raise UnfairScenarioError(
                f'{kind}: {DRAW_LIMIT} draws rejected: its actors crash among themselves, no reference driver reaches '
                'the goal, or its scenes are too much alike'
            )
        jobs += [(kind, seed) for seed in range(following[kind], following[kind] + lacks)]
        following[kind] += lacks
    return jobs


def _alike(one: SceneKey, other: SceneKey) -> bool:
    distance = apart(one, other)
    return distance is not None and distance < ALIKE


def _entry(found: Examined, rule: LimitRule) -> dict[str, Any]:
    entry: dict[str, Any] = {'seed': found.seed, 'weather': weather_of(found.type, found.seed)}
    if found.reference_s:
        entry['limit_s'] = [rule.limit_s(seconds) for seconds in found.reference_s]
        entry['reference_s'] = [round(seconds, 2) for seconds in found.reference_s]
    return entry


def examine(runner: ReferenceRunner | None, job: tuple[str, int], drives: tuple[str, ...]) -> Examined:
    """One draw: is it fair, and how long does the reference driver take for each of its drives?"""
    kind, seed = job
    names = drives_of(kind, drives)
    if not all(is_fair(kind, seed, twin=name == TWIN) for name in names):
        return Examined(kind, seed, UNFAIR)
    if runner is None:
        return Examined(kind, seed)
    weather = weather_of(kind, seed)
    times: list[float] = []
    by: list[str] = []
    for name in names:
        drive = runner.drive(RouteId(kind, seed, weather, twin=name == TWIN))
        if drive.seconds is None:
            return Examined(kind, seed, UNSOLVED)
        times.append(drive.seconds)
        by.append(drive.by)
    return Examined(kind, seed, '', tuple(times), tuple(by))


def _runner(references: References | None) -> ReferenceRunner | None:
    return None if references is None else ReferenceRunner(references)


def _work(runner: ReferenceRunner | None, job: tuple[tuple[str, int], tuple[str, ...]]) -> Examined:
    return examine(runner, *job)


class _Journal:
    """Draws that were examined by an earlier call with the same settings, one JSON line each."""

    def __init__(self, path: Path | None, settings: dict[str, Any]) -> None:
        self.path = path
        self.known: dict[tuple[str, int], Examined] = {}
        head = json.dumps(settings)
        if path is None:
            return
        lines = path.read_text().split('\n') if path.is_file() else []
        if lines[:1] == [head]:
            # A killed writer leaves half a line at the end.
            for line in lines[1:-1]:
                with suppress(ValueError, TypeError):
                    found = Examined(**json.loads(line))
                    times, by = tuple(found.reference_s), tuple(found.by)
                    self.known[found.type, found.seed] = Examined(found.type, found.seed, found.reason, times, by)
        path.parent.mkdir(parents=True, exist_ok=True)
        rows = [json.dumps(asdict(found)) for found in self.known.values()]
        write_whole(path, '\n'.join([head, *rows]) + '\n')

    def examine(
        self, jobs: list[tuple[str, int]], plan: SuitePlan, references: References, workers: int
    ) -> Iterator[Examined]:
        """In the order of the jobs."""
        new = [(job, plan.drives) for job in jobs if job not in self.known]
        driven = in_order(partial(_runner, references if plan.timed else None), _work, new, workers)
        for job in jobs:
            if job not in self.known:
                self.known[job] = next(driven)
                if self.path is not None:
                    with self.path.open('a') as file:
                        file.write(json.dumps(asdict(self.known[job])) + '\n')
            yield self.known[job]


def write_suite(
    path: Path,
    name: str,
    version: str,
    plan: SuitePlan,
    built: Built,
    references: References,
    rule: LimitRule | None = None,
) -> None:
    """Write a suite's file: one line per type."""
    rule = rule or LimitRule()
    head: dict[str, Any] = {'format': FORMAT, 'name': name, 'version': version}
    if plan.drives != (EVENT, TWIN):
        head['drives'] = list(plan.drives)
    if plan.partners:
        head['partners'] = dict(plan.partners)
    if plan.timed:
        head['limits'] = {**asdict(rule), 'drivers': list(references.names())}
    heads = ',\n'.join(f'  {json.dumps(key)}: {json.dumps(value)}' for key, value in head.items())
    lines = ',\n'.join(
        f'    {json.dumps(kind)}: [\n' + ',\n'.join(f'      {json.dumps(entry)}' for entry in entries) + '\n    ]'
        for kind, entries in built.entries.items()
    )
    path.parent.mkdir(parents=True, exist_ok=True)
    write_whole(path, f'{{\n{heads},\n  "routes": {{\n{lines}\n  }}\n}}\n')
