"""The sightless drivers: what they may try, and what was chosen for each type (`params/sightless/`).

`raw2drive suite tune` chooses on training routes, under the time limits that a suite would set there; the registry
drives with what it wrote. None of them gets the reference path past obstacles.
"""

from __future__ import annotations

import itertools
import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import Any

from raw2drive_ros.artifact import short_hash, write_whole
from raw2drive_ros.bounds import read_json
from raw2drive_ros.contracts.errors import ConfigError
from raw2drive_ros.contracts.public import Control
from raw2drive_ros.evaluation.memoriser import MemoryDriver, Recorded, Replay
from raw2drive_ros.evaluation.sightless import FASTEST_MPS, Profile, ProfileDriver, Stop
from raw2drive_ros.evaluation.world_drivers import WorldDriver
from raw2drive_ros.settings import params_folder
from raw2drive_ros.simulation.world import World

Way = Profile | Replay
# Beside the route, where a car fits between two lanes.
STRADDLE_M = 2.15
SPEEDS_MPS = (1.0, 1.5, 2.0, 2.5, 3.0, 4.0, 5.0, 6.0, 8.0, 10.0, 12.0)
SHARES = (1.0, 0.85, 1.15, 0.7, 1.3, 0.5)
WAITS_S = (2.0, 4.0, 6.0, 8.0, 10.0, 12.0, 15.0, 20.0, 25.0, 30.0, 40.0)
PLACES = (0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8)
STANDS_S = (3.0, 6.0, 10.0, 15.0)
SLOW_MPS = (2.0, 4.0, 6.0)


def _creep() -> Iterator[Profile]:
    for wait_s, speed in itertools.product((0.0, 5.0, 10.0), (FASTEST_MPS, *reversed(SPEEDS_MPS))):
        yield Profile(speed, wait_s=wait_s, sensor=True)


def _wait() -> Iterator[Profile]:
    for share, wait_s in itertools.product((1.0, 1.3, 0.8), WAITS_S):
        yield Profile(share=share, wait_s=wait_s)


def _crawl() -> Iterator[Profile]:
    for speed in SPEEDS_MPS:
        yield Profile(speed)


def _straddle(offset_m: float) -> Iterator[Profile]:
    for speed in (FASTEST_MPS, 8.0, 5.0, 3.0, 2.0):
        yield Profile(speed, offset_m=offset_m)


def _blind() -> Iterator[Profile]:
    for turn_stop_s, share in itertools.product((0.0, 1.0, 3.0, 6.0, 10.0), SHARES):
        yield Profile(share=share, turn_stop_s=turn_stop_s)


def _profile() -> Iterator[Profile]:
    """Everything that is laid down in advance: constant speeds, waits, a stop or a slow stretch somewhere."""
    yield from itertools.chain(_crawl(), _wait(), _blind())
    for share, at, for_s in itertools.product((1.0, 1.3, 0.8), PLACES, STANDS_S):
        yield Profile(share=share, stops=(Stop(at, for_s),))
    for share, speed, at in itertools.product((1.0, 1.3), SLOW_MPS, PLACES):
        yield Profile(share=share, slow=(at, at + 0.25, speed))


def _replays() -> Iterator[Replay]:
    for clock, twin, lateral in itertools.product((True, False), (False, True), (True, False)):
        yield Replay(twin, clock, lateral)


@dataclass(frozen=True, slots=True)
class Family:
    """ways: all that may be tried, best guesses first. refined: more is tried around the best of them."""

    ways: Callable[[], Iterator[Way]]
    refined: bool = False


FAMILIES: dict[str, Family] = {
    'creep': Family(_creep),
    'wait': Family(_wait),
    'crawl': Family(_crawl),
    'straddle_left': Family(lambda: _straddle(STRADDLE_M)),
    'straddle_right': Family(lambda: _straddle(-STRADDLE_M)),
    'blind': Family(_blind),
    'memoriser': Family(_replays),
    'profile': Family(_profile, refined=True),
}
# The best of all families, type by type.
SCRIPT = 'script'
SIGHTLESS = (*FAMILIES, SCRIPT)


@dataclass(frozen=True, slots=True)
class Choice:
    """The way of driving that a family takes on a type; won, of: pairs of training routes."""

    family: str
    way: Way
    won: int = 0
    of: int = 0


@dataclass(frozen=True, slots=True)
class Tuned:
    """choices: family or `script` -> type -> choice. memories: of the memoriser."""

    choices: Mapping[str, Mapping[str, Choice]] = field(default_factory=dict)
    memories: tuple[Recorded, ...] = ()

    def choice(self, name: str, kind: str) -> Choice:
        """What sightless driver `name` does on a type; the family's first way where nothing was chosen."""
        found = self.choices.get(name, {}).get(kind)
        if found is not None:
            return found
        family = 'blind' if name == SCRIPT else name
        return Choice(family, next(FAMILIES[family].ways()))


def best_of(choices: Sequence[Choice]) -> Choice:
    """The one that won most; the first of equals."""
    return max(choices, key=lambda choice: choice.won)


def decider(way: Way, memories: Sequence[Recorded]) -> Callable[[World], Control]:
    """A decision function for one drive."""
    return ProfileDriver(way).control if isinstance(way, Profile) else MemoryDriver(memories, way).control


def sightless_driver(name: str, tuned: Tuned | None = None) -> WorldDriver:
    """Driver `name` of `SIGHTLESS`. tuned: None: what is shipped. Raises ConfigError."""
    chosen = shipped() if tuned is None else tuned

    def make(seed: int) -> Callable[[World], Control]:
        decide: Callable[[World], Control] | None = None

        def control(world: World) -> Control:
            nonlocal decide
            if decide is None:
                decide = decider(chosen.choice(name, world.scenario.name).way, chosen.memories)
            return decide(world)

        return control

    return WorldDriver(make)


# -- files ------------------------------------------------------------------------------------------


def tuned_folder() -> Path:
    """Where the registry's sightless drivers take their choices from."""
    return params_folder() / 'sightless'


@cache
def shipped() -> Tuned:
    """What was chosen for the shipped suites; nothing where the folder is missing. Raises ConfigError."""
    folder = tuned_folder()
    return load_tuned(folder) if folder.is_dir() else Tuned()


def tuned_identity() -> str:
    """A hash of what was chosen for the shipped drivers, which identifies their results."""
    texts = [path.read_bytes() for path in sorted(tuned_folder().glob('*.json'))]
    return short_hash(b'\n'.join(texts))


def load_tuned(folder: Path) -> Tuned:
    """What `save_tuned` wrote. Raises ConfigError."""
    try:
        body = read_json(folder / 'choices.json')
        choices = {
            name: {kind: _choice(name, values) for kind, values in of_type.items()}
            for name, of_type in body.items()
            if name in SIGHTLESS
        }
        stored = read_json(folder / 'memories.json')
        memories = tuple(Recorded.from_stored(kind, entry) for kind, drives in stored.items() for entry in drives)
    except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
        raise ConfigError(f'{folder}: not choices of sightless drivers: {type(error).__name__}: {error}') from error
    return Tuned(choices, memories)


def _choice(name: str, values: Mapping[str, Any]) -> Choice:
    family = str(values['family'])
    if family not in FAMILIES or name not in (family, SCRIPT):
        raise ValueError(f'family {family!r} of driver {name}')
    read = Replay.from_stored if family == 'memoriser' else Profile.from_stored
    return Choice(family, read(values['way']), int(values['won']), int(values['of']))


def save_tuned(folder: Path, tuned: Tuned) -> None:
    """Write choices and memories, a line per type and drive."""
    folder.mkdir(parents=True, exist_ok=True)
    choices = {
        name: {
            kind: {'family': c.family, 'way': c.way.stored(), 'won': c.won, 'of': c.of}
            for kind, c in sorted(of_type.items())
        }
        for name, of_type in tuned.choices.items()
    }
    write_whole(folder / 'choices.json', _lines(choices))
    drives: dict[str, dict[str, Any]] = {}
    for memory in sorted(tuned.memories, key=lambda m: (m.type, m.seed, m.twin)):
        drives.setdefault(memory.type, {})[f'{memory.seed}{memory.twin}'] = memory.stored()
    rows = [
        f'{json.dumps(kind)}: [\n' + ',\n'.join(json.dumps(entry, separators=(',', ':')) for entry in entries.values())
        for kind, entries in drives.items()
    ]
    write_whole(folder / 'memories.json', '{\n' + '\n],\n'.join(rows) + ('\n]' if rows else '') + '\n}\n')


def _lines(table: Mapping[str, Mapping[str, Any]]) -> str:
    """Two levels of JSON, one line per entry of the second."""
    parts = [
        f'{json.dumps(name)}: {{\n'
        + ',\n'.join(f'  {json.dumps(key)}: {json.dumps(value)}' for key, value in inner.items())
        + '\n}'
        for name, inner in table.items()
    ]
    return '{\n' + ',\n'.join(parts) + '\n}\n'
