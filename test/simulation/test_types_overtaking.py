"""Types of overtaking and of merging on roads: twins are alike until the event, which happens at any speed."""

import numpy as np
import pytest

from raw2drive_ros.contracts.public import Control
from raw2drive_ros.evaluation.following import pedals, pursuit_steer
from raw2drive_ros.simulation.actors import CarDoor, PathVehicle, StandingObject, boxes_overlap, corners_m
from raw2drive_ros.simulation.draws import EVALUATION, Draw, split_of_cell
from raw2drive_ros.simulation.scenario import get_scenario
from raw2drive_ros.simulation.scenarios.overtaking import DAWDLE_MPS
from raw2drive_ros.simulation.world import World

BLOCKED = (
    'ParkedObstacle',
    'ConstructionObstacle',
    'Accident',
    'ParkedObstacleTwoWays',
    'ConstructionObstacleTwoWays',
    'AccidentTwoWays',
)
CYCLISTS = ('HazardAtSideLane', 'HazardAtSideLaneTwoWays')
STREAMS = ('MergerIntoSlowTraffic', 'MergerIntoSlowTrafficV2', 'HighwayExit', 'SequentialLaneChange', 'ParkingExit')
TYPES = (*BLOCKED, *CYCLISTS, 'VehicleOpensDoorTwoWays', *STREAMS, 'HighwayCutIn')


def world_of(name: str, seed: int, *, event: bool = True) -> World:
    return World(get_scenario(name), Draw(name, seed, event))


def drive_on(world: World, speed_mps: float) -> None:
    """One step along the route, whatever is there."""
    world.step(pedals(world, 1.5 * (speed_mps - world.ego.speed), pursuit_steer(world)))


def near(world: World, within_m: float) -> list[tuple[str, str, int, float, float]]:
    """(kind, body, colour, x, y) of the actors near the ego."""
    return sorted(
        (a.kind, a.body, a.colour, round(float(a.position[0]), 3), round(float(a.position[1]), 3))
        for a in world.actors
        if world.ego_distance_m(a.position) < within_m
    )


def blockers(world: World) -> list[float]:
    """Arc lengths of standing things in the ego's lane."""
    found = []
    for actor in world.actors:
        if isinstance(actor, StandingObject):
            s_m, lateral = world.route.project(*map(float, actor.position))
            reach = world.scene.layout.lane_width_m / 2 - 0.3 + actor.WIDTH / 2
            found += [s_m] if abs(lateral) < reach and actor.kind != 'door' else []
    return found


@pytest.mark.parametrize('name', TYPES)
def test_event_and_twin_are_the_same_scene(name) -> None:
    for seed in (0, 1):
        one, other = (world_of(name, seed, event=event) for event in (True, False))
        assert one.scene.layout == other.scene.layout
        assert np.array_equal(one.route.points_m, other.route.points_m)
        assert one.draw.parameters == other.draw.parameters
        # A stream that has passed is not there in the twin; everything else is.
        if name not in STREAMS:
            assert near(one, 80.0) == near(other, 80.0)
        kinds = [sorted(type(spec).__name__ for spec in world.scene.actors) for world in (one, other)]
        assert kinds[0] == kinds[1]


@pytest.mark.parametrize('name', [*BLOCKED, *CYCLISTS])
def test_obstacles_are_in_the_lane_or_beside_it(name) -> None:
    for seed in (0, 1, 2):
        for event in (True, False):
            world = world_of(name, seed, event=event)
            if name in CYCLISTS:
                riders = [a for a in world.actors if a.kind == 'cyclist' and a.target_speed == DAWDLE_MPS]
                laterals = [world.route.project(*map(float, rider.position))[1] for rider in riders]
                assert len(riders) == 2
                assert (max(laterals) > -0.3) == event
                assert (max(laterals) < -world.scene.layout.lane_width_m / 2 - 0.3) == (not event)
                continue
            assert bool(blockers(world)) == event
            begin, end = world.scene.event_s_m
            assert all(begin < s_m < end for s_m in blockers(world))
            assert begin > 60.0, 'out of sight at the start'


@pytest.mark.parametrize('speed_mps', [4.0, 8.0, 12.0])
def test_the_door_is_open_before_the_ego_is_there(speed_mps) -> None:
    for event in (True, False):
        world = world_of('VehicleOpensDoorTwoWays', 0, event=event)
        door = next(actor for actor in world.actors if isinstance(actor, CarDoor))
        while world.front_s_m < door.route_s_m - 1.0 and world.time_s < 80.0:
            drive_on(world, speed_mps)
        assert (door.part == 1.0) == event
        reach = world.route.project(*map(float, door.position))[1] + door.WIDTH / 2
        assert (reach > -1.0) == event, 'the corridor of a car in the middle of the lane'


@pytest.mark.parametrize('speed_mps', [4.0, 8.0, 12.0])
def test_the_car_from_the_ramp_cuts_in_at_any_speed(speed_mps) -> None:
    for event in (True, False):
        world = world_of('HighwayCutIn', 0, event=event)
        car = next(actor for actor in world.actors if isinstance(actor, PathVehicle) and actor.steered is not None)
        while not world.contacts and world.route_s_m < world.scene.event_s_m[1] and world.time_s < 90.0:
            drive_on(world, speed_mps)
        assert bool(world.contacts) == event
        assert not event or world.contacts[0].actor is car


@pytest.mark.parametrize('name', CYCLISTS)
def test_cyclists_are_caught_up_with_at_any_speed(name) -> None:
    for speed_mps in (4.0, 12.0):
        for event in (True, False):
            world = world_of(name, 0, event=event)
            while not world.contacts and world.route_s_m < world.scene.event_s_m[1] and world.time_s < 90.0:
                drive_on(world, speed_mps)
            assert any(contact.actor.kind == 'cyclist' for contact in world.contacts) == event


@pytest.mark.parametrize('name', STREAMS)
def test_the_stream_is_there_when_the_ego_comes_or_has_passed(name) -> None:
    counts = []
    for event in (True, False):
        world = world_of(name, 0, event=event)
        flow = world.flows[0]
        while flow.ego_s_m - world.route_s_m > 12.0 and world.time_s < 60.0:
            drive_on(world, 8.0)
        coming = [
            actor
            for actor in world.actors
            if actor.number in flow.numbers and flow.point_s_m - 45.0 < actor.s_m < flow.point_s_m
        ]
        counts.append(len(coming))
    assert counts[0] >= 2
    assert counts[1] <= 1


@pytest.mark.parametrize('name', TYPES)
def test_actors_keep_clear_of_each_other(name) -> None:
    world = world_of(name, 1)
    touching: set[tuple[str, str]] = set()
    while world.time_s < 30.0:
        world.step(Control(0.0, 1.0))
        if world.physics_ticks % 10:
            continue
        boxes = [corners_m(*map(float, a.position), a.heading, a.LENGTH, a.WIDTH) for a in world.actors]
        for i, a in enumerate(world.actors):
            for j in range(i):
                b = world.actors[j]
                still = isinstance(a, StandingObject) and isinstance(b, StandingObject)
                if not still and np.abs(a.position - b.position).max() < 7.0 and boxes_overlap(boxes[i], boxes[j]):
                    touching.add((a.kind, b.kind))
    assert not touching


@pytest.mark.parametrize('name', TYPES)
def test_evaluation_owns_enough_cells(name) -> None:
    found = set()
    for seed in range(300):
        draw = Draw(name, seed)
        get_scenario(name).draw(draw)
        if split_of_cell(name, draw.cell()) == EVALUATION:
            found.add(draw.cell())
    assert len(found) >= 8
