"""Merging at junctions: the ego turns across or into a stream of traffic."""

from __future__ import annotations

from raw2drive_ros.simulation.layout import Junction, RoadLayout, Straight
from raw2drive_ros.simulation.scenario import LightSpec, Rng, RouteSpec, Scene, TrafficSpec, scenario
from raw2drive_ros.simulation.scenarios.merging import stream

GREEN = (('green', 120.0),)
T_FROM_STEM = ('left', 'right')


def _flow(
    rng: Rng,
    on: tuple[str, str],
    count: int,
    first_m: float,
    gap_m: tuple[float, float],
    speed_mps: tuple[float, float] = (5.0, 8.0),
    kind: str = 'car',
    lights: bool = False,
) -> tuple[TrafficSpec, ...]:
    """A stream with right of way. Who does not fit onto the road at the start drives in later."""
    speed = float(rng.uniform(*speed_mps))
    cars = []
    for s in stream(rng, count, first_m, gap_m):
        later = max(0.0, (1.0 - s) / speed)
        cars.append(
            TrafficSpec(on, max(s, 1.0), speed, kind=kind, obeys_light=lights, has_priority=True, enters_at_s=later)
        )
    return tuple(cars)


def _scene(turn: str, actors: tuple[TrafficSpec, ...], arms: tuple[str, ...] | None = None, **more: float) -> Scene:
    junction = Junction(turn, arms or ('left', 'right', 'ahead'))
    straight, limit = more.get('straight', 50.0), more.get('limit', 9.0)
    layout = RoadLayout((Straight(straight), junction, Straight(75)), 1, 1, limit)
    return Scene(layout, RouteSpec(start_speed_mps=4.0), actors)


def _with_light(turn: str, actors: tuple[TrafficSpec, ...], phases: tuple[tuple[str, float], ...] = GREEN) -> Scene:
    layout = RoadLayout((Straight(60), Junction(turn, control='light'), Straight(75)), 1, 1, 9.0)
    return Scene(layout, RouteSpec(start_speed_mps=4.0), actors, (LightSpec(0, phases),))


@scenario('NonSignalizedJunctionLeftTurn', 'Merging', 'TrafficSign')
def unprotected_left_turn(rng: Rng) -> Scene:
    """Turn left across oncoming traffic."""
    return _scene('left', _flow(rng, ('ahead', 'back'), int(rng.integers(6, 11)), 40, (13, 26)))


@scenario('NonSignalizedJunctionRightTurn', 'Merging', 'TrafficSign')
def unprotected_right_turn(rng: Rng) -> Scene:
    """Turn right into traffic that comes from the left."""
    return _scene('right', _flow(rng, ('left', 'right'), int(rng.integers(6, 11)), 50, (13, 26)))


@scenario('NonSignalizedJunctionLeftTurnEnterFlow', 'Merging', 'TrafficSign')
def left_turn_enter_flow(rng: Rng) -> Scene:
    """Turn left into traffic that comes from the right."""
    return _scene('left', _flow(rng, ('right', 'left'), int(rng.integers(6, 11)), 48, (14, 28)))


@scenario('SignalizedJunctionLeftTurn', 'Merging', 'TrafficSign')
def signalized_left_turn(rng: Rng) -> Scene:
    """Green for both: turn left across oncoming traffic."""
    return _with_light('left', _flow(rng, ('ahead', 'back'), int(rng.integers(6, 11)), 40, (13, 26), lights=True))


@scenario('SignalizedJunctionRightTurn', 'Merging', 'TrafficSign')
def signalized_right_turn(rng: Rng) -> Scene:
    """Green: turn right into a road that oncoming cars turn left into."""
    return _with_light(
        'right', _flow(rng, ('ahead', 'right'), int(rng.integers(5, 9)), 40, (14, 28), (5.0, 7.0), lights=True)
    )


@scenario('SignalizedJunctionLeftTurnEnterFlow', 'Merging', 'TrafficSign')
def signalized_left_turn_enter_flow(rng: Rng) -> Scene:
    """Green after red: turn left into a road that oncoming cars turn right into."""
    cars = _flow(rng, ('ahead', 'left'), int(rng.integers(5, 9)), 40, (14, 28), (5.0, 7.0), lights=True)
    return _with_light('left', cars, (('red', float(rng.uniform(3, 6))), ('green', 120.0)))


@scenario('EnterActorFlow', 'Merging', 'TrafficSign')
def enter_actor_flow(rng: Rng) -> Scene:
    """From the stem of a T junction, turn right into a steady flow."""
    return _scene(
        'right', _flow(rng, ('left', 'right'), int(rng.integers(7, 12)), 52, (15, 26), (6.0, 9.0)), T_FROM_STEM
    )


@scenario('CrossingBicycleFlow', 'Merging', 'TrafficSign')
def crossing_bicycle_flow(rng: Rng) -> Scene:
    """Cyclists cross the junction that the ego goes through."""
    turn = str(rng.choice(('ahead', 'right', 'left')))
    source, target = (('left', 'right'), ('right', 'left'))[int(rng.integers(0, 2))]
    riders = _flow(rng, (source, target), int(rng.integers(6, 11)), 50, (6, 15), (3.0, 4.5), 'cyclist')
    return _scene(turn, riders)


@scenario('InterurbanActorFlow', 'Merging')
def interurban_actor_flow(rng: Rng) -> Scene:
    """Leave an interurban road to the left, across its fast oncoming flow."""
    flow = _flow(rng, ('ahead', 'back'), int(rng.integers(6, 11)), 50, (17, 34), (8.0, 11.0))
    return _scene('left', flow, ('left', 'ahead'), straight=65.0, limit=12.0)


@scenario('InterurbanAdvancedActorFlow', 'Merging')
def interurban_advanced_actor_flow(rng: Rng) -> Scene:
    """Enter an interurban road from the side, turning left: across one fast flow and into the other."""
    near = _flow(rng, ('left', 'right'), int(rng.integers(4, 7)), 50, (20, 36), (8.0, 11.0))
    far = _flow(rng, ('right', 'left'), int(rng.integers(4, 7)), 50, (20, 36), (8.0, 11.0))
    return _scene('left', (*near, *far), T_FROM_STEM, limit=11.0)
