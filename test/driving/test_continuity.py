"""What breaks a sequence, and that the driver forgets there what it has seen, and not where it is."""

import numpy as np
import pytest

from raw2drive_ros.contracts.public import ImuSample, OdometrySample, Route, SensorFrame
from raw2drive_ros.driving.bundle import load_bundle
from raw2drive_ros.driving.continuity import follows
from raw2drive_ros.driving.raw_driver import RawDriver
from raw2drive_ros.tables.rates import DECISION_NS

T = 50 * DECISION_NS


@pytest.mark.parametrize(
    ('before_ns', 'more', 'expected'),
    [
        (T - DECISION_NS, {}, True),
        (T, {}, True),
        (T - DECISION_NS * 3 // 2, {}, True),
        (T - DECISION_NS * 3 // 2 - 1, {}, False),
        (T - 2 * DECISION_NS, {}, False),
        (T + 1, {}, False),
        (None, {}, False),
        (T - DECISION_NS, {'same_drive': False}, False),
        (T - DECISION_NS, {'complete': False}, False),
    ],
)
def test_a_tick_follows_another_of_the_same_drive_within_a_period_and_a_half(before_ns, more, expected) -> None:
    assert follows(before_ns, T, **more) is expected


@pytest.fixture(scope='module')
def driver(bundle) -> RawDriver:
    return RawDriver(load_bundle(bundle))


def frame(driver: RawDriver, stamp_ns: int) -> SensorFrame:
    """Noise that depends on the stamp, from a car that has driven 10 m for each tick."""
    rng = np.random.default_rng(stamp_ns // DECISION_NS)
    size = (*driver.bundle.config.image_size, 3)
    images = {camera: rng.integers(0, 256, size, dtype=np.uint8) for camera in driver.cameras}
    driven_m = 10.0 * stamp_ns / DECISION_NS
    imu = ImuSample(stamp_ns, (0.0, 0.0, 9.8), (0.0, 0.0, 0.0))
    return SensorFrame(stamp_ns, images, imu, OdometrySample(stamp_ns, driven_m, 0.0, 0.0, 5.0, 0.0))


def believes(driver: RawDriver, ticks: list[int], route: Route) -> np.ndarray:
    """The belief after these ticks, from a fresh driver on."""
    driver.reset()
    for tick in ticks:
        driver.drive(frame(driver, tick * DECISION_NS), route)
    return driver.state.latent.deter.numpy().copy()


def test_the_driver_begins_anew_behind_a_lost_tick_and_keeps_its_place_on_the_route(driver) -> None:
    route = Route(0, np.array([[25.0 * i, 0.0] for i in range(8)]))
    alone = believes(driver, [5], route)
    assert np.array_equal(believes(driver, [1, 2, 3, 5], route), alone)
    assert not np.array_equal(believes(driver, [2, 3, 4, 5], route), alone)
    # Back at the first checkpoints, as a car on a route that comes by twice: what was passed stays passed.
    driver.reset()
    driver.drive(frame(driver, 7 * DECISION_NS), route)
    passed = driver.progress
    driver.drive(frame(driver, 9 * DECISION_NS), route)
    assert driver.progress is passed


def test_the_driver_begins_a_new_drive_with_a_new_route_and_when_time_goes_back(driver) -> None:
    route = Route(0, np.array([[25.0 * i, 0.0] for i in range(8)]))
    alone = believes(driver, [3], route)
    assert np.array_equal(believes(driver, [4, 3], route), alone)
    driver.reset()
    driver.drive(frame(driver, 2 * DECISION_NS), route)
    passed = driver.progress
    driver.drive(frame(driver, 3 * DECISION_NS), Route(1, route.checkpoints_m))
    assert driver.progress is not passed
    assert np.array_equal(driver.state.latent.deter.numpy(), alone)
