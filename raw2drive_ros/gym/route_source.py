"""Which route an episode drives: drawn anew for training, or one of a suite."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple, Protocol

import numpy as np

from raw2drive_ros.evaluation.routes import routes_of
from raw2drive_ros.evaluation.suites import Suite, load_suite
from raw2drive_ros.simulation.draws import TRAIN_SEED_START
from raw2drive_ros.simulation.route_id import RouteId
from raw2drive_ros.simulation.scenario import get_scenario
from raw2drive_ros.simulation.weather import WEATHER_NAMES, get_weather

# Training routes have seeds from `TRAIN_SEED_START` on, so many that none comes twice.
TRAIN_SEEDS = 10**9


class Start(NamedTuple):
    """A route, and its time limit; None: the scene's own."""

    route: RouteId
    limit_s: float | None


class RouteSource(Protocol):
    """Where the routes of episodes come from."""

    def draw(self, rng: np.random.Generator) -> Start:
        """The next route."""

    def start(self, route: RouteId) -> Start:
        """A route that the user asks for. Raises UnknownScenarioError."""


@dataclass(frozen=True, slots=True)
class TrainingRoutes:
    """Endless: scenario type, seed, weather, and whether it is the twin, drawn independently of one another.

    types: of scenarios. weathers: names. twins: share of twins among the routes of types that have one.
    """

    types: tuple[str, ...]
    weathers: tuple[str, ...]
    twins: float

    def draw(self, rng: np.random.Generator) -> Start:
        kind = self.types[int(rng.integers(len(self.types)))]
        weather = self.weathers[int(rng.integers(len(self.weathers)))]
        seed = TRAIN_SEED_START + int(rng.integers(TRAIN_SEEDS))
        twin = bool(rng.random() < self.twins) and get_scenario(kind).paired
        return Start(RouteId(kind, seed, weather, twin=twin), None)

    def start(self, route: RouteId) -> Start:
        get_scenario(route.type)
        return Start(route, None)


@dataclass(frozen=True, slots=True)
class SuiteRoutes:
    """One of a suite's routes, each as likely as any other, with the time limit of the suite."""

    suite: Suite
    routes: tuple[RouteId, ...]

    def draw(self, rng: np.random.Generator) -> Start:
        return self.start(self.routes[int(rng.integers(len(self.routes)))])

    def start(self, route: RouteId) -> Start:
        get_scenario(route.type)
        return Start(route, self.suite.limit_s(route))


def route_source(suite: str | None, routes: str, weather: str | None, twins: float) -> RouteSource:
    """What the arguments of the environment of the same names mean. Raises UnknownSuiteError, UnknownScenarioError,
    UnknownWeatherError and, for a share that is none, ValueError."""
    known = get_weather(weather).name if weather is not None else None
    if suite is not None:
        found = load_suite(suite)
        changed = [RouteId(r.type, r.seed, known or r.weather, r.repetition, r.twin) for r in found.routes]
        return SuiteRoutes(found, tuple(changed))
    if not 0.0 <= twins <= 1.0:
        raise ValueError(f'twins {twins}: a share, from 0 to 1')
    types = tuple(dict.fromkeys(route.type for route in routes_of(routes, 1)))
    return TrainingRoutes(types, (known,) if known else WEATHER_NAMES, twins)
