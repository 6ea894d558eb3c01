"""The routes that a name on the command line stands for."""

from __future__ import annotations

from raw2drive_ros.contracts.errors import UnknownScenarioError
from raw2drive_ros.contracts.near_names import unknown_name
from raw2drive_ros.simulation.route_id import NUMBER, RouteId
from raw2drive_ros.simulation.scenario import load_scenarios
from raw2drive_ros.simulation.weather import CLEAR, get_weather

# Version of routes that are named on the command line; suites carry their own.
SUITE_VERSION = '2'


def routes_of(name: str, seeds: int, first_seed: int = 0, weather: str = CLEAR) -> list[RouteId]:
    """`lane-following`, any scenario type, an ability, a comma list, or `all`; `seeds` each, from `first_seed` on.

    Raises UnknownScenarioError or UnknownWeatherError.
    """
    known = load_scenarios()
    chosen: list[str] = []
    for part in name.split(','):
        plain = part.replace('-', '').lower()
        by_ability = [n for n, s in known.items() if plain in (a.lower() for a in s.abilities)]
        match = [n for n in known if n.lower() == plain]
        if plain == 'all':
            chosen += list(known)
        elif match or by_ability:
            chosen += match or by_ability
        else:
            abilities = {ability for found in known.values() for ability in found.abilities}
            raise UnknownScenarioError(unknown_name('routes', part, ['all', *sorted(abilities), *known]))
    return [
        RouteId(scenario, seed, get_weather(weather).name)
        for scenario in dict.fromkeys(chosen)
        for seed in range(first_seed, first_seed + seeds)
    ]


def weighted_types(name: str) -> tuple[str, ...]:
    """Scenario types for a collector, named as for `routes_of`; `NAME*3` lists each type of NAME three times.

    The order does not matter: the collector permutes it (`collect.episode_route`). Raises UnknownScenarioError.
    """
    chosen: list[str] = []
    for part in name.split(','):
        word, star, times = part.partition('*')
        if star and not (NUMBER.fullmatch(times) and int(times) > 0):
            raise UnknownScenarioError(f'unknown routes {part!r}: a weight is a whole number, as in ParkedObstacle*3')
        chosen += [route.type for route in routes_of(word, 1)] * int(times or 1)
    return tuple(chosen if '*' in name else dict.fromkeys(chosen))
