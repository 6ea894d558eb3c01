import numpy as np
import pytest

from raw2drive_ros.bev_channels import CHANNELS, EGO_COLUMN_PX, EGO_ROW_PX, PIXELS_PER_M
from raw2drive_ros.contract import Control
from raw2drive_ros.simulation.camera_rig import CAMERA_NAMES, camera_rig
from raw2drive_ros.simulation.environment import DrivingEnv, SimulationConfig


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
    world._refresh()
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
    world._refresh()
    before = env.renderer.render()['front'].astype(int)
    world.actors.remove(barrier)
    world._refresh()
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
