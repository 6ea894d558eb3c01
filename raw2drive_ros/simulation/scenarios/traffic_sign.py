"""Ability TrafficSign: traffic lights, stop signs and plain junctions."""

from __future__ import annotations

from raw2drive_ros.simulation.draws import Draw, Rng
from raw2drive_ros.simulation.flows import arriving, group_times
from raw2drive_ros.simulation.layout import Junction, RoadLayout, Straight
from raw2drive_ros.simulation.scenario import (
    ActorSpec,
    LightSpec,
    RouteSpec,
    Scene,
    StopSignSpec,
    scenario,
)
from raw2drive_ros.simulation.scenarios.parts import across_m, approach, background, layout, road_length_m, skewed


def _turn(rng: Rng) -> str:
    return str(rng.choice(('left', 'right', 'ahead')))


def _at_light(
    draw: Draw, phases: tuple[tuple[str, float], ...], trigger_m: float, actors: tuple[ActorSpec, ...] = ()
) -> Scene:
    """A junction with a light on a road of one or two lanes each way."""
    turn = draw.choice('turn', ('left', 'ahead', 'right'), key=True)
    lanes = draw.choice('lanes', (1, 2), key=True)
    before = draw.uniform('event_s_m', 110.0, 230.0, key=True)
    junction = skewed(draw, turn, ('left', 'right', 'ahead'), 'light')
    pieces = (*approach(draw, before), junction, Straight(draw.uniform('after_m', 80.0, 140.0)))
    road = layout(draw, pieces, (lanes, lanes), (11.0, 14.0))
    lane = lanes - 1 if turn == 'right' else 0
    begin = road_length_m(pieces[:-2], road, lane)
    across = across_m(junction, road)
    route = RouteSpec(lane, start_speed_mps=9.0)
    light = LightSpec(0, phases, trigger_m)
    return Scene(
        road, route, actors, (light,), background=background(draw), event_s_m=(begin - 25.0, begin + across + 12.0)
    )


@scenario('VanillaSignalizedTurnEncounterRedLight', 'TrafficSign')
def red_light(draw: Draw) -> Scene:
    """The light is red, then turns green; cross traffic passes during the red phase."""
    red = draw.uniform('red_s', 17.0, 27.0, key=True)
    phases = (('red', red), ('green', 40.0)) if draw.event else (('green', 60.0),)
    return _at_light(draw, phases, draw.uniform('trigger_m', 50.0, 70.0))


@scenario('VanillaSignalizedTurnEncounterGreenLight', 'TrafficSign')
def green_light(rng: Rng) -> Scene:
    """The light stays green: no reason to stop."""
    light = LightSpec(0, (('green', 60.0),))
    layout = RoadLayout((Straight(70), Junction(_turn(rng), control='light'), Straight(60)), 1, 1, 9.0)
    return Scene(layout, RouteSpec(start_speed_mps=4.0), (), (light,))


@scenario('VanillaNonSignalizedTurnEncounterStopsign', 'TrafficSign')
def stop_sign(rng: Rng) -> Scene:
    """A stop sign before a junction turn."""
    layout = RoadLayout((Straight(70), Junction(_turn(rng), control='stop'), Straight(60)), 1, 1, 9.0)
    return Scene(layout, RouteSpec(start_speed_mps=4.0), (), (), (StopSignSpec(0),))


@scenario('T_Junction', 'TrafficSign')
def t_junction(rng: Rng) -> Scene:
    """The road ends at a T junction; a platoon of cars passes on the road across."""
    turn = str(rng.choice(('left', 'right')))
    source, target = (('left', 'right'), ('right', 'left'))[int(rng.integers(0, 2))]
    times = group_times(rng, float(rng.uniform(4, 6)), float(rng.uniform(11, 15)), groups=1)
    cars = arriving(times, (source, target), 70.0, float(rng.uniform(5, 8)))
    layout = RoadLayout((Straight(65), Junction(turn, ('left', 'right')), Straight(60)), 1, 1, 9.0)
    return Scene(layout, RouteSpec(start_speed_mps=4.0), cars)


@scenario('VanillaNonSignalizedTurn', 'TrafficSign')
def plain_turn(rng: Rng) -> Scene:
    """A junction without lights, signs or other traffic."""
    turn = _turn(rng)
    layout = RoadLayout((Straight(float(rng.uniform(50, 80))), Junction(turn), Straight(60)), 1, 1, 9.0)
    return Scene(layout, RouteSpec(start_speed_mps=4.0))
