"""Contacts: what an impact does to the ego and to others, and what counts as a collision."""

import numpy as np
import pytest

from raw2drive_ros.contracts.public import Control
from raw2drive_ros.evaluation.following import pedals, pursuit_steer
from raw2drive_ros.simulation.actors import PathVehicle, StandingObject, Walker, boxes_overlap, corners_m
from raw2drive_ros.simulation.contact import EGO_KG, MASSES_KG
from raw2drive_ros.simulation.environment import DrivingEnv, SimulationConfig
from raw2drive_ros.simulation.world import World

DRIVE_ON = SimulationConfig(cameras=False, bev=False, end_on_infraction=False)


def on_a_road(*actors, speed_mps: float = 8.0) -> DrivingEnv:
    """LaneFollowing with these actors alone, each made by a function of the world."""
    env = DrivingEnv(DRIVE_ON)
    env.reset(seed=0)
    env.world.ego.speed = speed_mps
    env.world.actors = [make(env.world) for make in actors]
    env.world.refresh()
    return env


def standing(kind: str, ahead_m: float = 8.0, lateral_m: float = 0.0):
    def make(world: World) -> StandingObject:
        x, y, yaw = world.route.pose(world.route_s_m + ahead_m, lateral_m)
        return StandingObject(x, y, yaw, kind)

    return make


def car(ahead_m: float, speed_mps: float):
    return lambda world: PathVehicle(world.route, world.route_s_m + ahead_m, speed_mps, speed_mps, ignores_traffic=True)


def box(actor) -> np.ndarray:
    x, y = (float(v) for v in actor.position)
    return corners_m(x, y, actor.heading, actor.LENGTH, actor.WIDTH)


def overlaps(world: World) -> bool:
    return any(boxes_overlap(box(world.ego), box(actor)) for actor in world.actors)


def coast(env: DrivingEnv, ticks: int, control: Control | None = None) -> None:
    for _ in range(ticks):
        env.step(control or pedals(env.world, 0.0, pursuit_steer(env.world)))
        assert not overlaps(env.world)


def test_a_parked_car_stops_the_ego_and_does_not_move_and_the_drive_goes_on() -> None:
    env = on_a_road(standing('parked'))
    parked = env.world.actors[0].position.copy()
    coast(env, 30)
    assert np.array_equal(env.world.actors[0].position, parked)
    assert env.criteria.events == {'collision_vehicle': 1}
    assert abs(env.world.ego.speed) < 0.5
    assert not env.done
    deepest = min(acceleration for acceleration, _, _ in env.motion)
    assert deepest < -30.0, 'the IMU feels the impact'


def test_closing_speed_is_lost_and_shared_by_mass() -> None:
    env = on_a_road(car(6.0, 3.0))
    before = env.world.ego.speed
    while not env.world.contacts:
        env.world.step(Control())
        before = before if env.world.contacts else env.world.ego.speed
    common = (EGO_KG * before + MASSES_KG['car'] * 3.0) / (EGO_KG + MASSES_KG['car'])
    assert env.world.actors[0].speed == pytest.approx(common, rel=0.02)
    assert env.world.ego.speed == pytest.approx(common, rel=0.02)
    assert env.world.contacts[0].impact_mps == pytest.approx(before - 3.0, abs=0.2)


def test_along_a_wall_the_ego_loses_little() -> None:
    env = on_a_road(*(standing('barrier', 3.0 * i, 2.3) for i in range(16)))
    env.world.ego.heading += 0.05
    start = env.world.ego.speed
    coast(env, 25, Control(0.1))
    assert env.world.contacts
    assert env.world.ego.speed > 0.7 * start


@pytest.mark.parametrize(('speed', 'counts'), [(2.5, False), (8.0, True)])
def test_a_cone_is_pushed_aside_and_costs_only_at_speed(speed, counts) -> None:
    env = on_a_road(standing('cone', 5.0), speed_mps=speed)
    where = env.world.actors[0].position.copy()
    fork = env.world.fork()
    for _ in range(50):
        fork.step(Control(0.3))
    assert np.array_equal(env.world.actors[0].position, where), 'a fork leaves the world alone'
    assert not np.array_equal(fork.actors[0].position, where)
    coast(env, 20, Control(0.2))
    assert not np.array_equal(env.world.actors[0].position, where)
    assert env.criteria.events == ({'collision_static': 1} if counts else {})
    assert env.world.ego.speed > 0.7 * speed


def test_debris_is_driven_over(monkeypatch) -> None:
    env = on_a_road(standing('barrier', 6.0))
    env.world.actors[0].kind = 'debris'
    for _ in range(10):
        env.step(Control(0.2))
    assert env.world.contacts == ()
    assert env.criteria.events == {}


@pytest.mark.parametrize(('kind', 'name'), [('walker', 'collision_pedestrian'), ('cyclist', 'collision_vehicle')])
def test_who_is_hit_is_pushed_and_counted_once(kind, name) -> None:
    env = on_a_road(lambda world: Walker(world.route, world.route_s_m + 7.0, 0.2, -0.2, 1.0, 0.0, kind))
    where = env.world.actors[0].position.copy()
    coast(env, 20)
    assert env.criteria.events == {name: 1}
    assert np.hypot(*(env.world.actors[0].position - where)) > 1.0
    assert env.world.ego.speed > 4.0


def test_who_stands_and_is_hit_has_done_nothing() -> None:
    env = on_a_road(car(-9.0, 6.0), speed_mps=0.0)
    coast(env, 30, Control(0.0, 1.0))
    assert env.world.contacts
    assert env.criteria.events == {}


def test_the_same_place_counts_once_and_another_place_again() -> None:
    env = on_a_road(standing('walker', 7.0), standing('walker', 7.8, 0.7), standing('barrier', 25.0))
    coast(env, 60, Control(0.5))
    assert env.criteria.events == {'collision_static': 2}


def test_a_squeezed_ego_stays_out_of_everybody() -> None:
    env = on_a_road(*(standing('barrier', *p) for p in ((4.2, 0.0), (0.0, 2.15), (0.0, -2.15))), car(-8.0, 9.0))
    coast(env, 25, Control(0.3))
    assert env.world.contacts


def test_training_ends_at_the_first_collision() -> None:
    env = DrivingEnv(SimulationConfig(cameras=False, bev=False))
    env.reset(seed=0)
    env.world.ego.speed = 8.0
    env.world.actors = [standing('parked')(env.world)]
    env.world.refresh()
    while not env.done:
        _, reward, terminated, _, _ = env.step(Control(0.3))
    assert terminated
    assert reward == pytest.approx(-1.0 - env.world.contacts[0].ego_speed_mps)
    assert env.world.contacts[0].ego_speed_mps > 7.0
