"""Pictures against the motion of the car: what can be told of a camera, how finely, and when nothing can."""

import math

import cv2
import numpy as np
import pytest

from raw2drive_ros.conformance.colours import judge_colours
from raw2drive_ros.conformance.image_motion import explain, fits, judge_pictures, shrunk
from raw2drive_ros.conformance.observation import Observation
from raw2drive_ros.conformance.views import Move, ground_plane, other_lens, predicted_flow, project
from raw2drive_ros.contracts.public import CameraCalibration, OdometrySample
from raw2drive_ros.simulation.camera_rig import camera_rig

RIG = {camera.name: camera for camera in camera_rig(96, 160)}
GROUND = cv2.resize(
    np.random.default_rng(1).integers(0, 255, (300, 300), np.uint8), (1200, 1200), interpolation=cv2.INTER_CUBIC
)
PIXELS_PER_M = 20.0


def look(camera: CameraCalibration, pose: tuple[float, float, float]) -> np.ndarray:
    """Grey picture of a mottled ground, uniform sky above it."""
    x, y, yaw = pose
    base_from_map = Move(x, y, yaw).matrix
    map_from_texture = np.array([[1 / PIXELS_PER_M, 0.0, -20.0], [0.0, 1 / PIXELS_PER_M, -30.0], [0.0, 0.0, 1.0]])
    pixel_from_texture = ground_plane(camera) @ base_from_map @ map_from_texture
    image = cv2.warpPerspective(GROUND, pixel_from_texture, (camera.width, camera.height), flags=cv2.INTER_AREA)
    image[: camera.height // 2 + 1] = 200
    return image


def drive(picture=look, cameras=RIG) -> Observation:
    """Two seconds ahead and two in a bend to the left, at 3 m/s; picture: what each camera sends."""
    seen = Observation(4.0)
    x = y = yaw = 0.0
    for i in range(41):
        seen.odometry.append(OdometrySample(i * 100_000_000, x, y, yaw, 3.0, 0.0))
        for name, camera in cameras.items():
            seen.pictures.setdefault(name, []).append((i * 100_000_000, shrunk(picture(camera, (x, y, yaw)))))
        yaw += 0.03 if i > 20 else 0.0
        x, y = x + 0.3 * math.cos(yaw), y + 0.3 * math.sin(yaw)
    seen.calibrations = dict(cameras)
    return seen


@pytest.mark.parametrize('name', list(RIG))
def test_a_point_of_the_ground_moves_as_predicted(name) -> None:
    camera, move = RIG[name], Move(0.7, -0.2, 0.1)
    pixels = np.array([[40.0, 70.0], [80.0, 90.0], [120.0, 60.0]])
    ground = np.linalg.inv(ground_plane(camera)) @ np.vstack([pixels.T, np.ones(3)])
    before = np.column_stack([(ground[:2] / ground[2]).T, np.zeros(3), np.ones(3)])
    after = before.copy()
    after[:, :2] = (move.matrix @ before[:, [0, 1, 3]].T).T[:, :2]
    assert project(camera, before) == pytest.approx(pixels)
    assert predicted_flow(camera, pixels, move) == pytest.approx(project(camera, after) - pixels)


def test_what_is_far_or_above_the_horizon_only_turns() -> None:
    camera = RIG['front']
    sky = np.array([[80.0, 20.0]])
    assert predicted_flow(camera, sky, Move(5.0, 0.0, 0.0)) == pytest.approx(np.zeros((1, 2)))
    # Turning left moves the world to the right.
    assert predicted_flow(camera, sky, Move(0.0, 0.0, 0.05))[0, 0] > 3.0


def test_right_pictures_are_recognised_and_each_assumption_about_wrong_ones() -> None:
    right = fits(drive(), RIG)
    assert {name: explain(found).kind for name, found in right.items()} == dict.fromkeys(RIG, 'declared')
    wrong = {
        'upside down': lambda camera, pose: look(camera, pose)[::-1, ::-1],
        'mirrored': lambda camera, pose: look(camera, pose)[:, ::-1],
        'still': lambda camera, pose: look(camera, (0.0, 0.0, 0.0)),
    }
    for kind, picture in wrong.items():
        found = fits(drive(picture), RIG)
        assert {name: explain(of).kind for name, of in found.items()} == dict.fromkeys(RIG, kind), kind


@pytest.mark.parametrize('factor', [0.6, 0.8, 1.25, 1.6])
@pytest.mark.parametrize('name', list(RIG))
def test_another_lens_is_told_with_its_focal_length(name, factor) -> None:
    only = {name: RIG[name]}
    found = explain(fits(drive(lambda camera, pose: look(other_lens(camera, factor), pose), only), only)[name])
    assert found.kind == 'lens'
    assert found.factor == pytest.approx(factor, rel=0.08)


def test_the_size_of_the_pictures_does_not_matter() -> None:
    large = {camera.name: camera for camera in camera_rig(224, 400)[:2]}
    seen = drive(cameras=large)
    assert seen.pictures['front'][0][1].shape == (90, 160)
    assert {v.severity for v in judge_pictures(seen, set())} == {'passed'}


def test_all_that_cannot_be_told_is_said_so() -> None:
    rng = np.random.default_rng(0)
    noise = drive(lambda camera, pose: rng.integers(0, 255, (96, 160), np.uint8))
    blank = drive(lambda camera, pose: np.full((96, 160), 90, np.uint8))
    for seen in (noise, blank, Observation(1.0, calibrations=dict(RIG))):
        verdicts = list(judge_pictures(seen, set()))
        assert len(verdicts) == 6
        assert {v.severity for v in verdicts} == {'skipped'}
        assert all('cannot tell' in v.text for v in verdicts)


def test_a_camera_that_sends_the_picture_of_another_is_told_and_an_exchange_once() -> None:
    def from_front(camera: CameraCalibration, pose: tuple[float, float, float]) -> np.ndarray:
        return look(RIG['front'] if camera.name == 'back' else camera, pose)

    def exchanged(camera: CameraCalibration, pose: tuple[float, float, float]) -> np.ndarray:
        other = {'back_left': 'back_right', 'back_right': 'back_left'}.get(camera.name, camera.name)
        return look(RIG[other], pose)

    wrong = [v for v in judge_pictures(drive(from_front), set()) if v.severity == 'error']
    assert [(v.check, v.remedy) for v in wrong] == [
        ('camera back: motion of the picture', 'it sends the pictures of camera front')
    ]
    wrong = [v for v in judge_pictures(drive(exchanged), set()) if v.severity == 'error']
    assert [v.check for v in wrong] == ['cameras back_left and back_right: exchanged']


def test_a_camera_with_a_wrong_calibration_is_not_reported_twice() -> None:
    seen = drive()
    seen.calibrations['front'] = other_lens(RIG['front'], 1.4)
    found = {v.check: v for v in judge_pictures(seen, {'front'})}['camera front: motion of the picture']
    assert (found.severity, found.remedy) == ('skipped', 'mend its calibration first')
    assert '0.71 times that of K' in found.text


def coloured(sky: tuple[int, int, int], ground: tuple[int, int, int]) -> Observation:
    seen = Observation(1.0, calibrations={'front': RIG['front']})
    image = np.full((96, 160, 3), ground, np.uint8)
    image[:48] = sky
    seen.images['front'] = image
    return seen


@pytest.mark.parametrize(
    ('sky', 'ground', 'severity'),
    [
        ((150, 190, 230), (70, 110, 60), 'passed'),
        ((230, 190, 150), (60, 110, 70), 'error'),
        ((150, 190, 230), (90, 90, 95), 'passed'),
        # A red sky without plants, above plants in its own light, a grey sky, the night.
        ((230, 190, 150), (90, 90, 90), 'skipped'),
        ((235, 160, 105), (90, 110, 60), 'skipped'),
        ((160, 160, 162), (70, 110, 60), 'skipped'),
        ((8, 10, 12), (12, 14, 10), 'skipped'),
    ],
)
def test_red_and_blue_are_judged_only_where_sky_and_plants_agree(sky, ground, severity) -> None:
    (verdict,) = judge_colours(coloured(sky, ground), ['front'])
    assert verdict.severity == severity
    assert list(judge_colours(coloured(sky, ground), [])) == []
