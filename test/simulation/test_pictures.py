import math

import numpy as np
import pytest

from raw2drive_ros.contracts.public import Control
from raw2drive_ros.simulation.actor_shapes import actor_shape
from raw2drive_ros.simulation.actors import Look, PathVehicle, StandingObject, Walker
from raw2drive_ros.simulation.camera_rig import CAMERA_NAMES, camera_rig
from raw2drive_ros.simulation.environment import DrivingEnv, SimulationConfig
from raw2drive_ros.simulation.looks import BODIES_M, SIZES_M
from raw2drive_ros.tables.bev_channels import CHANNELS, EGO_COLUMN_PX, EGO_ROW_PX, PIXELS_PER_M


@pytest.fixture(scope='module')
def env() -> DrivingEnv:
    env = DrivingEnv(SimulationConfig(end_on_infraction=False))
    env.reset(seed=0, options={'scenario': 'ConstructionObstacle'})
    return env


def test_43_channels_with_the_ego_where_the_table_says(env) -> None:
    bev = env.bev.render()
    assert bev.shape == (43, 128, 128)
    rows, columns = np.nonzero(bev[CHANNELS.index('ego')])
    assert rows.mean() == pytest.approx(EGO_ROW_PX - 0.5, abs=0.6)
    assert columns.mean() == pytest.approx(EGO_COLUMN_PX - 0.5, abs=0.6)
    assert np.ptp(rows) + 1 == pytest.approx(4.8 * PIXELS_PER_M, abs=1.5)


def test_static_map_and_drawn_boxes_agree_on_where_things_are(env) -> None:
    """The route (drawn per frame) lies on the road (warped map), and the lane beside the ego is road too."""
    bev = env.bev.render()
    route, road = bev[CHANNELS.index('route')], bev[CHANNELS.index('road')]
    assert (route & road).sum() > 0.97 * route.sum()


def test_an_obstacle_ahead_and_to_the_right_is_up_and_right_in_the_masks(env) -> None:
    world = env.world
    barrier = next(a for a in world.actors if a.kind == 'barrier')
    ego = world.ego
    ego.position[:] = (barrier.position[0] - 20.0, barrier.position[1] + 6.0)
    ego.heading = 0.0
    world.refresh()
    obstacle = env.bev.render()[CHANNELS.index('obstacle@now')]
    rows, columns = np.nonzero(obstacle)
    nearest = rows.argmin()
    assert rows[nearest] < EGO_ROW_PX - 30
    assert columns.mean() > EGO_COLUMN_PX + 8


def test_front_camera_projects_an_obstacle_where_its_calibration_says(env) -> None:
    world = env.world
    barrier = next(a for a in world.actors if a.kind == 'barrier')
    world.ego.position[:] = (barrier.position[0] - 15.0, barrier.position[1])
    world.ego.heading = 0.0
    world.refresh()
    before = env.renderer.render()['front'].astype(int)
    world.actors.remove(barrier)
    world.refresh()
    after = env.renderer.render()['front'].astype(int)
    changed = np.abs(before - after).max(axis=2) > 40
    rows, columns = np.nonzero(changed)
    assert columns.mean() == pytest.approx(80, abs=4)
    camera = env.rig[0]
    top = camera.intrinsics[1, 2] - camera.intrinsics[1, 1] * (1.1 - 1.6) / (15.0 - 0.8 - 1.5)
    assert rows.min() == pytest.approx(top, abs=2.5)


def test_brake_lamps_light_up() -> None:
    env = DrivingEnv(SimulationConfig(bev=False))
    env.reset(seed=0, options={'scenario': 'HardBreakRoute'})
    leader = env.world.actors[0]
    env.step(Control(0.3))
    leader.command_acceleration = 0.0
    dark = env.renderer.render()['front'].astype(int)
    leader.command_acceleration = -5.0
    lit = env.renderer.render()['front'].astype(int)
    assert (lit[..., 0] - dark[..., 0]).max() > 25


@pytest.fixture
def road() -> DrivingEnv:
    """A road with nothing on it."""
    env = DrivingEnv(SimulationConfig())
    env.reset(seed=0)
    env.world.actors.clear()
    env.world.refresh()
    return env


def put(env: DrivingEnv, ahead_m: float, left_m: float, body: str, turned_rad: float = 0.0) -> StandingObject:
    world = env.world
    x, y, yaw = world.route.pose(world.route_s_m + ahead_m, left_m)
    kind = 'parked' if body in BODIES_M else body
    world.actors = [StandingObject(x, y, yaw + turned_rad, kind, Look(body))]
    world.refresh()
    return world.actors[0]


def pictures(env: DrivingEnv) -> dict[str, np.ndarray]:
    return {name: image.astype(int) for name, image in env.renderer.render().items()}


@pytest.mark.parametrize('turned_rad', [0.0, 0.6, 2.5])
@pytest.mark.parametrize('ahead_m, left_m', [(12.0, 0.0), (20.0, -6.0), (-8.0, 4.0)])
def test_a_turned_car_is_drawn_in_the_masks_where_it_stands_and_as_large(road, ahead_m, left_m, turned_rad) -> None:
    car = put(road, ahead_m, left_m, 'suv', turned_rad)
    ego = road.world.ego
    mask = road.bev.render()[CHANNELS.index('vehicle@now')]
    rows, columns = np.nonzero(mask)
    dx, dy = car.position - ego.position
    cos, sin = math.cos(ego.heading), math.sin(ego.heading)
    assert rows.mean() == pytest.approx(EGO_ROW_PX - 0.5 - PIXELS_PER_M * (dx * cos + dy * sin), abs=0.6)
    assert columns.mean() == pytest.approx(EGO_COLUMN_PX - 0.5 - PIXELS_PER_M * (dy * cos - dx * sin), abs=0.6)
    # OpenCV also fills what the outline only touches.
    area = PIXELS_PER_M**2 * car.LENGTH * car.WIDTH
    assert area * 0.9 < mask.sum() < area + 0.6 * 2 * PIXELS_PER_M * (car.LENGTH + car.WIDTH)
    turned = car.heading - ego.heading
    longest = np.linalg.eigh(np.cov(columns, rows))[1][:, 1]
    assert abs(longest @ (math.sin(turned), math.cos(turned))) > math.cos(math.radians(6.0))


@pytest.mark.parametrize('body', sorted({*BODIES_M, *SIZES_M}))
def test_every_body_is_seen_where_it_stands(road, body) -> None:
    empty = pictures(road)
    put(road, 9.0, 0.0, body)
    changed = {name: np.abs(image - empty[name]).max(axis=2) > 20 for name, image in pictures(road).items()}
    assert changed['front'].sum() >= 15
    assert np.nonzero(changed['front'])[1].mean() == pytest.approx(80.0, abs=6.0)
    assert changed['back'].sum() == 0


def test_bodies_of_a_kind_look_different(road) -> None:
    seen = []
    for body in BODIES_M:
        put(road, 9.0, 0.0, body)
        seen.append(pictures(road)['front'])
    for i, one in enumerate(seen):
        for other in seen[:i]:
            assert (np.abs(one - other).max(axis=2) > 20).sum() > 40
    shapes = [actor_shape(body, 0, (4.5, 1.9, 1.6), 'day', 0, detailed=True) for body in BODIES_M]
    assert len({shape.corners_m.tobytes() for shape in shapes}) == len(BODIES_M)


@pytest.mark.parametrize('body', sorted({*BODIES_M, *SIZES_M}))
@pytest.mark.parametrize('lamps', ['off', 'day', 'night', 'brake'])
def test_shapes_are_as_large_as_the_actor_and_stand_on_the_ground(body, lamps) -> None:
    size = BODIES_M.get(body) or SIZES_M[body]
    shape = actor_shape(body, 3, size, lamps, 0, detailed=True)
    extent = np.ptp(shape.corners_m.reshape(-1, 3), axis=0)
    assert extent[0] <= size[0] + 0.15
    assert extent[1] <= size[1] + 0.15
    assert shape.corners_m[..., 2].min() >= 0.0
    assert shape.corners_m[..., 2].max() == pytest.approx(size[2], abs=0.26)
    assert np.hypot(shape.corners_m[..., 0], shape.corners_m[..., 1]).max() == pytest.approx(shape.radius_m)


def test_a_car_beside_a_camera_fills_it_instead_of_vanishing(road) -> None:
    """Its quads reach behind the image plane and have to be cut there."""
    empty = pictures(road)
    put(road, 0.5, 2.6, 'suv')
    changed = np.abs(pictures(road)['front_left'] - empty['front_left']).max(axis=2) > 20
    assert changed[60:].mean() > 0.3


def test_far_cars_lose_details_and_not_their_outline(road) -> None:
    empty = pictures(road)['front']
    put(road, 33.0, 0.0, 'suv')
    near = pictures(road)['front']
    road.renderer.detail_m = 10.0
    far = pictures(road)['front']
    outlines = [np.abs(picture - empty).max(axis=2) > 20 for picture in (near, far)]
    assert np.abs(near - far).max() > 0
    assert (outlines[0] ^ outlines[1]).sum() < 0.3 * outlines[0].sum()


def test_legs_swing_and_lights_flash(road) -> None:
    world = road.world
    walker = Walker(world.route, world.route_s_m + 8.0, -1.0, 3.0, 1.0, 0.0)
    walker.speed = 1.0
    van = PathVehicle(world.route, world.route_s_m + 12.0, 5.0, 5.0, 'emergency', lateral_m=3.5)
    for actor in (walker, van):
        world.actors = [actor]
        world.refresh()
        world.time_s = 0.0
        first = pictures(road)['front']
        world.time_s = 0.25
        assert (np.abs(pictures(road)['front'] - first).max(axis=2) > 20).sum() >= 4


def test_rig_has_six_cameras_looking_where_their_names_say() -> None:
    rig = {c.name: c for c in camera_rig()}
    assert tuple(rig) == CAMERA_NAMES
    forward = {name: c.base_from_camera[:3, 2] for name, c in rig.items()}
    assert forward['front'] == pytest.approx((1, 0, 0), abs=1e-9)
    assert forward['back'] == pytest.approx((-1, 0, 0), abs=1e-9)
    assert forward['front_left'][1] > 0.5 > -0.5 > forward['front_right'][1]
    assert forward['back_left'][0] < 0 < forward['back_left'][1]


@pytest.mark.parametrize('size', [(96, 160), (224, 400)])
def test_both_image_sizes_render(size) -> None:
    env = DrivingEnv(SimulationConfig(size, bev=False))
    tick, _ = env.reset(seed=3)
    for image in tick.sensors.images.values():
        assert image.shape == (*size, 3)
        assert image.std() > 10
