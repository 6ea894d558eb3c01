"""Ability TrafficSign: traffic lights, stop signs and plain junctions."""

from __future__ import annotations

from raw2drive_ros.simulation.draws import Rng
from raw2drive_ros.simulation.flows import arriving, group_times
from raw2drive_ros.simulation.layout import Junction, RoadLayout, Straight
from raw2drive_ros.simulation.scenario import (
    LightSpec,
    RouteSpec,
    Scene,
    StopSignSpec,
    TrafficSpec,
    scenario,
)


def _turn(rng: Rng) -> str:
    return str(rng.choice(('left', 'right', 'ahead')))


@scenario('VanillaSignalizedTurnEncounterRedLight', 'TrafficSign')
def red_light(rng: Rng) -> Scene:
    """The light is red, then turns green; cross traffic passes during the red phase."""
    crossing = tuple(TrafficSpec(('left', 'right'), float(s), 7.0, obeys_light=True) for s in (15, 32))
    light = LightSpec(0, (('red', float(rng.uniform(9, 14))), ('green', 60.0)))
    layout = RoadLayout((Straight(70), Junction(_turn(rng), control='light'), Straight(60)), 1, 1, 9.0)
    return Scene(layout, RouteSpec(start_speed_mps=4.0), crossing, (light,))


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
