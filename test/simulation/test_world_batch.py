"""Worlds that are stepped together go through the same states as alone, bit for bit."""

import numpy as np
import pytest

from raw2drive_ros.contracts.actions import ACTIONS
from raw2drive_ros.simulation.environment import DrivingEnv, SimulationConfig
from raw2drive_ros.simulation.footprint import ways_of
from raw2drive_ros.simulation.path import Path, project_groups
from raw2drive_ros.simulation.reward import vehicles_ahead_m
from raw2drive_ros.simulation.route_id import RouteId
from raw2drive_ros.simulation.scenario import load_scenarios
from raw2drive_ros.simulation.world_batch import WorldBatch

PLAIN = SimulationConfig(cameras=False, bev=False, end_on_infraction=False)
TICKS = 60


def state(env: DrivingEnv, reward: float) -> tuple:
    world = env.world
    arrays = (world.positions, world.headings, world.speeds)
    return reward, env.criteria.outside_m, env.criteria.straddled_m, *(array.tobytes() for array in arrays)


def action_of(number: int, tick: int):
    """Accelerates, steers this way and that, and brakes, each environment in its own rhythm."""
    return ACTIONS[(14, 14, 17, 11, 14, 0)[(tick // 8 + number) % 6]]


def routes() -> list[RouteId]:
    """Every type, one batch after another."""
    return [RouteId(name, 7 * i, twin=False) for i, name in enumerate(sorted(load_scenarios()))]


@pytest.mark.parametrize('part', range(4))
def test_a_batch_is_its_worlds_alone(part) -> None:
    """Each batch holds worlds of other types; some episodes end before others."""
    mine = routes()[part::4]
    batch = WorldBatch([DrivingEnv(PLAIN) for _ in mine])
    for i, route in enumerate(mine):
        batch.reset(i, route)
    found = [[] for _ in mine]
    for tick in range(TICKS):
        for i, stepped in batch.step({i: action_of(i, tick) for i in batch.driving}).items():
            found[i].append(state(batch.envs[i], stepped[1]))
    env = DrivingEnv(PLAIN)
    for i, route in enumerate(mine):
        env.reset_to(route)
        for tick, expected in enumerate(found[i]):
            _, reward, *_ = env.step(action_of(i, tick))
            assert state(env, reward) == expected, f'{route} at tick {tick}'
        assert env.done or len(found[i]) == TICKS
    assert sum(len(states) for states in found) > 0.8 * TICKS * len(mine)


def test_pictures_and_masks_of_a_batch_are_those_of_its_worlds() -> None:
    config = SimulationConfig((32, 48), end_on_infraction=False)
    batch = WorldBatch([DrivingEnv(config) for _ in range(3)])
    mine = [RouteId('Accident', 1, 'HardRainNight'), RouteId('PedestrianCrossing', 2), RouteId('HighwayCutIn', 3)]
    for i, route in enumerate(mine):
        batch.reset(i, route)
    for tick in range(5):
        stepped = batch.step({i: action_of(i, tick) for i in range(3)})
    alone = DrivingEnv(config)
    for i, route in enumerate(mine):
        alone.reset_to(route)
        for tick in range(5):
            expected, *_ = alone.step(action_of(i, tick))
        seen = stepped[i][0]
        assert all(np.array_equal(seen.sensors.images[name], image) for name, image in expected.sensors.images.items())
        assert np.array_equal(seen.privileged.bev, expected.privileged.bev)
        assert np.array_equal(seen.privileged.bev_visible, expected.privileged.bev_visible)
        assert seen.privileged.actors.tobytes() == expected.privileged.actors.tobytes()


def test_a_batch_steps_those_that_are_asked_for() -> None:
    batch = WorldBatch([DrivingEnv(PLAIN) for _ in range(2)])
    batch.reset(0, RouteId('Accident', 1))
    assert batch.driving == [0]
    with pytest.raises(RuntimeError, match='call reset'):
        batch.step({0: ACTIONS[14], 1: ACTIONS[14]})
    batch.reset(1, RouteId('Accident', 2))
    before = batch.envs[1].world.time_s
    assert batch.step({0: ACTIONS[14]}).keys() == {0}
    assert (batch.envs[0].world.time_s, batch.envs[1].world.time_s) == (0.1, before)
    assert batch.step({}) == {}


def test_places_of_many_paths_are_those_of_each() -> None:
    """Paths of different lengths, hints at their ends and beyond, one point and many."""
    rng = np.random.default_rng(3)
    queries = []
    for i in range(12):
        bend = np.cumsum(np.cumsum(rng.normal(0.0, 0.02, 40 + 20 * i)))
        points = np.cumsum(np.stack([np.cos(bend), np.sin(bend)], axis=1), axis=0)
        path = Path(points, start_s_m=-5.0 * i)
        hint = float(rng.uniform(path.start_s_m - 20.0, path.length_m + 20.0))
        near = np.array([path.pose(min(max(hint, path.start_s_m), path.length_m))[:2]])
        queries.append((path, near + rng.normal(0.0, 4.0, (1 + i % 5, 2)), hint))
    together = project_groups(queries, 8.0)
    for (path, points, hint), (stations, laterals) in zip(queries, together, strict=True):
        expected = path.project_many(points, hint, 8.0)
        assert stations.tobytes() == expected[0].tobytes() and laterals.tobytes() == expected[1].tobytes()
        one = [path.project(*point, hint, 8.0) for point in points.tolist()]
        assert np.allclose(np.stack([stations, laterals], axis=1), one, atol=1e-9)
    assert project_groups([], 8.0) == []


def test_ways_and_vehicles_ahead_of_many_worlds_are_those_of_each() -> None:
    """Egos on, beside and off their routes."""
    rng = np.random.default_rng(4)
    worlds = []
    for route in routes():
        env = DrivingEnv(PLAIN)
        env.reset_to(route)
        ego = env.world.ego
        s_m = env.world.route_s_m + float(rng.uniform(0.0, 60.0))
        x, y, yaw = env.world.route.pose(s_m, float(rng.normal(0.0, 2.0)))
        ego.position[:] = x, y
        ego.heading = yaw + float(rng.normal(0.0, 0.2))
        env.world.route_s_m, env.world.route_lateral_m = env.world.route.project(x, y, s_m)
        env.world.refresh()
        worlds.append(env.world)
    together = ways_of(worlds)
    assert together == [ways_of([world])[0] for world in worlds]
    assert 5 < sum(way.on_road for way in together) < len(worlds) - 5
    assert any(way.straddles for way in together)
    ahead = vehicles_ahead_m(worlds)
    assert ahead == [vehicles_ahead_m([world])[0] for world in worlds]
    assert np.isfinite(ahead).sum() > 5
