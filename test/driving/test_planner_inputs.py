"""Calibrations for the planner: converted only when they change, and no decisions once one is unusable."""

import pytest

from msg_adapters.factory import RosbagsFactory
from msg_adapters.sensors import BASE_FRAME, camera_info_to_message, optical_frame, transform_to_message
from raw2drive_ros.contracts import topics
from raw2drive_ros.driving.bundle import load_bundle
from raw2drive_ros.driving.planner_inputs import PlannerInputs
from raw2drive_ros.driving.raw_planner import RawPlanner
from raw2drive_ros.driving.sensor_monitor import MonitorLimits

FACTORY = RosbagsFactory()


@pytest.fixture
def calibrated(bundle):
    """A planner with the calibration of every camera, its inputs, and what they refused."""
    planner, refused = RawPlanner(load_bundle(bundle), MonitorLimits()), []
    inputs = PlannerInputs(planner, on_refused=lambda name, why: refused.append((name, why)))
    for camera in planner.bundle.rig:
        pose = transform_to_message(FACTORY, camera.base_from_camera, BASE_FRAME, optical_frame(camera.name), 0)
        inputs.receive(topics.extrinsics_topic(camera.name), pose, 0)
        inputs.receive(topics.camera_info_topic(camera.name), camera_info_to_message(FACTORY, camera, 0), 0)
    return planner, inputs, refused


def info(planner: RawPlanner, stamp_ns: int = 1):
    return camera_info_to_message(FACTORY, planner.bundle.rig[0], stamp_ns)


def test_the_same_calibration_again_changes_nothing(calibrated) -> None:
    planner, inputs, refused = calibrated
    planner.check_cameras()
    before = dict(planner.calibrations)
    inputs.receive(topics.camera_info_topic('front'), info(planner), 1)
    assert planner.rig_checked
    assert all(planner.calibrations[name] is camera for name, camera in before.items())
    assert refused == []


def test_a_changed_calibration_is_checked_again(calibrated) -> None:
    planner, inputs, _ = calibrated
    planner.check_cameras()
    message = info(planner)
    # A new array: the message shares its memory with the calibration that it was made from.
    message.k = message.k * 1.1
    inputs.receive(topics.camera_info_topic('front'), message, 1)
    assert not planner.rig_checked
    assert planner.calibrations['front'].intrinsics[0, 0] == pytest.approx(message.k[0])


def test_an_unusable_calibration_stops_decisions_until_it_is_mended(calibrated) -> None:
    planner, inputs, refused = calibrated
    planner.check_cameras()
    message = info(planner)
    message.d[0] = 0.1
    inputs.receive(topics.camera_info_topic('front'), message, 1)
    assert 'distortion' in refused[0][1]
    assert 'front' not in planner.calibrations
    assert not planner.rig_checked
    inputs.receive(topics.camera_info_topic('front'), info(planner), 2)
    planner.check_cameras()
    assert planner.rig_checked


def test_calibrations_are_taken_again_after_a_new_start(calibrated) -> None:
    planner, inputs, _ = calibrated
    planner.start(5)
    assert planner.calibrations == {}
    for camera in planner.bundle.rig:
        inputs.receive(topics.camera_info_topic(camera.name), camera_info_to_message(FACTORY, camera, 6), 6)
    planner.check_cameras()
    assert planner.rig_checked
