"""The filmstrip of a drive's last seconds."""

import cv2
import numpy as np
import pytest

from raw2drive_ros.contracts.public import Control
from raw2drive_ros.report.filmstrip import CAPTION_PX, EVERY_TICKS, GAP_PX, PICTURES, FilmstripRecorder
from raw2drive_ros.simulation.environment import DrivingEnv, SimulationConfig
from raw2drive_ros.tables.bev_channels import SIZE_PX
from raw2drive_ros.tables.bev_colours import COLOURS


@pytest.fixture(scope='module')
def env() -> DrivingEnv:
    return DrivingEnv(SimulationConfig(cameras=False, bev=False, end_on_infraction=False))


def drive(env: DrivingEnv, filmstrip: FilmstripRecorder, ticks: int, seed: int = 0) -> None:
    tick, _ = env.reset(seed=seed, options={'scenario': 'LaneFollowing'})
    for _ in range(ticks):
        filmstrip.see(env, tick)
        tick, *_ = env.step(Control(0.5))


def test_a_strip_holds_seven_pictures_that_show_the_car_moving(env, tmp_path) -> None:
    filmstrip = FilmstripRecorder()
    drive(env, filmstrip, 80)
    picture = cv2.imread(str(filmstrip.save(tmp_path / 'deep' / 'a.jpg')))
    assert picture.shape == (SIZE_PX + CAPTION_PX, PICTURES * SIZE_PX + (PICTURES - 1) * GAP_PX, 3)
    assert [p.name for p in (tmp_path / 'deep').iterdir()] == ['a.jpg']
    ages = [round((moment.time_s - filmstrip.world.time_s) * 10) for moment in filmstrip.moments]
    assert np.diff(ages).tolist() == [EVERY_TICKS] * (PICTURES - 2)
    speeds = [moment.ego.speed for moment in filmstrip.moments]
    assert speeds == sorted(speeds) and speeds[0] < speeds[-1]


def test_the_ego_is_drawn_in_its_colour_where_the_masks_have_it(env) -> None:
    filmstrip = FilmstripRecorder()
    drive(env, filmstrip, 3)
    tile = filmstrip.draw()[:SIZE_PX, -SIZE_PX:]
    rows, columns = np.nonzero((tile == COLOURS['ego']).all(axis=2))
    assert rows.mean() == pytest.approx(SIZE_PX * 0.7, abs=1.0)
    assert columns.mean() == pytest.approx(SIZE_PX * 0.5, abs=1.0)


def test_a_new_drive_starts_a_new_strip(env) -> None:
    filmstrip = FilmstripRecorder()
    drive(env, filmstrip, 40)
    drive(env, filmstrip, 9, seed=1)
    assert len(filmstrip.moments) == 2
    assert max(moment.time_s for moment in filmstrip.moments) < 1.0


def test_watching_does_not_change_the_drive(env) -> None:
    drive(env, FilmstripRecorder(), 30)
    watched = env.world.ego.position.copy()
    env.reset(seed=0, options={'scenario': 'LaneFollowing'})
    for _ in range(30):
        env.step(Control(0.5))
    assert (env.world.ego.position == watched).all()


def test_a_strip_of_nothing_is_an_error() -> None:
    with pytest.raises(RuntimeError, match='nothing was seen'):
        FilmstripRecorder().draw()
