"""How a scenario is declared: a `Scene` drawn from a seeded generator, and a registry by name.

A new scenario type is one function in `scenarios/`, registered under its Bench2Drive name.
"""

from __future__ import annotations

import importlib
import math
import pkgutil
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from raw2drive_ros.contracts.errors import UnknownScenarioError
from raw2drive_ros.contracts.near_names import unknown_name
from raw2drive_ros.simulation.draws import Draw
from raw2drive_ros.simulation.layout import RoadLayout
from raw2drive_ros.simulation.scripts import Pacing, Script

if TYPE_CHECKING:
    from raw2drive_ros.simulation.world import World

DRAW_ATTEMPTS = 200


@dataclass(frozen=True, slots=True)
class LaneChange:
    """Move the route to lane `to_lane` between `s_m` and `s_m + over_m`. -1 is the oncoming lane next to the
    centre line; fractions keep the car between lanes."""

    s_m: float
    to_lane: float
    over_m: float = 30.0


@dataclass(frozen=True, slots=True)
class RouteSpec:
    """The ego's route: along the forward chain (or from the on-ramp, or to the off-ramp), in a lane, with lane changes.

    lane: where it starts; a fraction is a place beside the lanes, e.g. a parking bay. detour: lane changes of a path
    around an obstacle. The route itself stays in its lane: drivers have to find the detour themselves.
    """

    lane: float = 0
    changes: tuple[LaneChange, ...] = ()
    detour: tuple[LaneChange, ...] = ()
    from_ramp: bool = False
    to_exit: bool = False
    start_s_m: float = 6.0
    start_speed_mps: float = 0.0
    end_before_m: float = 3.0


@dataclass(frozen=True, slots=True)
class TrafficSpec:
    """One vehicle on a path: `forward` (a lane of the ego's road), `backward`, `ramp`, or a crossing
    (`('left', 'right')`, ...) of junction `junction`. `s_m` is along that path.

    meets_ego: once its scripts have started it, it adapts its speed to arrive at the crossing point together with the
    ego, until either is near. has_priority: does not brake for an ego that crosses its path. enters_at_s: when it
    enters the world, or later, once its place is free. pacing: keeps its distance to the ego for a while.
    waits_for_s_m: `enters_at_s` counts from when the ego reaches this arc length of the route. ends_at_s_m: arc length
    of its path at which it is removed.
    """

    on: str | tuple[str, str]
    s_m: float
    speed_mps: float
    lane: int = 0
    target_speed_mps: float | None = None
    kind: str = 'car'
    scripts: tuple[Script, ...] = ()
    ignores_traffic: bool = False
    junction: int = 0
    obeys_light: bool = False
    lateral_m: float = 0.0
    meets_ego: bool = False
    has_priority: bool = False
    enters_at_s: float = 0.0
    pacing: Pacing | None = None
    time_gap_s: float = 1.2
    waits_for_s_m: float = 0.0
    ends_at_s_m: float = math.inf


@dataclass(frozen=True, slots=True)
class WalkerSpec:
    """A pedestrian or cyclist beside the route at `s_m`, who crosses from lateral offset `from_m` to `to_m` (left
    positive); timing: `actors.Walker`."""

    s_m: float
    from_m: float
    to_m: float
    speed_mps: float
    delay_s: float
    kind: str = 'walker'


@dataclass(frozen=True, slots=True)
class StandingSpec:
    """A parked car, barrier or cone at (`s_m`, `lateral_m`) of the route, turned by `yaw_rad`."""

    kind: str
    s_m: float
    lateral_m: float
    yaw_rad: float = 0.0


@dataclass(frozen=True, slots=True)
class DoorSpec:
    """The door of a car parked at `s_m`. hinge_m: lateral offset (left positive) of its side that faces the route."""

    s_m: float
    hinge_m: float
    trigger_m: float


@dataclass(frozen=True, slots=True)
class DisturbanceSpec:
    """Between `s_m` and `s_m + length_m` of the route: the steering command is disturbed by `steer` (share of full
    lock), to alternating sides for `period_s` each, and only a share `grip` of drive and brake force is transmitted."""

    s_m: float
    length_m: float
    steer: float
    grip: float = 1.0
    period_s: float = 1.3


ActorSpec = TrafficSpec | WalkerSpec | StandingSpec | DoorSpec


@dataclass(frozen=True, slots=True)
class LightSpec:
    """A traffic light at junction `junction` for the ego's approach."""

    junction: int
    phases: tuple[tuple[str, float], ...]
    trigger_m: float = 45.0


@dataclass(frozen=True, slots=True)
class StopSignSpec:
    """A stop sign at junction `junction` for the ego's approach."""

    junction: int


@dataclass(frozen=True, slots=True)
class Scene:
    """One draw of a scenario: the complete specification that a `World` is built from.

    event_s_m: (begin, end) of the stretch of the route where the event happens, which the ego has to leave in time
    (`criteria.SCENARIO_S`). later_events_s_m: those of the other scenes of a chain.
    """

    layout: RoadLayout
    route: RouteSpec = RouteSpec()
    actors: tuple[ActorSpec, ...] = ()
    lights: tuple[LightSpec, ...] = ()
    stop_signs: tuple[StopSignSpec, ...] = ()
    time_limit_s: float | None = None
    disturbances: tuple[DisturbanceSpec, ...] = ()
    event_s_m: tuple[float, float] | None = None
    later_events_s_m: tuple[tuple[float, float], ...] = ()

    @property
    def events_s_m(self) -> tuple[tuple[float, float], ...]:
        """Every stretch with an event."""
        return ((self.event_s_m,) if self.event_s_m is not None else ()) + self.later_events_s_m


def no_extra_rule(world: World) -> str | None:
    """The default success rule: nothing beyond the common criteria."""
    return None


@dataclass(frozen=True, slots=True)
class Scenario:
    """A scenario type. rule: returns the name of an infraction that only this type has, or None. paired: it has a twin,
    in which what the type is about does not happen."""

    name: str
    abilities: tuple[str, ...]
    draw: Callable[[Draw], Scene]
    rule: Callable[[World], str | None] = no_extra_rule
    description: str = field(default='', compare=False)
    paired: bool = False


REGISTRY: dict[str, Scenario] = {}


def scenario(
    name: str,
    *abilities: str,
    rule: Callable[[World], str | None] = no_extra_rule,
) -> Callable[[Callable[[Any], Scene]], Callable[[Any], Scene]]:
    """Register the decorated draw function as scenario type `name`. It takes a `Draw`; types of version 2 take an
    `Rng`, and have no twin."""

    def register(draw: Callable[[Any], Scene]) -> Callable[[Any], Scene]:
        if name in REGISTRY:
            raise ValueError(f'scenario {name} is registered twice')
        summary = (draw.__doc__ or '').strip().splitlines()
        takes_draw = 'Draw' in draw.__annotations__.values()

        def draw_scene(parameters: Draw) -> Scene:
            return draw(parameters if takes_draw else parameters.rng)

        paired = takes_draw and bool(abilities)
        REGISTRY[name] = Scenario(name, abilities, draw_scene, rule, summary[0] if summary else '', paired)
        return draw

    return register


def load_scenarios() -> dict[str, Scenario]:
    """Every scenario type by name; importing a module of `scenarios/` registers its types."""
    from raw2drive_ros.simulation import scenarios

    for module in sorted(m.name for m in pkgutil.iter_modules(scenarios.__path__)):
        importlib.import_module(f'{scenarios.__name__}.{module}')
    return dict(sorted(REGISTRY.items()))


def get_scenario(name: str) -> Scenario:
    """The scenario type registered as `name`. Raises UnknownScenarioError."""
    known = load_scenarios()
    if name not in known:
        raise UnknownScenarioError(unknown_name('scenario', name, known, ' (see `raw2drive scenario list`)'))
    return known[name]
