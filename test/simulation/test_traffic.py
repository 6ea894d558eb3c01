"""Courses, flows, lights of all approaches, right of way, and equal traffic for equal seeds."""

import numpy as np
import pytest
from traffic_worlds import brake, car_of, drive_on, junction_world, stand_aside, world_of

from raw2drive_ros.contracts.public import Control
from raw2drive_ros.simulation.actors import PathVehicle
from raw2drive_ros.simulation.chain import Link, joined
from raw2drive_ros.simulation.layout import Junction, RoadLayout, Straight
from raw2drive_ros.simulation.scenario import (
    AcrossJunction,
    AlongRoad,
    BackgroundSpec,
    CarSpec,
    FlowSpec,
    RouteSpec,
    Scene,
)
from raw2drive_ros.simulation.signals import TrafficLight

# -- courses -----------------------------------------------------------------------------------------


def test_a_course_leads_from_edge_to_edge_of_the_map_and_knows_its_junction() -> None:
    book = junction_world(turn='left').book
    for source, target, turn in (('right', 'left', 'ahead'), ('back', 'left', 'left'), ('ahead', 'left', 'right')):
        course = book.across(0, source, target)
        (crossing,) = course.crossings
        assert (crossing.source_arm, crossing.target_arm, crossing.turn) == (source, target, turn)
        assert not book.before[course.lanes[0]]
        assert book.is_sink(course.lanes[-1])
        assert course.path.length_m == pytest.approx(course.begins_m[-1], abs=1.0)
        steps = np.hypot(*np.diff(course.path.points_m, axis=0).T)
        assert steps == pytest.approx(0.5, abs=0.02), 'no jump between lanes'
        assert min(course.speeds_mps) > 3.0
    assert book.across(0, 'right', 'left') is book.across(0, 'right', 'left')


def test_a_car_is_where_its_place_says_and_turns_as_told() -> None:
    world = junction_world(
        actors=(
            CarSpec(AlongRoad(60.0, oncoming=True), 5.0),
            CarSpec(AlongRoad(70.0), 5.0, then=('right',)),
            CarSpec(AcrossJunction(0, 'left', 'back', before_m=12.0), 5.0),
        )
    )
    oncoming, ahead, across = world.actors
    route = world.route
    assert route.project(*oncoming.position) == pytest.approx((60.0, 3.5), abs=0.1)
    assert np.cos(oncoming.heading - route.pose(60.0)[2]) == pytest.approx(-1.0)
    assert route.project(*ahead.position) == pytest.approx((70.0, 0.0), abs=0.1)
    assert ahead.course.crossings[0].target_arm == 'right'
    line = across.course.crossings[0].stop_s_m
    assert line - across.s_m - across.LENGTH / 2 == pytest.approx(12.0, abs=0.1)


# -- flows -------------------------------------------------------------------------------------------


def passings(world, flow, seconds, control) -> tuple[list[float], float | None]:
    """(times at which cars pass the point of a flow, time at which it was armed)."""
    times: dict[int, float] = {}
    there = {a.number for a in world.actors if isinstance(a, PathVehicle) and a.s_m > flow.point_s_m}
    armed = None
    while world.time_s < seconds:
        world.step(control(world))
        armed = world.time_s if flow.armed and armed is None else armed
        for actor in world.actors:
            passed = isinstance(actor, PathVehicle) and actor.course is flow.course and actor.s_m > flow.point_s_m
            if passed and actor.number not in there:
                times.setdefault(actor.number, world.time_s)
    return sorted(times.values()), armed


def test_a_platoon_has_no_end_before_the_ego_is_there_and_usable_gaps_afterwards_for_ever() -> None:
    spec = FlowSpec(AcrossJunction(0, 'left', 'right'), 8.0, gap_s=(7.0, 7.5), first_gap_after_s=16.0)
    for seed in range(3):
        # The way of the cars is that of the ego's road beyond the junction: long enough to come from out of sight.
        far = junction_world('yield', seed, (spec,), turn='left', start_s_m=20.0)
        times, armed = passings(far, far.flows[0], 50.0, brake)
        assert armed is None
        assert np.diff(times).max() < 2.5, 'waiting elsewhere does not help'

        near = junction_world('yield', seed, (spec,), turn='left', start_s_m=115.0)
        times, armed = passings(near, near.flows[0], 100.0, brake)
        gaps = np.diff(times)
        usable = np.flatnonzero(gaps > 5.0)
        assert len(usable) >= 3, 'for as long as it waits'
        first = times[usable[0]] - armed
        assert 13.0 < first < 19.0
        assert gaps[usable].min() > 6.0
        assert np.delete(gaps, usable).max() < 2.6


def test_the_stream_of_a_twin_has_passed_when_the_ego_comes() -> None:
    spec = FlowSpec(AcrossJunction(0, 'left', 'right'), 8.0, last_passes_m=40.0)
    for share in (0.4, 0.9):
        world = junction_world('none', 1, (spec,), start_s_m=10.0, start_speed_mps=share * 11.0)
        flow = world.flows[0]
        left: dict[int, float] = {}
        while world.route_s_m < flow.ego_s_m - 5.0:
            world.step(drive_on(world, share))
            for actor in world.actors:
                if isinstance(actor, PathVehicle) and actor.s_m > flow.point_s_m:
                    left.setdefault(actor.number, flow.ego_s_m - world.route_s_m)
        assert 25.0 < min(left.values()) < 60.0
        assert len(left) > 4
        assert flow.ended


def test_background_does_not_fill_the_gaps_of_a_flow() -> None:
    spec = FlowSpec(AcrossJunction(0, 'left', 'right'), 8.0)
    world = junction_world('yield', 2, (spec,), background=BackgroundSpec('dense'))
    stand_aside(world)
    flow = world.flows[0]
    seen = 0
    while world.time_s < 40.0:
        world.step(brake(world))
        for actor in world.actors:
            if isinstance(actor, PathVehicle) and actor.number in world.background.cars:
                seen += 1
                upstream = actor.course.lanes[0] == flow.course.lanes[0] and actor.s_m < flow.point_s_m
                assert not upstream or actor.s_m > flow.course.crossings[0].enter_s_m - 1.0
    assert seen > 1000


# -- lights ------------------------------------------------------------------------------------------


def test_a_light_shows_amber_before_red_and_clears_the_junction_before_green() -> None:
    light = TrafficLight(100.0, (('green', 8.0), ('red', 20.0)), repeats=True)
    light.update(0.0, 80.0)
    shown = []
    for tick in range(28 * 10 * 2):
        light.update(tick / 10, 80.0)
        pair = (light.colour, light.cross_colour)
        assert 'red' in pair, 'never both'
        if not shown or shown[-1][0] != pair:
            shown.append((pair, tick / 10))
    colours = [pair for pair, _ in shown]
    assert colours[:6] == [
        ('green', 'red'),
        ('yellow', 'red'),
        ('red', 'red'),
        ('red', 'green'),
        ('red', 'yellow'),
        ('red', 'red'),
    ]
    lengths = np.diff([time for _, time in shown])[:6]
    assert lengths == pytest.approx([8.0, 3.0, 1.5, 11.0, 3.0, 1.5], abs=0.11)
    assert colours[6:12] == colours[:6]


def test_all_approaches_have_lamps_that_agree() -> None:
    world = junction_world('light')
    stand_aside(world)
    while world.time_s < 35.0:
        world.step(brake(world))
        by_arm = {lamp.arm: lamp.colour for lamp in world.lamps}
        assert set(by_arm) == {'back', 'left', 'right', 'ahead'}
        assert by_arm['back'] == by_arm['ahead'] == world.lights[0].colour
        assert by_arm['left'] == by_arm['right']
        assert 'red' in (by_arm['back'], by_arm['left'])
    poles = np.array([lamp.pole_pose for lamp in world.lamps])
    centre = world.road.junctions[0].centre_m
    assert np.hypot(*(poles[:, :2] - centre).T).min() > world.road.junctions[0].half_size_m
    assert {sign.arm for sign in junction_world('stop').signs} == {'back', 'ahead'}


def test_cars_of_all_approaches_stop_at_red() -> None:
    """Whoever crosses its line in red, and not within a moment of its beginning, has run it."""
    world = junction_world('light', 3, background=BackgroundSpec('dense'))
    stand_aside(world)
    red_since = {}
    crossed = 0
    before: dict[int, float] = {}
    while world.time_s < 60.0:
        world.step(brake(world))
        for lamp in world.lamps:
            red_since[lamp.arm] = red_since.get(lamp.arm, world.time_s) if lamp.colour == 'red' else np.inf
        for actor in world.actors:
            if not isinstance(actor, PathVehicle) or not actor.course.crossings:
                continue
            crossing = actor.course.crossings[0]
            left = crossing.stop_s_m - actor.s_m - actor.LENGTH / 2
            if before.get(actor.number, -1.0) > 0.0 >= left:
                crossed += 1
                assert world.time_s - red_since[crossing.source_arm] < 0.5
            before[actor.number] = left
    assert crossed > 10


# -- right of way ------------------------------------------------------------------------------------


def order_of_leaving(control: str, *specs: CarSpec, turn: str = 'ahead') -> list[int]:
    """Numbers of cars in the order in which they leave the junction, while the ego stands aside."""
    world = junction_world(control, 0, specs, turn=turn)
    stand_aside(world)
    order = []
    while len(order) < len(specs) and world.time_s < 60.0:
        world.step(brake(world))
        for actor in world.actors:
            if actor.number not in order and actor.s_m > actor.course.crossings[0].leave_s_m:
                order.append(actor.number)
    return order


def test_the_minor_road_waits_for_the_main_road() -> None:
    minor = CarSpec(AcrossJunction(0, 'back', 'ahead', before_m=20.0), 7.0)
    main = CarSpec(AcrossJunction(0, 'left', 'right', before_m=35.0), 7.0)
    assert order_of_leaving('yield', minor, main) == [1, 0]
    assert order_of_leaving('none', minor, main) == [0, 1]


def test_straight_goes_before_left_turn() -> None:
    turning = CarSpec(AcrossJunction(0, 'back', 'left', before_m=20.0), 6.0)
    straight = CarSpec(AcrossJunction(0, 'ahead', 'back', before_m=35.0), 7.0)
    assert order_of_leaving('none', turning, straight, turn='left') == [1, 0]


def test_who_waits_too_long_is_let_through() -> None:
    """A minor road beside a main road whose background never ends."""
    world = junction_world(
        'yield',
        1,
        (CarSpec(AcrossJunction(0, 'back', 'ahead', before_m=20.0), 7.0),),
        background=BackgroundSpec('dense'),
    )
    stand_aside(world)
    car = world.find(0)
    while world.time_s < 40.0 and car.s_m < car.course.crossings[0].leave_s_m:
        world.step(brake(world))
    assert world.time_s < 40.0


def test_a_car_with_right_of_way_does_not_wait_for_the_ego_but_brakes_for_one_in_its_lane() -> None:
    spec = CarSpec(AcrossJunction(0, 'left', 'right', before_m=25.0), 8.0)
    for across, brakes in ((False, False), (True, True)):
        world = junction_world('yield', 0, (spec,), start_s_m=100.0)
        car = car_of(world)
        if across:
            x, y, yaw = car.path.pose(car.course.crossings[0].enter_s_m + 8.0)
            world.ego.position[:] = (x, y)
            world.ego.heading = yaw + np.pi / 2
            world.refresh()
        slowest = 9.0
        while world.time_s < (8.0 if across else 4.0):
            world.step(brake(world))
            slowest = min(slowest, car.speed)
        assert (slowest < 1.0) == brakes
        assert brakes or slowest > 7.0


# -- determinism -------------------------------------------------------------------------------------


def test_a_fork_goes_on_as_the_world_does_with_flows_and_background() -> None:
    actors = (FlowSpec(AcrossJunction(0, 'left', 'right'), 8.0),)
    background = BackgroundSpec('dense', parked=0.4, bystanders=2, cyclists=2)
    world = junction_world('yield', 5, actors, background=background)
    for _ in range(101):
        world.step(drive_on(world))
    fork = world.fork()
    before = world.positions.copy()
    for _ in range(300):
        fork.step(Control(0.4))
    assert np.array_equal(world.positions, before)
    for _ in range(300):
        world.step(Control(0.4))
    assert [a.number for a in world.actors] == [a.number for a in fork.actors]
    assert np.array_equal(world.positions, fork.positions)


def test_equal_seeds_give_equal_traffic_and_numbers_are_unique() -> None:
    def run(seed: int) -> list[tuple[int, float, float]]:
        world = junction_world('light', seed, background=BackgroundSpec('dense', parked=0.4, bystanders=2, cyclists=2))
        for _ in range(400):
            world.step(drive_on(world))
        assert len({a.number for a in world.actors}) == len(world.actors)
        return [(a.number, float(a.position[0]), float(a.position[1])) for a in world.actors]

    assert run(7) == run(7)
    assert run(7) != run(8)


def test_traffic_of_a_later_scene_of_a_chain_is_where_that_scene_is() -> None:
    layout = RoadLayout((Straight(100), Junction('ahead', control='light'), Straight(100)), 1, 1, 11.0)
    actors = (CarSpec(AlongRoad(60.0), 5.0), FlowSpec(AcrossJunction(0, 'left', 'right'), 8.0))
    scene = Scene(layout, RouteSpec(), actors, background=BackgroundSpec('light'))
    whole = joined([Link(scene, 221.0, 221.0)] * 2)
    late_car, late_flow = whole.actors[2:]
    assert late_car.place == AlongRoad(281.0)
    assert late_car.waits_for_s_m == late_flow.from_s_m == pytest.approx(221.0 + 6.0)
    assert late_flow.place.junction == 1
    world = world_of(whole)
    assert {light.junction for light in world.lights} == {0, 1}
    assert len(world.waiting) == 1
    assert not world.flows[1].numbers
