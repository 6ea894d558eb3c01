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
from raw2drive_ros.simulation.scripts import Meeting, Pacing, Script

if TYPE_CHECKING:
    from raw2drive_ros.simulation.world import World

DRAW_ATTEMPTS = 200
DENSITIES = ('none', 'light', 'medium', 'dense')
LANE_CLASSES = ('own', 'beside', 'oncoming', 'cross')


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
class AlongRoad:
    """A place on the ego's road. at_m: station on the forward chain, for oncoming vehicles too. lane: counted from the
    centre line outwards."""

    at_m: float
    lane: int = 0
    oncoming: bool = False


@dataclass(frozen=True, slots=True)
class AcrossJunction:
    """A place before junction `junction`, on the way from arm `source` to arm `target` (left, right, ahead, or back,
    where the ego comes from). before_m: of the front bumper before the stop line; negative beyond it."""

    junction: int
    source: str
    target: str
    before_m: float = 20.0
    lane: int = 0


@dataclass(frozen=True, slots=True)
class OnRamp:
    """A place on the on-ramp, `at_m` along it; its path goes on in the rightmost lane of the main road."""

    at_m: float


Place = AlongRoad | AcrossJunction | OnRamp


@dataclass(frozen=True, slots=True)
class CarSpec:
    """A vehicle that follows lanes from edge to edge of the map, with right of way, lights and indicators.

    then: its turn at each junction after `place` (left, ahead, right as it sees them; 'chain': along the ego's road,
    which is also what it does when `then` is used up). target_speed_mps: None for `speed_mps`; below 0.05 it stands
    until a script sets another. yields: keeps to the right of way; False: all others wait for it, it waits for nobody.
    obeys_lights: red lights. ignores_traffic: reacts to nobody at all. ignores_ego: not to a moving ego. meets_ego:
    arrives together with the ego where their ways cross (`AcrossJunction` only). pacing: see `Pacing` and `Meeting`.
    lateral_m: to the left of its lane's middle. waits_for_s_m: it is built when the ego reaches this arc length of the
    route.
    """

    place: Place
    speed_mps: float
    target_speed_mps: float | None = None
    kind: str = 'car'
    scripts: tuple[Script, ...] = ()
    then: tuple[str, ...] = ()
    lateral_m: float = 0.0
    yields: bool = True
    obeys_lights: bool = True
    ignores_traffic: bool = False
    ignores_ego: bool = False
    meets_ego: bool = False
    pacing: Pacing | Meeting | None = None
    time_gap_s: float = 1.2
    waits_for_s_m: float = 0.0


@dataclass(frozen=True, slots=True)
class FlowSpec:
    """An endless stream past a point: where its way crosses the ego's route, or `place` itself.

    Platoons with `headway_s` between cars at the point, too short to use, alternate with usable gaps of `gap_s`, for as
    long as the ego waits. Until the ego is within `armed_within_m` of the point (along its route) the platoon has no
    end; it ends `first_gap_after_s` later, or when the cars that are in sight have passed. Platoons after the first gap
    last `platoon_s`. last_passes_m: of twins: the stream ends for good, its last car passes the point when the ego is
    this far away from it. yields: by default all others wait for these cars. Vehicles appear out of sight.
    from_s_m, until_s_m: arc lengths of the route between which the ego has to be for the stream to exist.
    """

    place: Place
    speed_mps: float
    headway_s: tuple[float, float] = (1.4, 1.75)
    gap_s: tuple[float, float] = (6.5, 8.5)
    platoon_s: tuple[float, float] = (8.0, 14.0)
    first_gap_after_s: float = 16.0
    armed_within_m: float = 30.0
    last_passes_m: float | None = None
    kind: str = 'car'
    then: tuple[str, ...] = ()
    lateral_m: float = 0.0
    yields: bool = False
    obeys_lights: bool = True
    ignores_ego: bool = False
    from_s_m: float = 0.0
    until_s_m: float = math.inf


@dataclass(frozen=True, slots=True)
class BackgroundSpec:
    """Traffic that wants nothing, renewed out of sight for as long as the drive lasts.

    density: none, light, medium or dense. parked: share of the places beside the road with a parked car. bystanders,
    cyclists: number per 100 m of road, and on the whole road. lanes: own (the ego's), beside (others in its direction),
    oncoming, cross (arms of junctions). No background uses a lane that leads to the point of a `FlowSpec`, nor one that
    a standing object blocks. clear_m: stretch of the route beside which nobody stands or is parked, so that an obstacle
    may be in the lane or beside it.
    """

    density: str = 'medium'
    parked: float = 0.0
    bystanders: int = 0
    cyclists: int = 0
    lanes: tuple[str, ...] = ('own', 'beside', 'oncoming', 'cross')
    clear_m: tuple[float, float] | None = None

    def __post_init__(self) -> None:
        if self.density not in DENSITIES or not set(self.lanes) <= set(LANE_CLASSES):
            raise ValueError(f'BackgroundSpec: density is one of {DENSITIES}, lanes of {LANE_CLASSES}')


@dataclass(frozen=True, slots=True)
class WalkerSpec:
    """A pedestrian or cyclist beside the route at `s_m`, who crosses from lateral offset `from_m` to `to_m` (left
    positive); timing: `actors.Walker`. happens: False for one who stands and looks, in twins."""

    s_m: float
    from_m: float
    to_m: float
    speed_mps: float
    delay_s: float
    kind: str = 'walker'
    happens: bool = True


@dataclass(frozen=True, slots=True)
class StandingSpec:
    """A parked car, barrier or cone at (`s_m`, `lateral_m`) of the route, turned by `yaw_rad`."""

    kind: str
    s_m: float
    lateral_m: float
    yaw_rad: float = 0.0


@dataclass(frozen=True, slots=True)
class DoorSpec:
    """The door of a car parked at `s_m`. hinge_m: lateral offset (left positive) of its side that faces the route.
    due_s: it begins to open so long before the ego's front gets there. happens: False for one that stays shut, in
    twins."""

    s_m: float
    hinge_m: float
    due_s: float
    happens: bool = True


@dataclass(frozen=True, slots=True)
class DisturbanceSpec:
    """Between `s_m` and `s_m + length_m` of the route: the steering command is disturbed by `steer` (share of full
    lock), to alternating sides for `period_s` each, and only a share `grip` of drive and brake force is transmitted."""

    s_m: float
    length_m: float
    steer: float
    grip: float = 1.0
    period_s: float = 1.3


ActorSpec = TrafficSpec | CarSpec | FlowSpec | WalkerSpec | StandingSpec | DoorSpec


@dataclass(frozen=True, slots=True)
class LightSpec:
    """The traffic light of junction `junction`, as the ego's approach sees it; all others follow from it.

    phases: (green or red, seconds), see `signals.TrafficLight`: amber is the beginning of a red phase. held: arms that
    stay red while the ego has green. repeats: the phases begin again after the last one, else that one lasts.
    """

    junction: int
    phases: tuple[tuple[str, float], ...]
    trigger_m: float = 45.0
    held: tuple[str, ...] = ()
    repeats: bool = False


@dataclass(frozen=True, slots=True)
class StopSignSpec:
    """A stop sign at junction `junction` for the ego's approach."""

    junction: int


@dataclass(frozen=True, slots=True)
class Scene:
    """One draw of a scenario: the complete specification that a `World` is built from.

    background: None for version 2's types, which have no traffic but their own. event_s_m: (begin, end) of the stretch
    of the route where the event happens, which the ego has to leave in time (`criteria.SCENARIO_S`). later_events_s_m:
    those of the other scenes of a chain.
    """

    layout: RoadLayout
    route: RouteSpec = RouteSpec()
    actors: tuple[ActorSpec, ...] = ()
    lights: tuple[LightSpec, ...] = ()
    stop_signs: tuple[StopSignSpec, ...] = ()
    time_limit_s: float | None = None
    disturbances: tuple[DisturbanceSpec, ...] = ()
    background: BackgroundSpec | None = None
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
