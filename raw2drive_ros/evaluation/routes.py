"""Which routes an evaluation drives: (scenario type, seed) pairs by name."""

from __future__ import annotations

from raw2drive_ros.simulation.scenario import UnknownScenarioError, load_scenarios

SUITE_VERSION = '1'


def routes_of(name: str, seeds: int, first_seed: int = 0) -> list[tuple[str, int]]:
    """`lane-following`, any scenario type, an ability, a comma list, or `all`; `seeds` each, from `first_seed` on.

    Raises UnknownScenarioError.
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
    return [(scenario, seed) for scenario in dict.fromkeys(chosen) for seed in range(first_seed, first_seed + seeds)]
