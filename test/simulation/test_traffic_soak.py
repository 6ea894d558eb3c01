"""Traffic that goes on for minutes: nobody touches anybody, nobody waits for ever, nothing comes or goes in sight."""

import pytest
from traffic_worlds import Watch, brake, drive_on, junction_world, stand_aside, world_of

from raw2drive_ros.simulation.actors import PathVehicle
from raw2drive_ros.simulation.layout import Curve, Junction, RoadLayout, Straight
from raw2drive_ros.simulation.scenario import (
    AcrossJunction,
    AlongRoad,
    BackgroundSpec,
    CarSpec,
    FlowSpec,
    OnRamp,
    RouteSpec,
    Scene,
    WalkerSpec,
)

# A cycle of the light takes 30 s; who just misses the end of a queue waits for more than one.
PATIENCE_S = 65.0
JUNCTIONS = {
    'light': {'control': 'light'},
    'priority': {'control': 'yield'},
    'equal': {'control': 'none'},
    'lanes': {'control': 'none', 'lanes': 2},
    'lanes_light': {'control': 'light', 'lanes': 2},
}


@pytest.mark.parametrize('seed', range(4))
@pytest.mark.parametrize('kind', JUNCTIONS)
def test_dense_traffic_at_a_junction_goes_on_without_an_accident(kind, seed) -> None:
    turn = ('ahead', 'left', 'right')[seed % 3] if JUNCTIONS[kind].get('lanes', 1) == 1 else 'ahead'
    world = junction_world(seed=seed, turn=turn, background=BackgroundSpec('dense'), **JUNCTIONS[kind])
    stand_aside(world)
    watch = Watch(world)
    while world.time_s < 75.0:
        watch.step(brake(world))
    assert not watch.overlaps
    assert not watch.popped
    assert watch.longest_wait_s < PATIENCE_S
    assert len(watch.numbers) > 30, 'traffic is renewed'


@pytest.mark.parametrize('seed', range(3))
@pytest.mark.parametrize('kind', ['light', 'priority', 'lanes'])
def test_a_drive_through_a_living_street_sees_nothing_come_or_go(kind, seed) -> None:
    """With parked cars, people and cyclists; the ego drives, and stands at its goal."""
    background = BackgroundSpec('medium', parked=0.5, bystanders=3, cyclists=3)
    world = junction_world(seed=seed, background=background, **JUNCTIONS[kind])
    kinds = set()
    watch = Watch(world)
    while world.time_s < 60.0:
        watch.step(drive_on(world))
        kinds |= {actor.kind for actor in world.actors}
    assert not watch.overlaps
    assert not watch.popped
    assert {'car', 'parked', 'walker', 'cyclist'} <= kinds


@pytest.mark.parametrize('seed', range(4))
def test_a_flow_with_right_of_way_through_dense_background_touches_nobody(seed) -> None:
    flow = FlowSpec(AcrossJunction(0, 'left', 'right'), 8.0)
    world = junction_world('yield', seed, (flow,), background=BackgroundSpec('dense'))
    stand_aside(world)
    watch = Watch(world)
    while world.time_s < 60.0:
        watch.step(brake(world))
    assert not watch.overlaps
    assert not watch.popped


def scene_of(kind: str) -> Scene:
    everything = BackgroundSpec('dense', parked=0.4, bystanders=2, cyclists=2)
    if kind == 'two_junctions':
        first, second = Junction('right', control='yield'), Junction('left', ('left', 'right'), control='light')
        pieces = (Straight(100), first, Straight(110), Curve(70, 0.8), Straight(60), second, Straight(110))
        return Scene(RoadLayout(pieces, 1, 1, 11.0), RouteSpec(start_s_m=20.0), background=everything)
    if kind == 'walkers':
        walkers = tuple(WalkerSpec(100.0 + 20.0 * i, -5.0, 9.0, 1.4, 0.5) for i in range(3))
        layout = RoadLayout((Straight(260),), 1, 1, 11.0, shoulder_m=2.0)
        return Scene(layout, RouteSpec(start_s_m=40.0), walkers, background=BackgroundSpec('dense', bystanders=2))
    layout = RoadLayout((Straight(150), Straight(140, ramp=True), Straight(150)), 2, 2, 13.0)
    actors = (CarSpec(OnRamp(40.0), 9.0), FlowSpec(AlongRoad(250.0, lane=0), 11.0))
    route = RouteSpec(lane=1, start_s_m=20.0, start_speed_mps=9.0)
    return Scene(layout, route, actors, background=BackgroundSpec('dense'))


@pytest.mark.parametrize('seed', range(3))
@pytest.mark.parametrize('kind', ['two_junctions', 'walkers', 'ramp'])
def test_other_roads_are_as_free_of_accidents(kind, seed) -> None:
    """Two junctions and a curve; people who cross the road; a car and a flow where an on-ramp ends."""
    world = world_of(scene_of(kind), seed)
    watch = Watch(world)
    while world.time_s < 50.0:
        watch.step(drive_on(world))
    assert not watch.overlaps
    assert not watch.popped
    assert watch.longest_wait_s < PATIENCE_S


def test_nobody_is_forced_to_brake_by_an_ego_that_keeps_to_the_rules() -> None:
    for seed in range(3):
        world = junction_world('light', seed, background=BackgroundSpec('medium'))
        hardest = 0.0
        while world.time_s < 40.0:
            world.step(drive_on(world))
            hardest = max([hardest, *(a.imposed_mps2 for a in world.actors if isinstance(a, PathVehicle))])
        assert hardest < 3.5
