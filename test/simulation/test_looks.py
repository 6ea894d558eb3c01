"""How things look and what they hide: scenery, signs, lamps, indicators, and what each split owns."""

import math
from types import SimpleNamespace

import numpy as np
import pytest

from raw2drive_ros.simulation.actor_shapes import actor_shape
from raw2drive_ros.simulation.actors import Look, PathVehicle, StandingObject
from raw2drive_ros.simulation.draws import EVALUATION, TRAINING, VALIDATION
from raw2drive_ros.simulation.environment import DrivingEnv, SimulationConfig
from raw2drive_ros.simulation.looks import BODIES_M, PAINTS, PAINTS_OF, SCENERY_PAINTS, bodies_of, size_m
from raw2drive_ros.simulation.scenery import COLOURS, SIZES_M, SceneryItem
from raw2drive_ros.simulation.signal_shapes import light_shape, sign_shape

SPLITS = (TRAINING, VALIDATION, EVALUATION)
KINDS = tuple(SIZES_M)


@pytest.fixture
def road() -> DrivingEnv:
    """A road with nothing on it and nothing beside it."""
    env = DrivingEnv(SimulationConfig(bev=False))
    env.reset(seed=0)
    env.world.actors.clear()
    env.world.refresh()
    surround(env)
    return env


def surround(env: DrivingEnv, *items: SceneryItem) -> None:
    env.world.scenery = items
    env.prepare_pictures()


def item(env: DrivingEnv, kind: str, ahead_m: float, left_m: float, size_m: tuple[float, float, float]) -> SceneryItem:
    x, y, yaw = env.world.route.pose(env.world.route_s_m + ahead_m, left_m)
    return SceneryItem(kind, x, y, yaw, *size_m, 3, 11)


def pixels_of(env: DrivingEnv, ahead_m: float, left_m: float) -> int:
    """Pixels of a parked car."""
    x, y, yaw = env.world.route.pose(env.world.route_s_m + ahead_m, left_m)
    env.world.actors = [StandingObject(x, y, yaw, 'parked', Look('suv'))]
    env.world.refresh()
    env.renderer.render()
    return int(env.renderer.counts.max())


def changed(env: DrivingEnv, before: np.ndarray) -> np.ndarray:
    return np.abs(env.renderer.render()['front'].astype(int) - before).max(axis=2) > 12


@pytest.mark.parametrize('kind', KINDS)
@pytest.mark.parametrize('ahead_m', [20.0, 60.0])
def test_scenery_is_seen_where_it_stands(road, kind, ahead_m) -> None:
    empty = road.renderer.render()['front'].astype(int)
    sizes = {'pole': (0.25, 0.25, 6.0), 'hill': (20.0, 8.0, 5.0), 'wall': (6.0, 0.4, 2.0), 'hedge': (6.0, 1.0, 1.6)}
    size = sizes.get(kind, (6.0, 5.0, 6.0))
    x, y, yaw = road.world.ego_history[0]
    place = (x + ahead_m * math.cos(yaw), y + ahead_m * math.sin(yaw), yaw)
    surround(road, SceneryItem(kind, *place, *size, 3, 11))
    differs = changed(road, empty)
    assert differs.sum() >= 6
    assert np.nonzero(differs)[1].mean() == pytest.approx(80.0, abs=8.0)
    focal, (_, middle) = road.rig[0].intrinsics[1, 1], road.rig[0].intrinsics[:2, 2]
    # A hill is highest in the middle.
    near = ahead_m - (0.0 if kind == 'hill' else size[0] / 2) - 0.8
    assert np.nonzero(differs)[0].min() == pytest.approx(middle - focal * (size[2] - 1.6) / near, abs=3.5)


@pytest.mark.parametrize('kind', ['house', 'wall', 'hedge', 'hill'])
def test_scenery_hides_what_is_behind_it(road, kind) -> None:
    free = pixels_of(road, 30.0, 9.0)
    # Along the road, its long side towards it.
    size = {'wall': (30.0, 0.4, 2.4), 'hedge': (30.0, 1.0, 2.2), 'hill': (40.0, 6.0, 5.0)}.get(kind, (30.0, 5.0, 6.0))
    surround(road, item(road, kind, 25.0, 5.0 + size[1] / 2 - 1.0, size))
    hidden = pixels_of(road, 30.0, 9.0 + size[1])
    assert free > 60
    assert hidden <= 0.05 * free


def test_what_stands_before_a_long_wall_is_not_hidden_by_it(road) -> None:
    places = [(12.0, 2.0), (25.0, 2.0), (45.0, 1.0)]
    free = [pixels_of(road, *place) for place in places]
    surround(road, item(road, 'wall', 30.0, 4.5, (60.0, 0.4, 2.4)), item(road, 'house', 66.0, 0.0, (8.0, 12.0, 9.0)))
    assert [pixels_of(road, *place) for place in places] == free


def test_a_tree_hides_with_its_trunk_and_crown_and_not_with_its_outline(road) -> None:
    free = pixels_of(road, 30.0, 0.0)
    surround(road, item(road, 'tree', 15.0, 0.0, (4.0, 4.0, 9.0)))
    assert 0.5 * free < pixels_of(road, 30.0, 0.0) < free


def test_windows_are_lit_by_night_and_not_by_day(road) -> None:
    house = item(road, 'house', 22.0, 9.0, (14.0, 9.0, 8.0))
    for weather, expected in (('ClearNight', True), ('ClearNoon', False)):
        road.reset(seed=0, options={'weather': weather})
        road.world.actors.clear()
        road.world.refresh()
        surround(road, house)
        assert bool(road.renderer.scenery.near.paint[:, 3].any()) == expected


def test_a_stop_sign_is_a_red_octagon_and_a_yield_sign_a_white_triangle_with_a_red_rim() -> None:
    for kind, corners_of_rim in (('stop', 8), ('yield', 3)):
        shape = sign_shape(kind)
        front = (shape.normals[:, 0] > 0.9) & (shape.paint[:, 4] > 0)
        assert front.any()
        assert (shape.paint[~front, 4] == 0).all()
        rim = shape.corners_m[front & (np.abs(shape.corners_m[:, 0, 0] - 0.05) < 1e-6)]
        assert len({tuple(np.round(point, 6)) for quad in rim for point in quad}) == corners_of_rim
        red = shape.paint[front][:, 0] - shape.paint[front][:, 1] > 100
        assert red.any()
        assert not red.all()
    with pytest.raises(KeyError):
        sign_shape('merge')


@pytest.mark.parametrize('colour', ['red', 'yellow', 'green'])
def test_one_lens_of_a_light_is_lit(colour) -> None:
    shape = light_shape(colour)
    assert shape.paint[:, 3].sum() == 1
    middle = shape.corners_m[shape.paint[:, 3] > 0][0, :, 2].mean()
    assert middle == pytest.approx({'red': 3.8, 'yellow': 3.4, 'green': 3.0}[colour], abs=0.02)


def test_lamps_and_signs_of_all_approaches_are_drawn_and_the_egos_own_once(road) -> None:
    world = road.world
    x, y, yaw = world.route.pose(world.route_s_m + 15.0, -3.0)
    here, across = (x, y, yaw + math.pi), (x + 3.0, y + 6.0, yaw + math.pi)
    empty = road.renderer.render()['front'].astype(int)
    plain = SimpleNamespace(
        history=world.history,
        ego_history=world.ego_history,
        time_s=0.0,
        road=world.road,
        scenery=(),
        lights=[SimpleNamespace(colour='red', pole_pose=here)],
        stop_signs=[],
        lamps=[],
        signs=[],
    )

    def seen() -> np.ndarray:
        road.renderer.new_world(plain)
        return changed(road, empty)

    own = seen()
    plain.lamps = [SimpleNamespace(colour='red', pole_pose=here)]
    assert np.array_equal(seen(), own)
    plain.lamps.append(SimpleNamespace(colour='yellow', pole_pose=across))
    assert seen().sum() > own.sum() + 10
    assert road.renderer.signal_counts.shape == (1, 6)
    plain.lamps, plain.signs = [], [SimpleNamespace(kind='yield', pole_pose=across)]
    assert seen().sum() > own.sum() + 4


@pytest.mark.parametrize('side', ['left', 'right'])
def test_an_indicator_blinks_amber_on_its_side(road, side) -> None:
    world = road.world
    car = PathVehicle(world.route, world.route_s_m + 9.0, 5.0, 5.0, look=Look('sedan'))
    world.actors, car.number = [car], 0
    world.refresh()
    dark = road.renderer.render()['front'].astype(int)
    car.indicator = side
    lit = []
    for time_s in (0.0, 0.4):
        world.time_s = time_s
        picture = road.renderer.render()['front'].astype(int)
        amber = (picture[..., 0] - dark[..., 0] > 40) & (picture[..., 0] - picture[..., 2] > 80)
        lit.append(amber.sum())
        if time_s == 0.0:
            assert np.nonzero(amber)[1].mean() < 78 if side == 'left' else np.nonzero(amber)[1].mean() > 82
    assert lit[0] >= 4
    assert lit[1] == 0


def test_splits_share_neither_bodies_nor_paints() -> None:
    for kind in ('car', 'parked', 'van', 'parked_van'):
        owned = [set(bodies_of(kind, split)) for split in SPLITS]
        assert all(owned)
        assert sum(map(len, owned)) == len(set().union(*owned))
    assert sorted(index for split in SPLITS for index in PAINTS_OF[split]) == list(range(len(PAINTS)))
    assert len(set(PAINTS)) == len(PAINTS)


@pytest.mark.parametrize('split', SPLITS)
def test_looks_are_drawn_from_what_the_split_owns(split) -> None:
    rng = np.random.default_rng(0)
    for kind in ('car', 'van', 'parked', 'walker', 'cyclist', 'emergency'):
        looks = [Look.draw(kind, rng, split) for _ in range(60)]
        assert {look.body for look in looks} == set(bodies_of(kind, split))
        assert {look.colour for look in looks} <= set(PAINTS_OF[split])


def test_a_world_draws_the_looks_of_its_split() -> None:
    env = DrivingEnv(SimulationConfig(cameras=False, bev=False))
    for seed, split in ((0, EVALUATION), (50_000, VALIDATION), (100_000, TRAINING)):
        env.reset(seed=seed, options={'scenario': 'Accident'})
        assert {actor.colour for actor in env.world.actors} <= set(PAINTS_OF[split])


@pytest.mark.parametrize('body', sorted(BODIES_M))
def test_every_body_has_a_model_of_its_own(body) -> None:
    shape = actor_shape(body, 1, size_m(body), 'day', 0, detailed=True)
    others = [actor_shape(other, 1, size_m(body), 'day', 0, detailed=True) for other in BODIES_M if other != body]
    assert all(not np.array_equal(shape.vectors, other.vectors) for other in others)


def test_scenery_has_a_paint_for_every_colour_that_a_split_may_use() -> None:
    used = {index for colours in COLOURS.values() for index in colours}
    for kind in KINDS:
        paints = SCENERY_PAINTS[kind]
        assert kind == 'pole' or len(set(paints)) == len(paints) == max(used) + 1
