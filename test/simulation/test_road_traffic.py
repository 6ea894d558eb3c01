"""Dense traffic on junctions with turn lanes, at angles and on roundabouts: nobody touches anybody, all go on."""

import pytest
from traffic_worlds import CYCLE, Watch, brake, stand_aside, world_of

from raw2drive_ros.simulation.layout import Junction, RoadLayout, Straight
from raw2drive_ros.simulation.scenario import BackgroundSpec, LightSpec, RouteSpec, Scene

TURN_LANES = (('left', (0,)), ('ahead', (1, 2)), ('right', (2,)))
APART = (('left', (0,)), ('right', (1,)))
# Name: (junction, lanes each way, side with parking bays).
SITES = {
    'turn lanes': (Junction(control='light', turn_lanes=TURN_LANES, zebras=('back', 'left')), 3, ''),
    'turn lanes at a T': (Junction('right', ('left', 'right'), 'stop', turn_lanes=APART), 2, ''),
    'roundabout': (Junction('left', control='yield', island_m=10.0, angles=(('right', 0.4), ('left', 0.3))), 1, 'both'),
    'roundabout of three': (Junction('ahead', ('right', 'ahead'), 'yield', island_m=8.0), 1, 'right'),
    'skewed': (Junction('left', angles=(('left', 0.6), ('right', 0.5), ('ahead', -0.3))), 1, ''),
    'Y': (Junction('right', ('left', 'right'), angles=(('left', -0.5), ('right', 0.5))), 1, ''),
}


@pytest.mark.parametrize('kind', SITES)
def test_dense_traffic_goes_on_without_an_accident(kind) -> None:
    junction, lanes, parking = SITES[kind]
    lights = (LightSpec(0, CYCLE, 400.0, repeats=True),) if junction.control == 'light' else ()
    layout = RoadLayout((Straight(130), junction, Straight(120)), lanes, lanes, 11.0, parking=parking)
    background = BackgroundSpec('dense', parked=0.5 if parking else 0.0, bystanders=2)
    world = world_of(Scene(layout, RouteSpec(start_s_m=40.0), (), lights, background=background), 1)
    stand_aside(world)
    watch = Watch(world)
    while world.time_s < 60.0:
        watch.step(brake(world))
    assert not watch.overlaps
    assert not watch.popped
    assert watch.longest_wait_s < 65.0
    assert len(watch.numbers) > 30, 'traffic is renewed'
