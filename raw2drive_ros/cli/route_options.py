"""Options that choose the routes of a verb: `--routes` and `--seeds`, or `--suite`."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING

from raw2drive_ros.cli.parser import at_least, refuse

if TYPE_CHECKING:
    from raw2drive_ros.simulation.route_id import RouteId


def add_route_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options that `chosen_routes` reads."""
    parser.add_argument('--routes', default='lane-following', help='scenario types, abilities, or all')
    parser.add_argument('--suite', help='a versioned list of routes instead of --routes, see raw2drive suite list')
    parser.add_argument('--ability', help='of the suite, only the types that count for this ability')
    parser.add_argument(
        '--seeds', type=int, help='--routes: routes per scenario type (20); --suite: repetitions of each route (1)'
    )
    parser.add_argument('--first-seed', type=int, default=0, help='--routes: seed of the first route')
    parser.add_argument('--weather', help="drive in this weather (default: the suite's own; --routes: ClearNoon)")


def chosen_routes(options: argparse.Namespace) -> tuple[str, str, list[RouteId]]:
    """(suite, version, routes). Raises UsageError, UnknownSuiteError, UnknownScenarioError, UnknownWeatherError."""
    from dataclasses import replace

    from raw2drive_ros.contracts.errors import UsageError
    from raw2drive_ros.contracts.near_names import did_you_mean
    from raw2drive_ros.evaluation.routes import SUITE_VERSION, routes_of
    from raw2drive_ros.evaluation.suites import load_suite
    from raw2drive_ros.simulation.scenario import load_scenarios
    from raw2drive_ros.simulation.weather import CLEAR, get_weather

    at_least(options, 1, 'seeds')
    at_least(options, 0, 'first_seed')
    if options.weather is not None:
        get_weather(options.weather)
    if options.suite is None:
        if options.ability is not None:
            raise UsageError('--ability goes with --suite; without one use --routes ABILITY')
        seeds = 20 if options.seeds is None else options.seeds
        return (
            options.routes,
            SUITE_VERSION,
            routes_of(options.routes, seeds, options.first_seed, options.weather or CLEAR),
        )
    refuse(options, ['routes', 'first_seed'], 'does not go with --suite, which lists its routes')
    suite = load_suite(options.suite)
    name, routes = suite.name, list(suite.routes)
    if options.ability is not None:
        known = load_scenarios()
        plain = options.ability.replace('-', '').lower()
        routes = [route for route in routes if plain in (a.lower() for a in known[route.type].abilities)]
        if not routes:
            names = sorted({a for s in known.values() for a in s.abilities})
            listed = f'{did_you_mean(plain, names) or ";"} abilities: {", ".join(names)}'
            raise UsageError(f'--ability {options.ability}: no such routes in {suite.name}{listed}')
        name = f'{suite.name}/{options.ability}'
    if options.weather is not None:
        routes = [replace(route, weather=options.weather) for route in routes]
        name = f'{name}/{options.weather}'
    return name, suite.version, [replace(r, repetition=i) for i in range(options.seeds or 1) for r in routes]


def chosen_limits(options: argparse.Namespace, routes: list[RouteId]) -> dict[RouteId, float]:
    """The time limits (s) that the suite sets for these routes; nothing without one. Raises UnknownSuiteError."""
    from raw2drive_ros.evaluation.suites import load_suite

    return {} if options.suite is None else load_suite(options.suite).limits_s(routes)


def chosen_references(options: argparse.Namespace, routes: list[RouteId]) -> dict[RouteId, float]:
    """The times (s) of the driver that the suite's limits were set from; nothing without one. Raises
    UnknownSuiteError."""
    from raw2drive_ros.evaluation.suites import load_suite

    if options.suite is None:
        return {}
    suite = load_suite(options.suite)
    found = {route: suite.reference_s(route) for route in routes}
    return {route: seconds for route, seconds in found.items() if seconds is not None}
