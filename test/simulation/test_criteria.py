"""Lanes by footprint, forced braking, time in the stretch of an event, needless stops, limits of the protocols."""

from dataclasses import replace

import numpy as np
import pytest

from raw2drive_ros.contracts.public import Control
from raw2drive_ros.evaluation.following import pedals, pursuit_steer
from raw2drive_ros.simulation.actors import PathVehicle, StandingObject, Walker
from raw2drive_ros.simulation.conduct import ENTERED_WITHIN_S, HARD_BRAKING_MPS2
from raw2drive_ros.simulation.criteria import (
    BENCH2DRIVE_SCENARIO_S,
    LANE_CHANGE_M,
    SCENARIO_MPS,
    SCENARIO_S,
    TICK_LIMIT_S,
    Criteria,
    on_road,
)
from raw2drive_ros.simulation.environment import DrivingEnv, SimulationConfig
from raw2drive_ros.simulation.footprint import ego_corners_m
from raw2drive_ros.simulation.layout import LANE_WIDTH_M
from raw2drive_ros.simulation.road_surface import OFF, PIXELS_PER_M, SHOULDER, SIDEWALK
from raw2drive_ros.simulation.world import World
from raw2drive_ros.tables.rates import DECISION_HZ

FAST = SimulationConfig(cameras=False, bev=False, end_on_infraction=False)


def driving(name: str = 'LaneFollowing', seed: int = 0, config: SimulationConfig = FAST) -> DrivingEnv:
    env = DrivingEnv(config)
    env.reset(seed=seed, options={'scenario': name})
    return env


def place(world: World, s_m: float, lateral_m: float) -> None:
    x, y, yaw = world.route.pose(s_m, lateral_m)
    world.ego.position[:] = (x, y)
    world.ego.heading = yaw
    world.route_s_m, world.route_lateral_m = s_m, lateral_m
    world.refresh()


# -- lanes --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(('lateral', 'inside'), [(0.0, True), (1.2, True), (1.3, False), (-1.2, True), (-1.3, False)])
def test_on_one_lane_the_corners_decide(lateral, inside) -> None:
    world = driving().world
    place(world, 30.0, lateral)
    assert on_road(world) == inside


def test_a_turned_car_reaches_out_of_its_lane() -> None:
    world = driving().world
    place(world, 30.0, 0.0)
    world.ego.heading += 0.7
    assert not on_road(world)


def test_the_oncoming_lane_is_open_only_past_an_obstacle() -> None:
    world = driving('ParkedObstacleTwoWays').world
    begin, end, offset = world.detours[0]
    place(world, (begin + end) / 2, offset)
    assert on_road(world)
    place(world, begin - 60.0, offset)
    assert not on_road(world)


@pytest.mark.parametrize(('kind', 'inside'), [(SIDEWALK, False), (SHOULDER, True), (OFF, False)])
def test_a_corner_over_the_kerb_is_outside_however_near_the_lane(monkeypatch, kind, inside) -> None:
    """The surface right of the lane is changed, 0.2 m from its edge."""
    world = driving().world
    place(world, 30.0, -1.0)
    right = ego_corners_m(world)[2:]
    there = np.floor((right - world.road.surface.origin_m) * PIXELS_PER_M).astype(int)
    kinds = world.road.surface.kinds.copy()
    kinds[there[:, 1], there[:, 0]] = kind
    monkeypatch.setattr(world.road.surface, 'kinds', kinds)
    assert on_road(world) == inside


def straddler(side: int):
    return lambda world: pedals(world, 6.0 - world.ego.speed, pursuit_steer(world, offset_m=side * LANE_WIDTH_M / 2))


def keeper(world: World) -> Control:
    return pedals(world, 6.0 - world.ego.speed, pursuit_steer(world))


def test_a_line_between_two_lanes_may_be_crossed_but_not_kept() -> None:
    env = driving('HighwayCutIn')
    assert env.world.scene.layout.forward_lanes > 1
    env.world.actors = []
    env.world.pending = []
    env.world.refresh()
    for _ in range(150):
        env.step(straddler(-1 if env.world.scene.route.lane == 0 else 1)(env.world))
    assert (
        env.criteria.travelled_m - LANE_CHANGE_M - 30.0
        < env.criteria.outside_m
        < env.criteria.travelled_m - LANE_CHANGE_M
    )
    while env.criteria.straddled_m > 0.0:
        env.step(keeper(env.world))
    before = env.criteria.outside_m
    for _ in range(10):
        env.step(keeper(env.world))
    assert env.criteria.outside_m == before


# -- others -------------------------------------------------------------------------------------------------


def braking(world: World, lateral_m: float, kind: str = 'car') -> PathVehicle:
    """A car behind the ego that has to brake, on a path `lateral_m` left of the route."""
    path = world.route if lateral_m == 0.0 else world.route.shifted(lambda s: lateral_m)
    vehicle = PathVehicle(path, world.route_s_m - 20.0, 5.0, 5.0, kind)
    vehicle.imposed_mps2 = HARD_BRAKING_MPS2 + 0.5
    return vehicle


def test_cutting_in_is_counted_once_per_actor() -> None:
    world = driving().world
    criteria = Criteria()
    criteria.step(world)
    world.actors = [braking(world, 3.5), braking(world, 3.5)]
    world.refresh()
    assert criteria.step(world) == ['forced_braking', 'forced_braking']
    assert criteria.step(world) == []
    assert criteria.events == {'forced_braking': 2}


@pytest.mark.parametrize('change', ['in its lane for long', 'gentle', 'emergency'])
def test_who_brakes_for_other_reasons_is_not_counted(change) -> None:
    world = driving().world
    actor = braking(
        world, 0.0 if change == 'in its lane for long' else 3.5, 'emergency' if change == 'emergency' else 'car'
    )
    if change == 'gentle':
        actor.imposed_mps2 = HARD_BRAKING_MPS2
    criteria = Criteria()
    criteria.step(world)
    world.actors = [actor]
    world.refresh()
    for _ in range(5):
        assert criteria.step(world) == []


def test_an_ego_that_entered_long_ago_has_not_cut_in() -> None:
    world = driving().world
    actor = braking(world, 3.5)
    world.actors = [actor]
    actor.imposed_mps2 = 0.0
    world.refresh()
    criteria = Criteria()
    criteria.step(world)
    place(world, world.route_s_m, 3.5)
    for _ in range(round(ENTERED_WITHIN_S * DECISION_HZ)):
        criteria.step(world)
    actor.imposed_mps2 = 5.0
    assert criteria.step(world) == []


# -- time ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ('protocol', 'allowed_s'), [('pairs', SCENARIO_S + 20.0 / SCENARIO_MPS), ('bench2drive', BENCH2DRIVE_SCENARIO_S)]
)
def test_the_stretch_of_an_event_is_to_be_left_in_time(protocol, allowed_s) -> None:
    world = driving().world
    world.scene = replace(world.scene, event_s_m=(20.0, 40.0))
    criteria = Criteria(protocol=protocol)
    place(world, 10.0, 0.0)
    world.time_s = 5.0
    criteria.step(world)
    place(world, 30.0, 0.0)
    criteria.step(world)
    world.time_s += allowed_s - 0.1
    assert criteria.step(world) == []
    world.time_s += 0.2
    assert criteria.step(world) == ['scenario_timeout']
    assert criteria.step(world) == []
    place(world, 45.0, 0.0)
    late = Criteria(protocol=protocol)
    late.step(world)
    world.time_s += 1000.0
    assert late.step(world) == [], 'who has left it has all the time'


def test_limits_are_those_of_suite_scene_or_protocol() -> None:
    world = driving().world
    assert Criteria(31.5).limit_s(world) == 31.5
    assert Criteria().limit_s(world) > 31.5
    assert Criteria(31.5, 'bench2drive').limit_s(world) == TICK_LIMIT_S


# -- needless stops -----------------------------------------------------------------------------------------


def stand(env: DrivingEnv, seconds: float) -> float:
    for _ in range(round(seconds * DECISION_HZ)):
        env.step(Control(0.0, 1.0))
    return env.criteria.needless_stop_s


def with_actors(env: DrivingEnv, *actors) -> DrivingEnv:
    env.world.actors = list(actors)
    env.world.pending, env.world.waiting = [], []
    env.world.refresh()
    return env


def walker(world: World, from_m: float, to_m: float, speed_mps: float) -> Walker:
    found = Walker(world.route, world.route_s_m + 12.0, from_m, to_m, 1.0, 0.0)
    found.speed = speed_mps
    return found


def test_standing_on_an_empty_road_is_needless() -> None:
    assert stand(with_actors(driving()), 2.0) == pytest.approx(2.0, abs=0.15)


def test_a_walker_who_stands_at_the_kerb_is_no_reason_and_one_who_comes_is() -> None:
    env = driving()
    assert stand(with_actors(env, walker(env.world, 4.5, -4.5, 0.0)), 2.0) > 1.5
    env = driving()
    assert stand(with_actors(env, walker(env.world, 4.5, -4.5, 1.0)), 2.0) < 0.2


def test_an_obstacle_ahead_is_a_reason_and_one_beside_the_lane_is_none() -> None:
    for lateral, reason in ((0.0, True), (3.2, False)):
        env = driving()
        x, y, yaw = env.world.route.pose(env.world.route_s_m + 15.0, lateral)
        assert (stand(with_actors(env, StandingObject(x, y, yaw, 'parked')), 2.0) < 0.2) == reason


def test_crossing_traffic_is_a_reason_and_a_follower_is_none() -> None:
    env = driving()
    follower = PathVehicle(env.world.route, env.world.route_s_m - 12.0, 0.6, 0.6, ignores_traffic=True)
    assert stand(with_actors(env, follower), 2.0) > 1.5
    env = driving()
    oncoming = PathVehicle(env.world.road.backward_path(0), 0.0, 8.0, 8.0, ignores_traffic=True)
    oncoming.s_m = oncoming.path.end_s_m - env.world.route_s_m - 30.0
    assert stand(with_actors(env, oncoming), 1.5) < 0.2


def test_a_red_light_is_a_reason_and_a_green_one_is_none() -> None:
    for colour, reason in (('red', True), ('green', False)):
        env = driving('VanillaSignalizedTurnEncounterRedLight')
        light = env.world.lights[0]
        light.phases = ((colour, 1e9),)
        place(env.world, light.line_s_m - 8.0, 0.0)
        env.world.ego.speed = 0.0
        assert (stand(with_actors(env), 2.0) < 0.3) == reason


def test_corners_are_those_of_the_car() -> None:
    world = driving().world
    corners = ego_corners_m(world)
    assert np.ptp(corners, axis=0) == pytest.approx((4.8, 2.0), abs=1e-6)
