"""How far the scenes of one suite are from those of another: the distance of their key parameters.

A scene whose nearest neighbour in another split is nearer than `draws.GAP` is a near-copy: a driver could repeat what
it learned by heart. Scenes of types without key parameters are compared whole: equal, or not comparable.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass

from raw2drive_ros.evaluation.suites import Suite
from raw2drive_ros.simulation.draws import GAP, Draw, Parameter, distance
from raw2drive_ros.simulation.scenario import get_scenario
from raw2drive_ros.simulation.world import World

ADDRESS = re.compile(r' at 0x[0-9a-f]+')
DUPLICATE, NEAR_COPY, APART, UNKNOWN, NEW_TYPE = 'duplicate', 'near-copy', 'apart', 'not comparable', 'new type'
EQUAL = 1e-9
# Scenes of different splits differ by `GAP` at least, up to the rounding of floating point.
NEAREST = GAP - 1e-6


@dataclass(frozen=True, slots=True)
class SceneKey:
    """What a scene is compared by. parameters: the key ones. text: the whole scene, for types without any."""

    type: str
    seed: int
    parameters: Mapping[str, Parameter]
    text: str


@dataclass(frozen=True, slots=True)
class Nearest:
    """The nearest scene of another suite. distance: None where there is nothing to compare."""

    type: str
    seed: int
    other: int | None
    distance: float | None
    verdict: str


def scene_key(kind: str, seed: int) -> SceneKey:
    """The scene of a type and seed. Raises UnknownScenarioError, LayoutError."""
    world = World(get_scenario(kind), Draw(kind, seed))
    keys = {name: parameter for name, parameter in world.draw.parameters.items() if parameter.key}
    return SceneKey(kind, seed, keys, '' if keys else ADDRESS.sub('', repr(world.scene)))


def apart(one: SceneKey, other: SceneKey) -> float | None:
    """Distance in [0, 1] of two scenes of one type; None where they have no key parameters and differ."""
    if one.parameters or other.parameters:
        return distance(dict(one.parameters), dict(other.parameters))
    return 0.0 if one.text == other.text else None


def nearest_scenes(
    a: Suite, b: Suite, near_copy: float = NEAREST, on_scene: Callable[[int, str], None] = lambda done, note: None
) -> list[Nearest]:
    """For each scene of A the nearest of B; a scene is not compared with itself. near_copy: smaller distances are."""
    places_a = [(pair.type, pair.seed) for pair in a.pairs]
    types = {kind for kind, _ in places_a}
    places_b = [(pair.type, pair.seed) for pair in b.pairs if pair.type in types]
    keys: dict[tuple[str, int], SceneKey] = {}
    for place in dict.fromkeys((*places_a, *places_b)):
        keys[place] = scene_key(*place)
        on_scene(len(keys), f'{place[0]}/{place[1]}')
    found = []
    for kind, seed in places_a:
        others = [place for place in places_b if place[0] == kind and place != (kind, seed)]
        distances = [(apart(keys[kind, seed], keys[other]), other[1]) for other in others]
        known = [(distance, other) for distance, other in distances if distance is not None]
        if not others:
            found.append(Nearest(kind, seed, None, None, NEW_TYPE))
        elif not known:
            found.append(Nearest(kind, seed, None, None, UNKNOWN))
        else:
            least, other = min(known)
            verdict = DUPLICATE if least < EQUAL else NEAR_COPY if least < near_copy else APART
            found.append(Nearest(kind, seed, other, least, verdict))
    return found


def total_scenes(a: Suite, b: Suite) -> int:
    """How many scenes `nearest_scenes` draws."""
    types = {pair.type for pair in a.pairs}
    return len({(p.type, p.seed) for p in a.pairs} | {(p.type, p.seed) for p in b.pairs if p.type in types})
