import numpy as np
import pytest

from raw2drive_ros.contracts.public import ImuSample, OdometrySample, Route
from raw2drive_ros.driving.preprocessing import RouteProgress, raw_vector
from raw2drive_ros.tables.vector_layout import VECTOR_FIELDS, VECTOR_SIZE

IMU = ImuSample(0, (0.5, -0.25, 9.81), (0, 0, 0.1))
ROUTE = Route(1, np.array([[0.0, 0.0], [25.0, 0.0], [50.0, 10.0]]))


def at(x: float, y: float, yaw: float) -> OdometrySample:
    return OdometrySample(0, x, y, yaw, 6.0, 0.1)


def test_checkpoints_are_in_base_link_left_positive() -> None:
    progress = RouteProgress()
    progress.update(ROUTE, at(5.0, 0.0, 0.0))
    vector = dict(zip(VECTOR_FIELDS, raw_vector(IMU, at(5.0, 0.0, 0.0), progress), strict=True))
    assert len(vector) == VECTOR_SIZE
    assert vector['speed_mps'] == 6.0
    assert vector['checkpoint_0_x'] == pytest.approx(20 / 25)
    assert vector['checkpoint_1_y'] == pytest.approx(10 / 25)
    turned = dict(zip(VECTOR_FIELDS, raw_vector(IMU, at(5.0, 0.0, np.pi / 2), progress), strict=True))
    assert turned['checkpoint_0_y'] == pytest.approx(-20 / 25, abs=1e-6)


def test_progress_moves_forward_only_and_restarts_with_a_new_route() -> None:
    progress = RouteProgress()
    progress.update(ROUTE, at(24.0, 0.0, 0.0))
    assert progress.next_index == 2
    progress.update(ROUTE, at(5.0, 0.0, 0.0))
    assert progress.next_index == 2
    progress.update(Route(2, ROUTE.checkpoints_m), at(5.0, 0.0, 0.0))
    assert progress.next_index == 1


def test_without_a_route_there_is_no_vector() -> None:
    with pytest.raises(ValueError, match='no route'):
        raw_vector(IMU, at(0, 0, 0), RouteProgress())
