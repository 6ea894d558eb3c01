"""Lenses with distortion: what the planner sees is what a pinhole camera of the bundle would have taken."""

import cv2
import numpy as np
import pytest

from msg_adapters.factory import RosbagsFactory
from msg_adapters.lens import Lens, lens_from_message
from msg_adapters.sensors import (
    BASE_FRAME,
    camera_info_to_message,
    fill_image,
    new_image,
    optical_frame,
    transform_to_message,
)
from raw2drive_ros.contracts import topics
from raw2drive_ros.contracts.errors import ContractError
from raw2drive_ros.contracts.public import CameraCalibration
from raw2drive_ros.driving.bundle import load_bundle
from raw2drive_ros.driving.planner_inputs import PlannerInputs
from raw2drive_ros.driving.raw_planner import RawPlanner
from raw2drive_ros.driving.rectification import Rectifier
from raw2drive_ros.driving.sensor_monitor import MonitorLimits

FACTORY = RosbagsFactory()
WANTED = CameraCalibration('front', 160, 96, np.array([[110.0, 0, 79.5], [0, 110.0, 47.5], [0, 0, 1]]), np.eye(4))
LENSES = {
    'plumb_bob': [-0.25, 0.06, 0.001, -0.002, 0.0],
    'rational_polynomial': [0.2, -0.05, 0.001, -0.001, 0.01, 0.4, -0.02, 0.01],
    'equidistant': [0.02, -0.01, 0.003, -0.001],
}


def lens(model: str, scale: float = 1.0, coefficients=None, focal: float = 100.0) -> Lens:
    width, height = round(176 * scale), round(112 * scale)
    intrinsics = np.array([[focal * scale, 0, width / 2 - 0.5], [0, focal * scale, height / 2 - 0.5], [0, 0, 1.0]])
    return Lens('front', model, width, height, intrinsics, np.array(coefficients or LENSES[model]))


def scene(directions: np.ndarray) -> np.ndarray:
    """(N, 2) directions x/z, y/z -> (N, 3) grey levels: smooth, and different everywhere."""
    x, y = directions.T
    return np.stack([128 + 90 * np.sin(4 * x + y), 128 + 90 * np.cos(5 * y - x), 128 + 90 * np.sin(3 * (x + y))], 1)


def taken_by(camera: Lens) -> np.ndarray:
    """(H, W, 3) the scene as the lens takes it: OpenCV's inverse model, pixel by pixel."""
    pixels = (
        np.stack(np.meshgrid(np.arange(camera.width), np.arange(camera.height)), -1).reshape(-1, 1, 2).astype(float)
    )
    undistort = cv2.fisheye.undistortPoints if camera.model == 'equidistant' else cv2.undistortPoints
    directions = undistort(pixels, camera.intrinsics, camera.coefficients).reshape(-1, 2)
    return np.clip(np.round(scene(directions)), 0, 255).astype(np.uint8).reshape(camera.height, camera.width, 3)


def taken_by_pinhole(camera: CameraCalibration) -> np.ndarray:
    pixels = np.stack(np.meshgrid(np.arange(camera.width), np.arange(camera.height)), -1).reshape(-1, 2)
    k = camera.intrinsics
    levels = scene((pixels - k[:2, 2]) / (k[0, 0], k[1, 1]))
    return levels.reshape(camera.height, camera.width, 3)


@pytest.mark.parametrize('scale', [1.0, 2.0, 5.0])
@pytest.mark.parametrize('model', LENSES)
def test_a_rectified_picture_is_that_of_the_pinhole_camera(model, scale) -> None:
    raw = taken_by(lens(model, scale))
    rectified = Rectifier(lens(model, scale), WANTED)(raw)
    assert rectified.shape == (96, 160, 3)
    difference = np.abs(rectified - taken_by_pinhole(WANTED))
    assert difference.mean() < 0.6
    assert np.percentile(difference, 99) < 3.0
    # Without rectification it is another picture.
    plain = cv2.resize(raw, (160, 96), interpolation=cv2.INTER_AREA)
    assert np.abs(plain - taken_by_pinhole(WANTED)).mean() > 5.0


def test_fine_texture_of_a_larger_picture_is_averaged() -> None:
    """A chequerboard of single pixels becomes grey, and not a pattern that is not there."""
    large = lens('plumb_bob', 6.0)
    board = np.indices((large.height, large.width)).sum(0) % 2 * 255
    rectified = Rectifier(large, WANTED)(np.repeat(board[..., None], 3, 2).astype(np.uint8))
    assert rectified.min() > 90
    assert rectified.max() < 165


def test_views_with_negative_strides_are_taken() -> None:
    raw = taken_by(lens('plumb_bob'))
    rectify = Rectifier(lens('plumb_bob'), WANTED)
    assert np.array_equal(rectify(raw[..., ::-1]), rectify(raw)[..., ::-1])


@pytest.mark.parametrize(
    ('found', 'reason'),
    [
        (lens('plumb_bob', focal=160.0), '% of what the bundle sees lies outside'),
        (lens('plumb_bob', coefficients=[-2.0, 0.0, 0.0, 0.0, 0.0]), 'inside out'),
        (lens('plumb_bob', 0.3), 'use a higher resolution'),
    ],
    ids=['crop', 'fold', 'coarse'],
)
def test_a_lens_that_does_not_show_what_the_bundle_needs_is_refused_in_one_line(found, reason) -> None:
    with pytest.raises(ContractError, match=reason) as caught:
        Rectifier(found, WANTED)
    assert '\n' not in str(caught.value)
    assert 'camera front' in str(caught.value)


def info_of(camera: Lens, stamp_ns: int = 0):
    message = camera_info_to_message(FACTORY, WANTED, stamp_ns)
    message.header.frame_id = optical_frame(camera.camera)
    message.width, message.height = camera.width, camera.height
    message.distortion_model, message.d = camera.model, np.array(camera.coefficients)
    message.k = camera.intrinsics.reshape(9).copy()
    return message


@pytest.mark.parametrize('model', LENSES)
def test_a_lens_is_read_from_its_message(model) -> None:
    found = lens_from_message('front', info_of(lens(model)))
    assert Rectifier(lens(model), WANTED).fits(found)
    assert lens_from_message('front', camera_info_to_message(FACTORY, WANTED, 0)) is None


@pytest.mark.parametrize(
    ('change', 'reason'),
    [
        ({'distortion_model': 'fov'}, "distortion model 'fov' is not known"),
        ({'d': np.array([0.1, 0.1])}, '2 coefficients in D'),
        ({'d': np.array([np.nan, 0, 0, 0, 0])}, 'not finite'),
        ({'k': np.zeros(9)}, 'uncalibrated'),
        ({'width': 0}, 'uncalibrated'),
        ({'binning_x': 2}, 'binning'),
    ],
)
def test_a_camera_info_that_cannot_be_used_is_refused(change, reason) -> None:
    message = info_of(lens('plumb_bob'))
    for name, value in change.items():
        setattr(message, name, value)
    with pytest.raises(ContractError, match=reason):
        lens_from_message('front', message)


@pytest.fixture
def rig(bundle):
    """A planner whose front camera has a lens, its inputs, and what was said."""
    planner, said = RawPlanner(load_bundle(bundle), MonitorLimits()), []
    inputs = PlannerInputs(planner, on_refused=lambda name, why: said.append(why), on_notice=said.append)
    for camera in planner.bundle.rig:
        pose = transform_to_message(FACTORY, camera.base_from_camera, BASE_FRAME, optical_frame(camera.name), 0)
        inputs.receive(topics.extrinsics_topic(camera.name), pose, 0)
        if camera.name != 'front':
            inputs.receive(topics.camera_info_topic(camera.name), camera_info_to_message(FACTORY, camera, 0), 0)
    return planner, inputs, said


def wide_lens(wanted: CameraCalibration, k1: float = -0.05) -> Lens:
    """A lens that shows more than the wanted camera, with twice its resolution."""
    size = 2.4 * np.array([wanted.width, wanted.height])
    intrinsics = wanted.intrinsics.copy()
    intrinsics[:2, :2] *= 2.0
    intrinsics[:2, 2] = size / 2 - 0.5
    return Lens('front', 'plumb_bob', round(size[0]), round(size[1]), intrinsics, np.array([k1, 0.0, 0.0, 0.0, 0.0]))


def send(inputs: PlannerInputs, camera: Lens, picture: np.ndarray, stamp_ns: int) -> None:
    message = new_image(FACTORY, camera.camera, camera.height, camera.width)
    fill_image(message, picture, stamp_ns)
    inputs.receive(topics.image_topic(camera.camera), message, stamp_ns)


def test_the_planner_sees_the_rectified_picture_and_says_so_once(rig) -> None:
    planner, inputs, said = rig
    wanted = planner.bundle.rig[0]
    camera = wide_lens(wanted)
    for stamp in (0, 1, 2):
        inputs.receive(topics.camera_info_topic('front'), info_of(camera, stamp), stamp)
    assert len(said) == 1
    assert 'lens distortion' in said[0]
    planner.check_cameras()
    send(inputs, camera, taken_by(camera), 3)
    seen = planner.assembler.images[3]['front']
    assert np.array_equal(seen, Rectifier(camera, wanted)(taken_by(camera)))
    assert np.abs(seen - taken_by_pinhole(wanted)).mean() < 1.0


def test_a_picture_of_another_size_than_its_camera_info_is_refused(rig) -> None:
    planner, inputs, said = rig
    camera = wide_lens(planner.bundle.rig[0])
    inputs.receive(topics.camera_info_topic('front'), info_of(camera), 0)
    send(inputs, lens('plumb_bob'), taken_by(lens('plumb_bob')), 1)
    assert 'its camera_info says' in said[-1]
    assert planner.assembler.images == {}


def test_pictures_from_before_a_change_of_the_lens_are_not_used(rig) -> None:
    planner, inputs, said = rig
    wanted = planner.bundle.rig[0]
    camera = wide_lens(wanted)
    inputs.receive(topics.camera_info_topic('front'), info_of(camera), 0)
    send(inputs, camera, taken_by(camera), 1)
    inputs.receive(topics.camera_info_topic('front'), info_of(wide_lens(wanted, -0.04)), 2)
    assert planner.assembler.images == {}
    assert not planner.rig_checked
    inputs.receive(topics.camera_info_topic('front'), camera_info_to_message(FACTORY, wanted, 3), 3)
    assert inputs.rectifiers == {}
    planner.check_cameras()
    assert len(said) == 2


def test_the_maps_are_made_once_for_a_lens(rig) -> None:
    planner, inputs, said = rig
    camera = wide_lens(planner.bundle.rig[0])
    inputs.receive(topics.camera_info_topic('front'), info_of(camera), 0)
    first = inputs.rectifiers['front']
    planner.start(5)
    inputs.receive(topics.camera_info_topic('front'), info_of(camera, 6), 6)
    assert inputs.rectifiers['front'] is first
    assert len(said) == 1
    assert 'front' in planner.calibrations
