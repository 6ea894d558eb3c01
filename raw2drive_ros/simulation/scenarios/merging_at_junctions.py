"""Ability Merging, at junctions: the ego turns across or into a flow of traffic."""

from __future__ import annotations

from raw2drive_ros.simulation.draws import Draw, Rng
from raw2drive_ros.simulation.flows import arriving, group_times
from raw2drive_ros.simulation.layout import (
    ARM_LENGTH_M,
    CORNER_RADIUS_M,
    LANE_WIDTH_M,
    Junction,
    RoadLayout,
    Straight,
)
from raw2drive_ros.simulation.scenario import AcrossJunction, LightSpec, RouteSpec, Scene, TrafficSpec, scenario
from raw2drive_ros.simulation.scenarios.parts import (
    across_m,
    approach,
    background,
    crossing_need_s,
    layout,
    road_length_m,
    skewed,
    stream,
)

GREEN = (('green', 120.0),)
T_FROM_STEM = ('left', 'right')


# Arc length at which paths across a junction meet the ego's: the length of an arm plus half the junction.
MEETING_S_M = ARM_LENGTH_M + CORNER_RADIUS_M + LANE_WIDTH_M


def _flow(
    rng: Rng,
    on: tuple[str, str],
    speed_mps: tuple[float, float] = (5.5, 8.0),
    kind: str = 'car',
    headway_s: tuple[float, float] = (1.4, 1.75),
    from_s: tuple[float, float] = (3.0, 4.5),
    until_s: tuple[float, float] = (11.5, 16.0),
    gap_s: tuple[float, float] = (6.5, 8.5),
) -> tuple[TrafficSpec, ...]:
    """A flow with right of way: a dense platoon while the ego arrives, a gap, and another platoon."""
    times = group_times(rng, float(rng.uniform(*from_s)), float(rng.uniform(*until_s)), headway_s, gap_s)
    return arriving(times, on, MEETING_S_M, float(rng.uniform(*speed_mps)), kind=kind)


def _scene(turn: str, actors: tuple[TrafficSpec, ...], arms: tuple[str, ...] | None = None, **more: float) -> Scene:
    junction = Junction(turn, arms or ('left', 'right', 'ahead'))
    straight, limit = more.get('straight', 50.0), more.get('limit', 9.0)
    layout = RoadLayout((Straight(straight), junction, Straight(75)), 1, 1, limit)
    return Scene(layout, RouteSpec(start_speed_mps=4.0), actors)


def _with_light(turn: str, actors: tuple[TrafficSpec, ...], phases: tuple[tuple[str, float], ...] = GREEN) -> Scene:
    layout = RoadLayout((Straight(60), Junction(turn, control='light'), Straight(75)), 1, 1, 9.0)
    return Scene(layout, RouteSpec(start_speed_mps=4.0), actors, (LightSpec(0, phases),))


def _through_stream(
    draw: Draw,
    turn: str,
    flows: tuple[tuple[str, str], ...],
    speeds_mps: tuple[float, float] = (7.0, 9.5),
    arms: tuple[str, ...] = ('left', 'right', 'ahead'),
    control: str = 'none',
    priority: str = '',
    kind: str = 'car',
) -> Scene:
    """A junction where the ego turns across or into streams with the right of way."""
    before = draw.uniform('event_s_m', 90.0, 200.0, key=True)
    junction = skewed(draw, turn, arms, control, priority)
    pieces = (*approach(draw, before), junction, Straight(draw.uniform('after_m', 70.0, 130.0)))
    road = layout(draw, pieces, (1, 1), (9.0, 12.5))
    begin = road_length_m(pieces[:-2], road, 0)
    across = across_m(junction, road)
    need = crossing_need_s(road, turn) + (2.0 if len(flows) > 1 else 0.0)
    streams = tuple(
        stream(
            draw,
            AcrossJunction(0, *flow),
            draw.uniform(f'stream_{i}_mps', *speeds_mps, key=i == 0),
            need,
            f'stream_{i}',
            kind=kind,
        )
        for i, flow in enumerate(flows)
    )
    lights = (LightSpec(0, GREEN),) if control == 'light' else ()
    route = RouteSpec(start_speed_mps=7.0)
    return Scene(
        road, route, streams, lights, background=background(draw), event_s_m=(begin - 25.0, begin + across + 12.0)
    )


@scenario('NonSignalizedJunctionLeftTurn', 'Merging', 'TrafficSign')
def unprotected_left_turn(draw: Draw) -> Scene:
    """Turn left across oncoming traffic."""
    return _through_stream(draw, 'left', (('ahead', 'back'),), priority='')


@scenario('NonSignalizedJunctionRightTurn', 'Merging', 'TrafficSign')
def unprotected_right_turn(rng: Rng) -> Scene:
    """Turn right into traffic that comes from the left."""
    return _scene('right', _flow(rng, ('left', 'right')))


@scenario('NonSignalizedJunctionLeftTurnEnterFlow', 'Merging', 'TrafficSign')
def left_turn_enter_flow(rng: Rng) -> Scene:
    """Turn left into traffic that comes from the right."""
    return _scene('left', _flow(rng, ('right', 'left')))


@scenario('SignalizedJunctionLeftTurn', 'Merging', 'TrafficSign')
def signalized_left_turn(rng: Rng) -> Scene:
    """Green light for both directions: turn left across oncoming traffic."""
    return _with_light('left', _flow(rng, ('ahead', 'back'), from_s=(4.0, 5.5)))


@scenario('SignalizedJunctionRightTurn', 'Merging', 'TrafficSign')
def signalized_right_turn(rng: Rng) -> Scene:
    """Green light: turn right into traffic from the left."""
    return _with_light('right', _flow(rng, ('left', 'right'), from_s=(4.0, 5.5)))


@scenario('SignalizedJunctionLeftTurnEnterFlow', 'Merging', 'TrafficSign')
def signalized_left_turn_enter_flow(rng: Rng) -> Scene:
    """Green light after red: turn left into traffic from the right."""
    phases = (('red', float(rng.uniform(3, 6))), ('green', 120.0))
    return _with_light('left', _flow(rng, ('right', 'left'), from_s=(5.0, 7.0), until_s=(15.0, 19.0)), phases)


@scenario('EnterActorFlow', 'Merging', 'TrafficSign')
def enter_actor_flow(rng: Rng) -> Scene:
    """From the stem of a T junction, turn right into a steady flow of traffic."""
    return _scene('right', _flow(rng, ('left', 'right'), (6.5, 9.0)), T_FROM_STEM)


@scenario('CrossingBicycleFlow', 'Merging', 'TrafficSign')
def crossing_bicycle_flow(rng: Rng) -> Scene:
    """Cyclists cross the junction that the ego goes through."""
    turn = str(rng.choice(('ahead', 'right', 'left')))
    source, target = (('left', 'right'), ('right', 'left'))[int(rng.integers(0, 2))]
    riders = _flow(rng, (source, target), (3.5, 5.0), 'cyclist', (0.9, 1.4), gap_s=(6.0, 8.0))
    return _scene(turn, riders)


@scenario('InterurbanActorFlow', 'Merging')
def interurban_actor_flow(rng: Rng) -> Scene:
    """Turn left off an interurban road, across its fast oncoming traffic."""
    flow = _flow(rng, ('ahead', 'back'), (8.0, 10.5), from_s=(3.5, 5.0))
    return _scene('left', flow, ('left', 'ahead'), straight=65.0, limit=12.0)


@scenario('InterurbanAdvancedActorFlow', 'Merging')
def interurban_advanced_actor_flow(rng: Rng) -> Scene:
    """Turn left onto an interurban road: across one fast flow of traffic and into the other."""
    near = _flow(rng, ('left', 'right'), (7.0, 9.0), until_s=(9.0, 10.0), gap_s=(12.0, 14.0))
    far = _flow(rng, ('right', 'left'), (7.0, 9.0), until_s=(11.0, 13.0), gap_s=(9.0, 11.0))
    return _scene('left', (*near, *far), T_FROM_STEM, limit=11.0)
