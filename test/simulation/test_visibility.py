"""What counts as seen: pixels of the id buffer, and what fog, night and rain leave of them."""

import math
from dataclasses import replace

import numpy as np
import pytest

from raw2drive_ros.contracts.public import Control
from raw2drive_ros.simulation.actors import Look, PathVehicle, StandingObject, Walker
from raw2drive_ros.simulation.environment import DrivingEnv, SimulationConfig
from raw2drive_ros.simulation.id_painter import IdPainter
from raw2drive_ros.simulation.visibility import MEMORY_S, VEHICLE_PX, Visibility
from raw2drive_ros.simulation.weather import WEATHERS

FRONT = 0


@pytest.fixture
def road() -> DrivingEnv:
    """A road with nothing on it."""
    env = DrivingEnv(SimulationConfig(bev=False))
    env.reset(seed=0)
    env.world.actors.clear()
    env.world.refresh()
    return env


def standing(env: DrivingEnv, ahead_m: float, left_m: float, kind: str, body: str = '') -> StandingObject:
    world = env.world
    x, y, yaw = world.route.pose(world.route_s_m + ahead_m, left_m)
    return StandingObject(x, y, yaw, kind, Look(body or kind))


def walker(env: DrivingEnv, ahead_m: float, left_m: float) -> Walker:
    return Walker(env.world.route, env.world.route_s_m + ahead_m, left_m, 3.0, 1.0, 0.0)


def look(env: DrivingEnv, actors: list, weather: str = 'ClearNoon') -> Visibility:
    env.world.actors = actors
    env.world.refresh()
    env.renderer.render()
    visibility = Visibility(WEATHERS[weather])
    visibility.update(env.world, env.renderer.counts, env.renderer.signal_counts)
    return visibility


def test_a_car_ahead_shows_as_many_pixels_as_it_changes_in_the_picture(road) -> None:
    empty = road.renderer.render()['front'].astype(int)
    car = standing(road, 15.0, 0.0, 'parked', 'suv')
    seen = look(road, [car])
    changed = (np.abs(road.renderer.render()['front'].astype(int) - empty).max(axis=2) > 12).sum()
    # The shadow below the car changes the picture too, but does not count.
    assert 0.75 * changed < seen.pixels(car)[FRONT] <= changed
    assert seen.pixels(car)[1:].sum() == 0
    assert seen.seconds_since_seen(car) == 0.0


def test_who_stands_behind_a_van_is_not_seen(road) -> None:
    van, hidden = standing(road, 10.0, 0.0, 'parked_van'), walker(road, 16.0, 0.0)
    seen = look(road, [van, hidden])
    assert seen.pixels(hidden).sum() == 0
    assert seen.seconds_since_seen(hidden) == math.inf
    assert seen.rows(road.world).tolist() == [True, False]
    beside = walker(road, 16.0, -3.5)
    assert look(road, [van, beside]).rows(road.world).tolist() == [True, True]


def test_what_half_hides_behind_a_car_shows_fewer_pixels(road) -> None:
    alone = standing(road, 20.0, 0.0, 'parked', 'suv')
    whole = look(road, [alone]).pixels(alone)[FRONT]
    before = standing(road, 12.0, 1.3, 'parked_van')
    part = look(road, [alone, before]).pixels(alone)[FRONT]
    assert 0.1 * whole < part < 0.75 * whole


def test_fog_hides_what_is_far_and_lets_what_is_near_be_seen(road) -> None:
    for ahead_m, expected in ((12.0, True), (50.0, False)):
        car = standing(road, ahead_m, 0.0, 'parked', 'suv')
        assert look(road, [car]).rows(road.world).tolist() == [True]
        assert look(road, [car], 'FogNoon').rows(road.world).tolist() == [expected]


def test_a_walker_outside_the_beam_of_the_headlights_needs_more_pixels(road) -> None:
    aside, ahead = (walker(road, 16.0, 14.0) for _ in range(2)), [walker(road, 16.0, 0.5)]
    aside = [next(aside)]
    assert look(road, aside).rows(road.world).tolist() == [True]
    pixels = look(road, aside).pixels(aside[0]).max()
    dark = replace(WEATHERS['ClearNight'], light=0.9 * 10.0 / pixels)
    for actors, expected in ((aside, False), (ahead, True)):
        road.world.actors = actors
        road.world.refresh()
        road.renderer.render()
        seen = Visibility(dark)
        seen.update(road.world, road.renderer.counts, road.renderer.signal_counts)
        assert seen.rows(road.world).tolist() == [expected]


def test_lit_lamps_show_a_car_in_the_dark(road) -> None:
    clear = Visibility(WEATHERS['ClearNight'])
    behind = np.array([[-20.0, 0.0]])
    lit, unlit = (clear.clearness(behind, np.array([lamps]))[0] for lamps in (True, False))
    assert unlit == pytest.approx(WEATHERS['ClearNight'].light)
    assert lit > unlit
    by_day = Visibility(WEATHERS['ClearNoon']).clearness(behind, np.array([False]))
    assert by_day[0] == 1.0


def test_rain_hides_a_part(road) -> None:
    near = np.array([[1.0, 0.0]])
    wet = Visibility(WEATHERS['HardRainNoon']).clearness(near, np.array([False]))[0]
    soft = Visibility(WEATHERS['SoftRainNoon']).clearness(near, np.array([False]))[0]
    assert 0.5 < wet < soft < 1.0


def test_the_threshold_grows_with_the_image(road) -> None:
    car = standing(road, 20.0, 0.0, 'car')
    road.world.actors = [car]
    counts, none = np.zeros((1, 6), np.int32), np.zeros((0, 6), np.int32)
    counts[0, 2] = VEHICLE_PX
    for factor, expected in ((1, [True]), (2, [False])):
        seen = Visibility(WEATHERS['ClearNoon'], image_px=factor * 96 * 160)
        seen.update(road.world, counts, none)
        assert seen.rows(road.world).tolist() == expected


def test_memory_counts_from_when_it_was_seen_last(road) -> None:
    world = road.world
    car = standing(road, 20.0, 0.0, 'car')
    world.actors = [car]
    seen = Visibility(WEATHERS['ClearNoon'])
    none = np.zeros((0, 6), np.int32)
    for time_s, pixels in ((0.0, 0), (0.1, 20), (1.1, 0), (2.1, 0), (2.2, 0)):
        world.time_s = time_s
        seen.update(world, np.full((1, 6), pixels), none)
        if time_s == 0.0:
            assert seen.seconds_since_seen(car) == math.inf
        if time_s == 2.1:
            assert seen.seconds_since_seen(car) == pytest.approx(MEMORY_S)
            assert seen.rows(world, MEMORY_S + 1e-6).tolist() == [True]
    assert seen.rows(world).tolist() == [False]
    world.actors = []
    seen.update(world, np.zeros((0, 6)), none)
    assert seen.seconds_since_seen(car) == math.inf


def test_actors_with_a_number_are_told_apart_by_it(road) -> None:
    world = road.world
    car, other = standing(road, 20.0, 0.0, 'car'), standing(road, 30.0, 0.0, 'car')
    car.number, other.number = 7, 8
    world.actors = [car, other]
    seen = Visibility(WEATHERS['ClearNoon'])
    seen.update(world, np.array([[50] + [0] * 5, [0] * 6]), np.zeros((0, 6)))
    copy = standing(road, 20.0, 0.0, 'car')
    copy.number = 7
    assert seen.seconds_since_seen(copy) == 0.0
    assert seen.seen([other, copy]).tolist() == [False, True]


def test_counts_of_another_shape_are_refused(road) -> None:
    with pytest.raises(ValueError, match='1 actors'):
        road.world.actors = [standing(road, 20.0, 0.0, 'car')]
        Visibility(WEATHERS['ClearNoon']).update(road.world, np.zeros((2, 6)), np.zeros((0, 6)))


@pytest.mark.parametrize('scenario', ['SignalizedJunctionLeftTurn', 'ConstructionObstacle', 'PedestrianCrossing'])
@pytest.mark.parametrize('repetition', [0, 2])
def test_without_cameras_the_counts_are_the_same(scenario, repetition) -> None:
    kept = []
    for cameras in (True, False):
        env = DrivingEnv(SimulationConfig(cameras=cameras))
        env.reset(seed=5, options={'scenario': scenario, 'repetition': repetition, 'weather': 'ClearNight'})
        rows = []
        for _ in range(30):
            env.step(Control(0.4))
            pixels = [env.visibility.pixels(actor) for actor in env.world.actors]
            rows.append((pixels, env.visibility.signal_pixels(), env.visibility.rows(env.world)))
        kept.append(rows)
    assert sum(np.sum(pixels) for pixels, *_ in kept[0]) > 100
    for with_cameras, without in zip(*kept, strict=True):
        for one, other in zip(with_cameras, without, strict=True):
            assert np.array_equal(one, other)


def test_the_face_of_a_light_is_seen_from_the_front_and_not_from_behind() -> None:
    env = DrivingEnv(SimulationConfig(bev=False))
    env.reset(seed=1, options={'scenario': 'SignalizedJunctionLeftTurn'})
    world = env.world
    world.actors.clear()
    x, y, yaw = world.lights[0].pole_pose
    for away_m, expected in ((20.0, True), (-20.0, False)):
        ego = world.ego
        ego.position[:] = (x + away_m * math.cos(yaw), y + away_m * math.sin(yaw))
        ego.heading = yaw + math.pi
        world.refresh()
        env.renderer.render()
        seen = Visibility(WEATHERS['ClearNoon'])
        seen.update(world, env.renderer.counts, env.renderer.signal_counts)
        assert (seen.light_seen_s(0) == 0.0) == expected


def test_visibility_is_kept_where_somebody_looks() -> None:
    for config, expected in (
        (SimulationConfig(cameras=False), True),
        (SimulationConfig(cameras=False, bev=False), False),
        (SimulationConfig(cameras=False, bev=False, visibility=True), True),
        (SimulationConfig(visibility=False, bev=False), False),
    ):
        env = DrivingEnv(config)
        env.reset(seed=0)
        assert (env.visibility is not None) == expected


def test_the_painter_of_numbers_alone_asks_for_a_world() -> None:
    env = DrivingEnv(SimulationConfig(cameras=False, bev=False))
    with pytest.raises(RuntimeError, match='new_world'):
        IdPainter(env.rig).count()


def test_an_oncoming_vehicle_far_away_is_seen_late(road) -> None:
    world = road.world
    path = world.route
    distances = []
    for ahead_m in (20.0, 40.0, 60.0, 78.0, 95.0):
        car = PathVehicle(path, world.route_s_m + ahead_m, 5.0, 5.0, 'car', Look('sedan'), lateral_m=3.5)
        distances.append((ahead_m, int(look(road, [car]).pixels(car).max())))
    pixels = [count for _, count in distances]
    assert pixels == sorted(pixels, reverse=True)
    assert pixels[0] > 50
    assert pixels[-1] == 0
