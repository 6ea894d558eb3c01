"""Conversion between CARLA's axes and ours, checked with the types of CARLA's own client."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from raw2drive_ros.carla_vehicle import geometry
from raw2drive_ros.contracts.errors import ContractError
from raw2drive_ros.contracts.public import Control
from raw2drive_ros.simulation.camera_rig import camera_rig

carla = pytest.importorskip('carla', reason='extra carla')
angles = st.floats(-179.0, 179.0)
metres = st.floats(-100.0, 100.0)


def matrix_of(place, turn) -> np.ndarray:
    """(4, 4) pose as CARLA's client computes it."""
    return np.array(carla.Transform(carla.Location(*place), carla.Rotation(*turn)).get_matrix())


def test_right_of_the_car_in_carla_is_negative_y_here() -> None:
    pose = geometry.pose_from_carla(matrix_of((10.0, 2.0, 0.5), (0.0, 90.0, 0.0)))
    assert pose[:3, 3] == pytest.approx((10.0, -2.0, 0.5))
    # Yaw 90 in CARLA looks along its y, which is -y here.
    assert pose[:3, 0] == pytest.approx((0.0, -1.0, 0.0), abs=1e-6)
    nose_up = geometry.pose_from_carla(matrix_of((0.0, 0.0, 0.0), (10.0, 0.0, 0.0)))
    assert nose_up[2, 0] == pytest.approx(math.sin(math.radians(10.0)))


@given(x=metres, y=metres, z=metres, pitch=st.floats(-85.0, 85.0), yaw=angles, roll=angles)
def test_a_pose_survives_the_way_to_carla_and_back(x, y, z, pitch, yaw, roll) -> None:
    pose = geometry.pose_from_carla(matrix_of((x, y, z), (pitch, yaw, roll)))
    assert np.linalg.det(pose[:3, :3]) == pytest.approx(1.0, abs=1e-4)
    assert geometry.pose_from_carla(matrix_of(*geometry.placement(pose))) == pytest.approx(pose, abs=1e-4)


def test_cameras_stand_where_the_rig_says() -> None:
    for camera in camera_rig(96, 160):
        place, turn = geometry.camera_placement(camera.base_from_camera)
        body = geometry.pose_from_carla(matrix_of(place, turn))
        assert body[:3, 3] == pytest.approx(camera.base_from_camera[:3, 3], abs=1e-6)
        # CARLA's camera looks along x and has z up; the optical frame along z, with y down.
        assert body[:3, 0] == pytest.approx(camera.base_from_camera[:3, 2], abs=1e-6)
        assert body[:3, 2] == pytest.approx(-camera.base_from_camera[:3, 1], abs=1e-6)
        assert geometry.fov_deg(camera.intrinsics, 160, 96) == pytest.approx(110.0 if camera.name == 'back' else 70.0)
    assert geometry.camera_placement(camera_rig()[1].base_from_camera)[1] == pytest.approx((0.0, -55.0, 0.0), abs=1e-6)


@pytest.mark.parametrize('change', [(0, 2, 20.0), (1, 1, 5.0)])
def test_cameras_that_carla_cannot_model_are_refused(change) -> None:
    row, column, by = change
    intrinsics = camera_rig(96, 160)[0].intrinsics.copy()
    intrinsics[row, column] += by
    with pytest.raises(ContractError, match='square pixels'):
        geometry.fov_deg(intrinsics, 160, 96)


def test_images_lose_alpha_and_become_rgb() -> None:
    bgra = np.zeros((2, 3, 4), np.uint8)
    bgra[0, 0] = (1, 2, 3, 255)
    image = geometry.image_from_carla(bgra.tobytes(), 3, 2)
    assert image.shape == (2, 3, 3)
    assert image[0, 0].tolist() == [3, 2, 1]
    with pytest.raises(ContractError, match='is not 4 x 2 BGRA'):
        geometry.image_from_carla(bgra.tobytes(), 4, 2)


def test_imu() -> None:
    sample = geometry.imu_from_carla(5, carla.Vector3D(1.0, 2.0, 9.81), carla.Vector3D(0.1, 0.2, 0.3))
    assert sample.specific_force_mps2 == pytest.approx((1.0, -2.0, 9.81))
    assert sample.angular_velocity_radps == pytest.approx((-0.1, 0.2, -0.3))


@given(yaw=angles, speed=st.floats(-20.0, 30.0))
def test_odometry_drives_where_it_looks_and_turns_left_positive(yaw, speed) -> None:
    matrix = matrix_of((1.0, 2.0, 0.0), (0.0, yaw, 0.0))
    velocity = carla.Vector3D(*(float(v) for v in speed * matrix[:3, 0]))
    sample = geometry.odometry_from_carla(7, matrix, velocity, carla.Vector3D(0.0, 0.0, -90.0))
    assert (sample.x_m, sample.y_m) == pytest.approx((1.0, -2.0))
    assert sample.speed_mps == pytest.approx(speed, abs=1e-4)
    assert sample.yaw_rate_radps == pytest.approx(math.pi / 2)
    assert math.remainder(sample.yaw_rad + math.radians(yaw), math.tau) == pytest.approx(0.0, abs=1e-5)


@given(throttle=st.floats(0.0, 1.0), brake=st.floats(0.0, 1.0), steer=st.floats(-1.0, 1.0), reverse=st.booleans())
def test_controls_are_what_the_client_takes(throttle, brake, steer, reverse) -> None:
    control = carla.VehicleControl(**geometry.control_values(Control(throttle, brake, steer, reverse)))
    assert (control.throttle, control.brake, control.steer) == pytest.approx((throttle, brake, -steer))
    assert (control.reverse, control.hand_brake, control.manual_gear_shift) == (reverse, False, False)
    with pytest.raises(ContractError):
        geometry.control_values(Control(math.nan))
