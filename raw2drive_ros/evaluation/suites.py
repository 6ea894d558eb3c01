"""Suites: versioned lists of routes in `params/suites/`.

A route is a scenario type, a seed and a weather. A type that is paired has two drives per route, the event and its
twin; a pair is won by who succeeds on both. Suites of format 3 hold the time limit of every drive (`LimitRule`).
Evaluation suites use seeds below `VALIDATION_SEED_START`, training suites seeds from `TRAIN_SEED_START` on; checkpoints
are selected on the seeds between them.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from raw2drive_ros.bounds import read_json
from raw2drive_ros.contracts.errors import RouteIdError, UnknownScenarioError, UnknownSuiteError
from raw2drive_ros.contracts.near_names import unknown_name
from raw2drive_ros.evaluation.suite_plans import EVENT, TWIN
from raw2drive_ros.settings import params_folder
from raw2drive_ros.simulation.route_id import RouteId
from raw2drive_ros.simulation.scenario import get_scenario

FORMAT = 3
DriveKey = tuple[str, int, bool]


@dataclass(frozen=True, slots=True)
class LimitRule:
    """A drive's time limit: `factor` times the reference driver's own time, plus `extra_s`."""

    factor: float = 1.25
    extra_s: float = 5.0

    def limit_s(self, reference_s: float) -> float:
        return round(self.factor * reference_s + self.extra_s, 2)


@dataclass(frozen=True, slots=True)
class Timing:
    """limit_s: after which the drive fails. reference_s: the time of the driver that it was set from."""

    limit_s: float
    reference_s: float | None = None


@dataclass(frozen=True, slots=True)
class Pair:
    """One route of a suite with its drives: event and twin, or the only one."""

    type: str
    seed: int
    drives: tuple[RouteId, ...]


@dataclass(frozen=True, slots=True)
class Suite:
    """A named, versioned list of drives. partners: unseen type -> seen type that it is compared with."""

    name: str
    version: str
    routes: tuple[RouteId, ...]
    timings: Mapping[DriveKey, Timing] = field(default_factory=dict)
    partners: Mapping[str, str] = field(default_factory=dict)

    def limit_s(self, route: RouteId) -> float | None:
        """Time limit of a drive in any weather and repetition; None where the scene's own holds."""
        timing = self.timings.get(key_of(route))
        return timing.limit_s if timing is not None else None

    def reference_s(self, route: RouteId) -> float | None:
        """Time (s) that the reference driver took for a drive; None where it is not known."""
        timing = self.timings.get(key_of(route))
        return timing.reference_s if timing is not None else None

    def limits_s(self, routes: Iterable[RouteId]) -> dict[RouteId, float]:
        """The limits of those of the routes that have one."""
        found = {route: self.limit_s(route) for route in routes}
        return {route: limit for route, limit in found.items() if limit is not None}

    @property
    def pairs(self) -> tuple[Pair, ...]:
        """The drives by route, in the order of the suite."""
        drives: dict[tuple[str, int], list[RouteId]] = {}
        for route in self.routes:
            drives.setdefault((route.type, route.seed), []).append(route)
        return tuple(Pair(kind, seed, tuple(found)) for (kind, seed), found in drives.items())


def key_of(route: RouteId) -> DriveKey:
    """What a time limit belongs to: not to weather and repetition."""
    return route.type, route.seed, route.twin


def limits_text(limits_s: Mapping[RouteId, float]) -> str:
    """Time limits as one line, for a parameter of a node; `limits_of_text` reads it."""
    return ','.join(f'{route}={limit_s!r}' for route, limit_s in limits_s.items())


def limits_of_text(text: str) -> dict[RouteId, float]:
    """'A/1=31.5,B-twin/2/FogNoon=20' -> time limit (s) by route. Raises RouteIdError, UnknownWeatherError."""
    limits_s: dict[RouteId, float] = {}
    for part in filter(None, map(str.strip, text.split(','))):
        route, _, seconds = part.rpartition('=')
        try:
            limit_s = float(seconds)
        except ValueError:
            limit_s = math.nan
        if not limit_s > 0.0:
            raise RouteIdError(f'time limit {part!r} is not of the form ROUTE=SECONDS')
        limits_s[RouteId.parse(route)] = limit_s
    return limits_s


def suite_folder() -> Path:
    """Folder of the shipped suites."""
    return params_folder() / 'suites'


def suite_names() -> list[str]:
    """Names of the shipped suites."""
    return sorted(path.stem for path in suite_folder().glob('*.json'))


def load_suite(name: str) -> Suite:
    """A shipped suite, or the file at path `name`. Raises UnknownSuiteError."""
    path = Path(name) if name.endswith('.json') else suite_folder() / f'{name}.json'
    try:
        return _suite_of(read_json(path))
    except FileNotFoundError as error:
        text = unknown_name('suite', name, suite_names(), ', or the path of a .json file')
        raise UnknownSuiteError(text) from error
    except UnknownScenarioError as error:
        raise UnknownSuiteError(f'{path}: {error}') from error
    except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
        raise UnknownSuiteError(f'{path}: not a suite: {type(error).__name__}: {error}') from error


def drives_of(kind: str, wanted: Iterable[str] = (EVENT, TWIN)) -> tuple[str, ...]:
    """Which of the wanted drives a type has. Raises UnknownScenarioError."""
    paired = get_scenario(kind).paired
    return tuple(drive for drive in wanted if paired or drive == EVENT)


def _suite_of(body: Any) -> Suite:
    """Raises ValueError, KeyError, TypeError, AttributeError, UnknownScenarioError."""
    if int(body.get('format', 2)) > FORMAT:
        raise ValueError(f'format {body["format"]}; this version reads up to {FORMAT}')
    wanted = tuple(body.get('drives', (EVENT, TWIN)))
    if not wanted or not set(wanted) <= {EVENT, TWIN}:
        raise ValueError(f'drives: {wanted}, not of {EVENT} and {TWIN}')
    routes: list[RouteId] = []
    timings: dict[DriveKey, Timing] = {}
    for kind, places in body['routes'].items():
        drives = drives_of(kind, wanted)
        for place in places:
            if isinstance(place, str):
                # Format 2: SEED/WEATHER, single drives.
                routes.append(RouteId.parse(f'{kind}/{place}'))
                continue
            found = [RouteId.parse(f'{kind}{"-twin" * (drive == TWIN)}/{_place(place)}') for drive in drives]
            routes += found
            timings |= {key_of(route): timing for route, timing in zip(found, _timings(place, drives), strict=False)}
    if len(set(routes)) < len(routes):
        raise ValueError('a route is listed twice')
    partners = {str(unseen): str(seen) for unseen, seen in body.get('partners', {}).items()}
    return Suite(str(body['name']), str(body['version']), tuple(routes), timings, partners)


def _place(entry: Mapping[str, Any]) -> str:
    seed = entry['seed']
    if type(seed) is not int:
        raise ValueError(f'seed {seed!r} is not a whole number')
    return f'{seed}/{entry["weather"]}'


def _timings(entry: Mapping[str, Any], drives: tuple[str, ...]) -> list[Timing]:
    """One per drive, or none where the file sets no limits."""
    if 'limit_s' not in entry:
        return []
    limits = _seconds(entry['limit_s'], drives)
    references = _seconds(entry['reference_s'], drives) if 'reference_s' in entry else [None] * len(drives)
    return [Timing(limit, reference) for limit, reference in zip(limits, references, strict=True)]


def _seconds(values: Any, drives: tuple[str, ...]) -> list[float]:
    if not isinstance(values, list) or len(values) != len(drives):
        raise ValueError(f'{values!r}: not a time for each of {", ".join(drives)}')
    for value in values:
        if type(value) not in (int, float) or not 0.0 < value < math.inf:
            raise ValueError(f'{value!r} is not a time in seconds')
    return [float(value) for value in values]
