"""Suites: versioned lists of routes in `params/suites/`, and how they are drawn.

A route is a scenario type, a seed and a weather. Evaluation suites use seeds below `VALIDATION_SEED_START`, training
suites seeds from `TRAIN_SEED_START` on; checkpoints are selected on the seeds between them.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from raw2drive_ros.bounds import read_json
from raw2drive_ros.contracts.errors import UnfairScenarioError, UnknownScenarioError, UnknownSuiteError
from raw2drive_ros.contracts.near_names import unknown_name
from raw2drive_ros.evaluation.oracle import Plan, follow, hits
from raw2drive_ros.settings import params_folder
from raw2drive_ros.simulation.actors import StandingObject, boxes_overlap, corners_m
from raw2drive_ros.simulation.draws import TRAIN_SEED_START, VALIDATION_SEED_START, Draw
from raw2drive_ros.simulation.route_id import RouteId
from raw2drive_ros.simulation.scenario import get_scenario, load_scenarios
from raw2drive_ros.simulation.weather import WEATHER_NAMES
from raw2drive_ros.simulation.world import World
from raw2drive_ros.tables.rates import DECISION_HZ, SUBSTEPS

ROLLOUT_S = 20.0
CHECK_EVERY_TICKS = 3
DRAW_LIMIT = 60
PRACTICE = ('LaneFollowing', 'JunctionTurns', 'LongRoute')
# Bench2Drive's ten types for quick evaluations (spec 4.7).
DEV10 = (
    'ParkingExit',
    'ParkingCrossingPedestrian',
    'StaticCutIn',
    'HazardAtSideLane',
    'YieldToEmergencyVehicle',
    'ConstructionObstacleTwoWays',
    'NonSignalizedJunctionLeftTurn',
    'BlockedIntersection',
    'SequentialLaneChange',
    'SignalizedJunctionLeftTurnEnterFlow',
)


@dataclass(frozen=True, slots=True)
class Suite:
    """A named, versioned list of routes."""

    name: str
    version: str
    routes: tuple[RouteId, ...]


@dataclass(frozen=True, slots=True)
class SuitePlan:
    """How a suite is drawn: `per_type` routes of each type, from `first_seed` on."""

    types: tuple[str, ...]
    per_type: int
    first_seed: int


def benchmark_types() -> tuple[str, ...]:
    """The 44 types of Bench2Drive."""
    return tuple(name for name in load_scenarios() if name not in PRACTICE)


def suite_plans() -> dict[str, SuitePlan]:
    """Name of each shipped suite -> how it is drawn."""
    types = benchmark_types()
    return {
        'b2d220': SuitePlan(types, 5, 0),
        'dev10': SuitePlan(DEV10, 1, 0),
        'long': SuitePlan(('LongRoute',), 12, 0),
        'validation': SuitePlan(types, 2, VALIDATION_SEED_START),
        'train': SuitePlan(types, 24, TRAIN_SEED_START),
    }


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
        body = read_json(path)
        routes = tuple(RouteId.parse(f'{kind}/{rest}') for kind, places in body['routes'].items() for rest in places)
        suite = Suite(str(body['name']), str(body['version']), routes)
    except FileNotFoundError as error:
        text = unknown_name('suite', name, suite_names(), ', or the path of a .json file')
        raise UnknownSuiteError(text) from error
    except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
        raise UnknownSuiteError(f'{path}: not a suite: {type(error).__name__}: {error}') from error
    for kind in {route.type for route in suite.routes}:
        try:
            get_scenario(kind)
        except UnknownScenarioError as error:
            raise UnknownSuiteError(f'{path}: {error}') from error
    return suite


def draw_suite(
    plan: SuitePlan, on_route: Callable[[int], None] = lambda done: None
) -> tuple[dict[str, list[str]], int]:
    """({type: ['seed/weather', ...]}, number of rejected draws). on_route: called with the number of routes so far.

    Raises UnfairScenarioError for a type of which `DRAW_LIMIT` draws are rejected, see `is_fair`.
    """
    found: dict[str, list[str]] = {}
    rejected = done = 0
    for kind in plan.types:
        places: list[str] = []
        seed = plan.first_seed
        while len(places) < plan.per_type:
            if is_fair(kind, seed):
                places.append(f'{seed}/{weather_of(kind, seed)}')
                done += 1
                on_route(done)
            else:
                rejected += 1
            if seed - plan.first_seed - len(places) >= DRAW_LIMIT:
                raise UnfairScenarioError(f'{kind}: {DRAW_LIMIT} draws rejected; its actors crash among themselves')
            seed += 1
        found[kind] = places
    return found, rejected


def weather_of(kind: str, seed: int) -> str:
    """Name of a route's weather: in order of the presets from seed to seed, offset by five from type to type."""
    number = list(load_scenarios()).index(kind)
    return WEATHER_NAMES[(5 * number + seed) % len(WEATHER_NAMES)]


def is_fair(kind: str, seed: int) -> bool:
    """Whether no actor overlaps the ego at the start, and no actors collide with each other before the ego does."""
    world = World(get_scenario(kind), Draw(kind, seed))
    if hits(world, margin_m=0.5):
        return False
    for tick in range(round(ROLLOUT_S * DECISION_HZ)):
        if tick % CHECK_EVERY_TICKS == 0 and _actors_touch(world):
            return False
        control = follow(world, Plan(0.8))
        for _ in range(SUBSTEPS):
            world.step(control)
        if hits(world, margin_m=0.0) or world.goal_s_m - world.route_s_m < 10.0:
            return True
    return True


def _actors_touch(world: World) -> bool:
    """Whether two actors overlap, of which at least one is not a standing object."""
    count = len(world.actors)
    if count < 2:
        return False
    reach = np.hypot(world.half_lengths[:-1], world.half_widths[:-1])
    place = world.positions[:-1]
    apart = np.hypot(*(place[:, None] - place[None]).transpose(2, 0, 1)) - reach[:, None] - reach[None]
    for i, j in zip(*np.nonzero(np.triu(apart < 0.0, 1)), strict=True):
        a, b = world.actors[i], world.actors[j]
        if isinstance(a, StandingObject) and isinstance(b, StandingObject):
            continue
        boxes = [corners_m(float(c.position[0]), float(c.position[1]), c.heading, c.LENGTH, c.WIDTH) for c in (a, b)]
        if boxes_overlap(*boxes):
            return True
    return False
