"""The scenario types, and what only some of them use: doors, disturbances, exits, forks of the world."""

import numpy as np
import pytest

from raw2drive_ros.contracts.public import Control
from raw2drive_ros.evaluation.following import pedals, pursuit_steer
from raw2drive_ros.evaluation.suite_plans import PRACTICE
from raw2drive_ros.simulation.actors import CarDoor, PathVehicle
from raw2drive_ros.simulation.criteria import on_road
from raw2drive_ros.simulation.environment import DrivingEnv, SimulationConfig
from raw2drive_ros.simulation.leaders import find_leaders
from raw2drive_ros.simulation.scenario import load_scenarios

FAST = SimulationConfig(cameras=False, bev=False, end_on_infraction=False)
# Types per ability in Bench2Drive; a type may count for several.
ABILITIES = {'Overtaking': 9, 'Merging': 16, 'EmergencyBrake': 12, 'GiveWay': 2, 'TrafficSign': 19}


def world_of(name: str, seed: int = 0) -> DrivingEnv:
    env = DrivingEnv(FAST)
    env.reset(seed=seed, options={'scenario': name})
    return env


def test_all_44_types_with_their_abilities() -> None:
    known = load_scenarios()
    assert len(set(known) - set(PRACTICE)) == 44
    assert {a: sum(a in s.abilities for s in known.values()) for a in ABILITIES} == ABILITIES
    assert all(s.description for s in known.values())


@pytest.mark.parametrize('reverse', [True, False])
def test_driving_far_beyond_either_end_of_the_route_is_no_crash(reverse) -> None:
    world = world_of('VanillaNonSignalizedTurn').world
    for _ in range(1200):
        world.step(Control(0.5, 0.0, 0.0, reverse))
    assert (world.route_s_m < -20.0) == reverse
    x, y = (float(v) for v in world.ego.position)
    assert world.route.project(x, y, world.route_s_m)[0] == pytest.approx(world.route_s_m, abs=1.0)


def test_a_fork_goes_its_own_way_and_leaves_the_world_alone() -> None:
    env = world_of('NonSignalizedJunctionLeftTurn', 1)
    world = env.world
    before = world.positions.copy()
    fork = world.fork()
    for _ in range(60):
        fork.step(Control(0.5))
    assert np.array_equal(world.positions, before)
    assert world.time_s == 0.0
    assert not np.allclose(fork.positions[-1], before[-1])
    # The same commands take the world to where the fork is, to the bit.
    for _ in range(60):
        world.step(Control(0.5))
    assert np.array_equal(world.positions, fork.positions)


def test_a_door_opens_into_the_lane_when_the_ego_comes_near() -> None:
    world = world_of('VehicleOpensDoorTwoWays').world
    door = next(actor for actor in world.actors if isinstance(actor, CarDoor))
    shut = door.position.copy()
    world.step(Control())
    assert np.array_equal(door.position, shut)
    world.route_s_m = door.route_s_m - 10.0
    for _ in range(20):
        door.think(world)
        door.step(0.05)
    moved = door.position - shut
    assert np.hypot(*moved) == pytest.approx(0.95, abs=1e-6)
    # Towards the route: the car is parked on its right.
    assert world.route.project(*door.position)[1] > world.route.project(*shut)[1]


def test_a_disturbance_pushes_the_steering_and_takes_grip() -> None:
    world = world_of('ControlLoss').world
    patch = world.scene.disturbances[0]
    world.step(Control())
    assert (world.ego.steer_push, world.ego.grip) == (0.0, 1.0)
    world.route_s_m = patch.s_m + 1.0
    world.step(Control())
    first = world.ego.steer_push
    assert (abs(first), world.ego.grip) == (abs(patch.steer), patch.grip)
    assert world.ego.steer * first > 0
    while world.time_s < 2 * patch.period_s and world.ego.steer_push == first:
        world.route_s_m = patch.s_m + 1.0
        world.step(Control(0.0, 1.0))
    assert world.ego.steer_push == -first, 'the push changes sides'


def test_the_exit_route_leaves_the_road_to_the_right() -> None:
    world = world_of('HighwayExit').world
    end = world.route.pose(world.route.length_m)
    main = world.road.forward_path(1)
    assert main.project(end[0], end[1])[1] < -5.0
    assert np.degrees(end[2]) == pytest.approx(-16.0, abs=0.5)


def test_who_has_priority_does_not_brake_for_a_crossing_ego_but_for_a_standing_one() -> None:
    """The ego in the path of a car with right of way, turned across it: moving, then standing."""
    world = world_of('NonSignalizedJunctionRightTurn').world
    car = next(a for a in world.actors if getattr(a, 'has_priority', False))
    x, y, yaw = car.path.pose(car.s_m + 9.0)
    world.ego.position[:] = (x, y)
    world.ego.heading = yaw + np.pi / 2
    for speed, brakes in ((4.0, False), (0.0, True)):
        world.ego.speed = speed
        world.refresh()
        find_leaders(world, [car])
        car.think(world)
        assert (car.command_acceleration < -2.0) == brakes, speed


@pytest.mark.parametrize('throttle', [0.2, 0.3])
def test_the_red_light_runner_meets_the_ego_at_whatever_speed(throttle) -> None:
    env = world_of('OppositeVehicleRunningRedLight', 3)
    while not env.done:
        env.step(Control(throttle, 0.0, pursuit_steer(env.world, 0.8)))
    assert env.criteria.events.get('collision_vehicle') == 1


def test_late_traffic_enters_when_it_is_due_and_the_place_is_free() -> None:
    world = world_of('EnterActorFlow', 1).world
    waiting = len(world.pending)
    due = world.pending[0][0]
    assert waiting > 2
    seen = set()
    while world.time_s < 40.0:
        world.step(Control(0.0, 1.0))
        if world.time_s < due - 0.1:
            assert len(world.pending) == waiting
        seen |= {id(actor) for actor in world.actors}
    assert not world.pending
    assert len(seen) == len(world.scene.actors)


def test_a_walker_meets_an_ego_that_keeps_its_speed_whatever_that_is() -> None:
    for speed in (4.0, 6.0, 8.0):
        env = world_of('DynamicObjectCrossing', 3)
        while not env.done:
            steer = pursuit_steer(env.world)
            env.step(pedals(env.world, 1.5 * (speed - env.world.ego.speed), steer))
        assert env.criteria.events.get('collision_pedestrian') == 1, speed


def test_obstacles_stand_on_the_route_and_the_way_past_them_does_not() -> None:
    world = world_of('AccidentTwoWays').world
    begin, end, offset = world.detours[0]
    blocker = min(
        abs(world.route.project(*map(float, actor.position))[1]) for actor in world.actors if actor.kind == 'parked'
    )
    assert blocker < 1.0
    middle = (begin + end) / 2
    assert world.detour_offset_m(middle) == pytest.approx(offset)
    assert world.lateral_range_m(middle) == (0.0, offset)
    assert world.lateral_range_m(begin - 50.0) == (0.0, 0.0)


def test_being_beside_the_route_is_allowed_only_on_the_way_past_an_obstacle() -> None:
    world = world_of('AccidentTwoWays').world
    begin, end, offset = world.detours[0]
    for s_m, allowed in (((begin + end) / 2, True), (begin - 50.0, False)):
        x, y, yaw = world.route.pose(s_m, offset)
        world.ego.position[:] = (x, y)
        world.ego.heading = yaw
        world.route_s_m, world.route_lateral_m = world.route.project(x, y)
        assert on_road(world) == allowed


def test_progress_beside_the_road_does_not_count() -> None:
    env = world_of('VanillaNonSignalizedTurn')
    world = env.world
    for lateral, counts in ((12.0, False), (2.0, True)):
        x, y, yaw = world.route.pose(40.0, lateral)
        world.ego.position[:] = (x, y)
        world.ego.heading = yaw
        world.route_s_m, world.route_lateral_m = world.route.project(x, y)
        env.criteria.step(world)
        assert (env.criteria.best_s_m > 30.0) == counts


def test_a_tight_stream_lets_nobody_through_and_its_gap_does() -> None:
    """Arrivals at the meeting point: within the group no two are 2 s apart, then there is a gap of more than 5 s."""
    world = world_of('NonSignalizedJunctionLeftTurn', 4).world
    arrivals = []
    path = next(a.path for a in world.actors if isinstance(a, PathVehicle))
    passed: set[int] = set()
    while world.time_s < 40.0:
        world.step(Control(0.0, 1.0))
        for actor in world.actors:
            if isinstance(actor, PathVehicle) and actor.path is path and actor.s_m > 70.0 and id(actor) not in passed:
                passed.add(id(actor))
                arrivals.append(world.time_s)
    headways = np.diff(arrivals)
    group = headways[: int(np.argmax(headways > 5.0))]
    assert (headways > 5.0).any()
    assert len(group) >= 4
    assert group.max() < 2.6


def test_traffic_of_a_later_event_waits_for_the_ego() -> None:
    world = world_of('LongRoute').world
    waiting = len(world.waiting)
    assert waiting > 10
    first = world.waiting[0][0]
    for _ in range(40):
        world.step(Control(0.0, 1.0))
    assert len(world.waiting) == waiting
    world.route_s_m = first + 1.0
    world.step(Control(0.0, 1.0))
    assert len(world.waiting) < waiting
    assert world.fork().waiting is not world.waiting
