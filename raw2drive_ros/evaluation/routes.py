"""Which routes an evaluation drives: by name."""

from __future__ import annotations

from raw2drive_ros.simulation.route_id import RouteId
from raw2drive_ros.simulation.scenario import UnknownScenarioError, load_scenarios
from raw2drive_ros.simulation.weather import CLEAR, get_weather

# Of routes that are named on the command line; suites carry their own.
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
            raise UnknownScenarioError(f'unknown routes {part!r}; use all, an ability, or one of: {", ".join(known)}')
    return [
        RouteId(scenario, seed, get_weather(weather).name)
        for scenario in dict.fromkeys(chosen)
        for seed in range(first_seed, first_seed + seeds)
    ]
