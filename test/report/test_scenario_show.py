"""Pictures and videos of one drive, and the verb `scenario show` that makes them."""

import av
import cv2
import numpy as np
import pytest

from raw2drive_ros.cli.main import main
from raw2drive_ros.report import video as video_module
from raw2drive_ros.report.overview import LIGHTS, Overview, colour_of
from raw2drive_ros.report.scene import FILM, OUTCOME_FRAMES, WIDTH
from raw2drive_ros.report.video import HEIGHT, write_video
from raw2drive_ros.report.video import WIDTH as VIDEO_WIDTH
from raw2drive_ros.simulation.draws import Draw
from raw2drive_ros.simulation.scenario import get_scenario, load_scenarios
from raw2drive_ros.simulation.world import World
from raw2drive_ros.tables.bev_colours import COLOURS


def world_of(name: str, seed: int = 0) -> World:
    return World(get_scenario(name), Draw(name, seed))


def pixels_of(picture, colour) -> tuple[np.ndarray, np.ndarray]:
    return np.nonzero((picture == colour).all(axis=2))


def frames_of(path) -> list:
    with av.open(str(path)) as container:
        return list(container.decode(video=0))


@pytest.mark.parametrize('name', ['LaneFollowing', 'SignalizedJunctionLeftTurn', 'HighwayExit'])
def test_the_route_runs_from_left_to_right(name) -> None:
    world = world_of(name)
    view = Overview(world, 800)
    start, goal = (view.pixels(np.array([world.route.pose(s)[:2]]))[0] for s in (world.route_s_m, world.goal_s_m))
    assert goal[0] > start[0]
    assert abs(goal[1] - start[1]) <= 16, 'up to rounding, in sixteenths of a pixel'
    picture = view.draw()
    assert picture.shape[1] == 800
    rows, columns = pixels_of(picture[: view.height], COLOURS['ego'])
    assert (columns.mean(), rows.mean()) == pytest.approx(start / 16, abs=12)


def test_actors_and_lights_are_where_the_world_has_them() -> None:
    world = world_of('SignalizedJunctionLeftTurn')
    view = Overview(world, 800)
    picture = view.draw()[: view.height]
    for light in world.lights:
        x, y = view.pixels(np.array([light.pole_pose[:2]]))[0] // 16
        assert tuple(picture[y, x]) == LIGHTS[light.colour]
    world = world_of('ConstructionObstacle')
    view = Overview(world, 800)
    assert len(pixels_of(view.draw()[: view.height], colour_of('barrier'))[0]) > 20


def test_every_scenario_type_can_be_drawn() -> None:
    for name in load_scenarios():
        picture = Overview(world_of(name), 600).draw([(0.0, 0.0), (5.0, 0.0)])
        assert picture.shape[1] == 600 and picture.std() > 10, name


def test_show_writes_a_picture_and_a_film_of_the_same_drive(tmp_path, capsys) -> None:
    picture, film = tmp_path / 'new' / 'a.png', tmp_path / 'a.mp4'
    arguments = ['--seed', '2', '--weather', 'CloudyNoon', '--repetition', '1', '--seconds', '1', '--size', '64x96']
    assert main(['scenario', 'show', 'T_Junction', *arguments, '--picture', str(picture), '--video', str(film)]) == 0
    output = capsys.readouterr().out
    assert str(picture) in output and 'driving score' in output
    drawn = cv2.imread(str(picture))
    assert drawn.shape[1] == WIDTH and drawn.std() > 20
    frames = frames_of(film)
    assert (frames[0].width, frames[0].height) == FILM
    assert len(frames) == 10 + OUTCOME_FRAMES


def test_sim_picture_is_the_same_picture(tmp_path) -> None:
    one, two = tmp_path / 'one.png', tmp_path / 'two.png'
    assert main(['sim', '--scenario', 'LaneFollowing', '--seed', '3', '--size', '64x96', '--picture', str(one)]) == 0
    show = ['scenario', 'show', 'LaneFollowing', '--seed', '3', '--size', '64x96', '--picture', str(two)]
    assert main(show) == 0
    assert one.read_bytes() == two.read_bytes()


def test_list_names_every_type(capsys) -> None:
    assert main(['scenario', 'list']) == 0
    listed = [line.split()[0] for line in capsys.readouterr().out.splitlines()]
    assert listed == list(load_scenarios())


@pytest.mark.parametrize(
    ('arguments', 'code', 'message'),
    [
        (['show'], 2, 'needs a TYPE'),
        (['show', 'Nope'], 2, 'unknown scenario'),
        (['show', 'Accident', '--weather', 'Hail'], 2, 'unknown weather'),
        (['show', 'Accident', '--size', '1x1'], 2, 'use one of'),
        (['show', 'Accident', '--seed', '-1'], 2, '0 or more'),
        (['show', 'Accident', '--video', 'a.avi'], 2, 'ends in .mp4'),
        (['show', 'Accident', '--driver', 'nobody'], 2, 'unknown driver'),
    ],
)
def test_bad_input_is_one_line_and_an_exit_code(arguments, code, message, capsys) -> None:
    assert main(['scenario', *arguments]) == code
    error = capsys.readouterr().err.strip()
    assert message in error and len(error.splitlines()) == 1


def test_the_demo_video_shows_every_tick_of_a_bag_and_its_speed(bag, bundle, tmp_path, monkeypatch) -> None:
    words: list[str] = []
    draw = video_module.text

    def noting(canvas, said, *more, **how) -> None:
        words.append(said)
        draw(canvas, said, *more, **how)

    monkeypatch.setattr(video_module, 'text', noting)
    video = write_video(bag, bundle, tmp_path / 'drive.mp4')
    frames = frames_of(video.path)
    assert (frames[0].width, frames[0].height) == (VIDEO_WIDTH, HEIGHT)
    assert len(frames) == 120
    # Twelve seconds of driving are six of the film.
    assert words.count('speed x2') == 120
    assert all(still.shape == (HEIGHT, VIDEO_WIDTH, 3) for still in video.stills.values())
