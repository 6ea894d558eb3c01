"""Traffic that goes on for minutes: nobody touches anybody, nobody waits for ever, nothing comes or goes in sight."""

import pytest
from traffic_worlds import Watch, brake, drive_on, junction_world, stand_aside

from raw2drive_ros.simulation.actors import PathVehicle
from raw2drive_ros.simulation.scenario import AcrossJunction, BackgroundSpec, FlowSpec

# A cycle of the light takes 30 s; who just misses the end of a queue waits for more than one.
PATIENCE_S = 65.0
JUNCTIONS = {
    'light': {'control': 'light'},
    'priority': {'control': 'yield'},
    'equal': {'control': 'none'},
    'lanes': {'control': 'none', 'lanes': 2},
    'lanes_light': {'control': 'light', 'lanes': 2},
}


@pytest.mark.parametrize('seed', range(5))
@pytest.mark.parametrize('kind', JUNCTIONS)
def test_dense_traffic_at_a_junction_goes_on_without_an_accident(kind, seed) -> None:
    turn = ('ahead', 'left', 'right')[seed % 3] if JUNCTIONS[kind].get('lanes', 1) == 1 else 'ahead'
    world = junction_world(seed=seed, turn=turn, background=BackgroundSpec('dense'), **JUNCTIONS[kind])
    stand_aside(world)
    watch = Watch(world)
    while world.time_s < 80.0:
        watch.step(brake(world))
    assert not watch.overlaps
    assert not watch.popped
    assert watch.longest_wait_s < PATIENCE_S
    assert len(watch.numbers) > 30, 'traffic is renewed'


@pytest.mark.parametrize('seed', range(4))
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


def test_nobody_is_forced_to_brake_by_an_ego_that_keeps_to_the_rules() -> None:
    for seed in range(3):
        world = junction_world('light', seed, background=BackgroundSpec('medium'))
        hardest = 0.0
        while world.time_s < 40.0:
            world.step(drive_on(world))
            hardest = max([hardest, *(a.imposed_mps2 for a in world.actors if isinstance(a, PathVehicle))])
        assert hardest < 3.5
