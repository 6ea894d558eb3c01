"""raw2drive completion: the script by which a shell completes verbs, options, and names of what is shipped.

shtab makes the script from the parsers, once: at a TAB no Python is started, so that nothing waits for its imports.
"""

from __future__ import annotations

import argparse
import importlib
import json
from pathlib import Path
from typing import Any

SHELLS = ('bash', 'zsh')
EXAMPLES = """examples:
  raw2drive completion bash > ~/.local/share/bash-completion/completions/raw2drive
  raw2drive completion zsh > ~/.zfunc/_raw2drive      with ~/.zfunc in fpath, before compinit
  eval "$(raw2drive completion bash)"                 for this shell only

Make it anew after an update, or when suites, presets or plans of faults were added."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument('shell', choices=SHELLS)


def run(options: argparse.Namespace) -> int:
    import shtab

    print(shtab.complete(_completed_parser(), options.shell))
    return 0


def known_values() -> dict[str, list[str]]:
    """dest of an option -> the names that it takes, as far as they can be listed without heavy imports."""
    from raw2drive_ros.evaluation.drivers import DRIVER_NAMES
    from raw2drive_ros.settings import params_folder, preset_names
    from raw2drive_ros.simulation.camera_rig import SIZES
    from raw2drive_ros.simulation.weather import WEATHER_NAMES

    def stems(folder: str, ending: str) -> list[str]:
        return sorted(path.stem for path in (params_folder() / folder).glob(f'*{ending}'))

    suites, drivers, plans = stems('suites', '.json'), list(DRIVER_NAMES), stems('faults', '.yaml')
    types = scenario_types()
    return {
        'driver': drivers,
        'against': drivers,
        'suite': suites,
        'preset': preset_names(),
        'recipe': stems('recipes', '.yaml'),
        'plans': plans,
        'fault_plans': plans,
        'weather': list(WEATHER_NAMES),
        'size': list(SIZES),
        'scenario': types,
        'routes': ['all', 'lane-following', *types],
        # Of `scenario` and of `suite`, the only verbs with an argument of this name.
        'name': [*suites, *types],
    }


def scenario_types() -> list[str]:
    """The names of all scenario types, from the shipped suites: the simulation takes long to import."""
    from raw2drive_ros.settings import params_folder

    suites = [json.loads(path.read_text()) for path in (params_folder() / 'suites').glob('*.json')]
    return sorted({kind for suite in suites for kind in suite['routes']} | {'LaneFollowing', 'JunctionTurns'})


def _completed_parser() -> argparse.ArgumentParser:
    """Every verb with its options; a verb of two words is a subcommand of the first."""
    import shtab

    from raw2drive_ros.cli.main import VERBS

    values = known_values()

    class NamingParser(argparse.ArgumentParser):
        """Gives options the values that the shell is to offer."""

        def add_argument(self, *names: Any, **given: Any) -> argparse.Action:
            action = super().add_argument(*names, **given)
            if action.choices is None and action.dest in values:
                action.choices = values[action.dest]
            elif action.type is Path:
                action.complete = shtab.FILE  # type: ignore[attr-defined]
            return action

    parser = NamingParser('raw2drive')
    parser.add_argument('--version', action='store_true')
    verbs = parser.add_subparsers()
    made: dict[str, argparse.ArgumentParser] = {}
    for verb, (module, line) in VERBS.items():
        first, _, second = verb.partition(' ')
        parent = made[first].add_subparsers() if second else verbs
        made[verb] = parent.add_parser(second or first, help=line, description=line)
        importlib.import_module(f'raw2drive_ros.cli.{module}').add_arguments(made[verb])
    return parser
