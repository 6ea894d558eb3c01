"""How single cars follow their way: indicators, drifts, gaps, and braking that the ego imposes."""

import numpy as np
import pytest
from traffic_worlds import brake, car_of, junction_world, stand_aside

from raw2drive_ros.contracts.public import Control
from raw2drive_ros.simulation.actors import PathVehicle, Walker
from raw2drive_ros.simulation.leaders import find_leaders
from raw2drive_ros.simulation.scenario import AcrossJunction, AlongRoad, CarSpec
from raw2drive_ros.simulation.scripts import Script

# -- indicators, drifts, imposed braking -------------------------------------------------------------


def test_a_car_indicates_before_it_turns_until_it_has_turned() -> None:
    world = junction_world(actors=(CarSpec(AcrossJunction(0, 'left', 'back', before_m=50.0), 8.0),))
    stand_aside(world)
    car = car_of(world)
    crossing = car.course.crossings[0]
    assert crossing.turn == 'right'
    while car.s_m < crossing.leave_s_m + 10.0:
        world.step(brake(world))
        if car.s_m < crossing.enter_s_m - 42.0 or car.s_m > crossing.leave_s_m + 2.0:
            assert car.indicator == ''
        elif crossing.enter_s_m - 36.0 < car.s_m < crossing.leave_s_m - 2.0:
            assert car.indicator == 'right'


def test_a_cut_in_indicates_first_and_keeps_within_four_metres_per_second_squared() -> None:
    script = Script(time_s=0.5, delay_s=1.0, drift_m=3.5, drift_over_m=5.0)
    world = junction_world(actors=(CarSpec(AlongRoad(20.0, lane=1), 10.0, scripts=(script,)),), lanes=2)
    stand_aside(world)
    car = car_of(world)
    lateral, shown = [], []
    while world.time_s < 6.0:
        world.step(brake(world))
        lateral.append(car.lateral_m)
        shown.append(car.indicator)
    sideways = np.diff(lateral, 2) * 20.0**2
    assert lateral[-1] == pytest.approx(3.5)
    assert np.abs(sideways).max() < 4.1
    assert shown[20] == 'left' and lateral[20] == 0.0, 'before it moves'
    assert shown[-1] == ''


@pytest.mark.parametrize(('ahead_m', 'hard'), [(9.0, True), (45.0, False)])
def test_braking_that_only_the_ego_causes_is_recorded(ahead_m, hard) -> None:
    """The ego stands across the lane of a car: suddenly before it, or far ahead."""
    world = junction_world(actors=(CarSpec(AlongRoad(60.0, oncoming=True), 10.0),))
    car = car_of(world)
    x, y, yaw = car.path.pose(car.s_m + ahead_m)
    world.ego.position[:] = (x, y)
    world.ego.heading = yaw + np.pi / 2
    world.ego.speed = 0.0
    world.refresh()
    hardest = 0.0
    for _ in range(40):
        world.ego.position[:] = (x, y)
        world.step(Control(0.0, 1.0))
        hardest = max(hardest, car.imposed_mps2)
    assert (hardest > 3.5) == hard
    if not hard:
        assert car.speed < 9.0, 'it has braked, but gently'


def test_head_on_both_have_to_stop_before_where_they_would_meet() -> None:
    """An ego that overtakes far away asks for no hard braking; one that is close does."""
    hardest = {}
    for gap_m in (70.0, 32.0):
        world = junction_world(actors=(CarSpec(AlongRoad(110.0, oncoming=True), 10.0),))
        car = car_of(world)
        x, y, yaw = car.path.pose(car.s_m + gap_m)
        world.ego.position[:], world.ego.heading, world.ego.speed = (x, y), yaw + np.pi, 10.0
        world.refresh()
        hardest[gap_m] = 0.0
        for _ in range(20):
            world.step(Control(0.4))
            hardest[gap_m] = max(hardest[gap_m], car.imposed_mps2)
    assert hardest[32.0] > 3.5 > hardest[70.0]


def test_behind_another_car_the_ego_imposes_nothing() -> None:
    world = junction_world(actors=(CarSpec(AlongRoad(60.0), 0.0, 0.01), CarSpec(AlongRoad(40.0), 9.0)))
    stand_aside(world)
    behind = world.find(1)
    while world.time_s < 5.0:
        world.step(brake(world))
        assert behind.imposed_mps2 == 0.0
    assert behind.speed < 1.0


# -- the search for leaders --------------------------------------------------------------------------


def test_the_gap_is_that_between_bumpers_on_straights_and_through_a_junction() -> None:
    for target, turn in (('ahead', 'ahead'), ('left', 'left')):
        world = junction_world(turn=turn)
        course = world.book.across(0, 'back', target)
        for between in (6.0, 13.0, 24.0):
            rear = PathVehicle(course.path, 115.0, 8.0, 8.0, course=course)
            front = PathVehicle(course.path, 115.0 + 4.6 + between, 5.0, 5.0, course=course)
            world.actors = [rear, front]
            world.ego.position[:] = (-500.0, 0.0)
            world.refresh()
            find_leaders(world, [rear, front])
            assert rear.gap_m == pytest.approx(between, abs=0.4)
            assert front.gap_m == np.inf
            assert world.actors[rear.leader_row] is front


def test_what_is_thin_and_lies_across_the_way_is_not_missed() -> None:
    world = junction_world()
    course = world.book.across(0, 'back', 'ahead')
    for at_m in np.arange(20.0, 22.0, 0.17):
        car = PathVehicle(course.path, 10.0, 8.0, 8.0, course=course)
        x, y, yaw = course.path.pose(float(at_m))
        walker = Walker(world.route, float(at_m), -3.0, 3.0, 1.0, 0.0)
        walker.position[:], walker.heading = (x, y), yaw + np.pi / 2
        world.actors = [car, walker]
        world.ego.position[:] = (-500.0, 0.0)
        world.refresh()
        find_leaders(world, [car])
        assert car.gap_m == pytest.approx(at_m - 10.0 - car.LENGTH / 2 - walker.WIDTH / 2, abs=0.3)
