"""Cameras that are faster than decisions, and sensors that share no trigger, all the way through the planner."""

import numpy as np
import pytest

from msg_adapters.factory import RosbagsFactory
from msg_adapters.sensors import fill_image, imu_to_message, new_image, odometry_to_message, route_to_message
from raw2drive_ros.contracts import topics
from raw2drive_ros.contracts.public import ImuSample, OdometrySample, Route
from raw2drive_ros.driving.bundle import load_bundle
from raw2drive_ros.driving.planner_inputs import PlannerInputs
from raw2drive_ros.driving.raw_planner import RawPlanner
from raw2drive_ros.driving.sensor_monitor import Health, MonitorLimits
from raw2drive_ros.driving.synchronisation import Synchronisation

FACTORY = RosbagsFactory()
MS = 1_000_000
SPEED_MPS = 5.0


class Car:
    """Sensors of a car that drives straight on, each with its own rate and phase; messages come in order of stamps."""

    def __init__(self, bundle, sync: Synchronisation | None = None) -> None:
        self.planner = RawPlanner(load_bundle(bundle), MonitorLimits(), sync=sync)
        self.refused: list[str] = []
        self.inputs = PlannerInputs(self.planner, on_refused=lambda name, why: self.refused.append(why))
        self.planner.start(0)
        for camera in self.planner.bundle.rig:
            self.planner.add_calibration(camera)
        self.decisions = []
        self.send(topics.ROUTE, route_to_message(FACTORY, Route(1, np.array([[0.0, 0.0], [100.0, 0.0]]))), 0)

    def send(self, topic: str, message, now_ns: int) -> None:
        decision = self.inputs.receive(topic, message, now_ns)
        self.decisions += [decision] if decision is not None else []

    def motion(self, stamp_ns: int) -> None:
        t_s = stamp_ns * 1e-9
        imu = ImuSample(stamp_ns, (t_s, 0.0, 9.81), (0.0, 0.0, 0.0))
        self.send(topics.IMU, imu_to_message(FACTORY, imu), stamp_ns)
        odometry = OdometrySample(stamp_ns, SPEED_MPS * t_s, 0.0, 0.0, SPEED_MPS, 0.0)
        self.send(topics.ODOMETRY, odometry_to_message(FACTORY, odometry), stamp_ns)

    def pictures(self, stamp_ns: int, encoding: str = 'rgb8', skew_ns: int = 0) -> None:
        """What the cameras show depends on the stamp alone. skew_ns: from one camera to the next."""
        for number, camera in enumerate(self.planner.bundle.rig):
            rng = np.random.default_rng([stamp_ns, number])
            message = new_image(FACTORY, camera.name, camera.height, camera.width)
            fill_image(message, rng.integers(0, 256, (camera.height, camera.width, 3), np.uint8), stamp_ns)
            message.encoding = encoding
            own_ns = stamp_ns + number * skew_ns
            message.header.stamp.sec, message.header.stamp.nanosec = divmod(own_ns, 1_000_000_000)
            self.send(topics.image_topic(camera.name), message, own_ns)

    def drive(self, hz: int, seconds: float = 2.0, motion_hz: int = 60) -> None:
        stamps = {round(n * 1e9 / motion_hz): 'motion' for n in range(round(seconds * motion_hz))}
        pictures = {round(n * 1e9 / hz) for n in range(round(seconds * hz))}
        for stamp_ns in sorted(stamps.keys() | pictures):
            if stamp_ns in stamps:
                self.motion(stamp_ns)
            if stamp_ns in pictures:
                self.pictures(stamp_ns)

    def drives(self) -> list[tuple]:
        return [(d.stamp_ns, d.control, d.action, d.info) for d in self.decisions]


@pytest.fixture(scope='module')
def at_10_hz(bundle):
    car = Car(bundle)
    car.drive(10)
    assert len(car.decisions) == 20
    return car.drives()


@pytest.mark.parametrize('hz', [20, 30, 60])
def test_a_faster_camera_drives_bit_for_bit_like_one_of_10_hz(bundle, at_10_hz, hz) -> None:
    """The recurrent state sees the same steps; what comes in between is no fault."""
    car = Car(bundle)
    car.drive(hz)
    assert car.drives() == at_10_hz
    assert car.planner.findings == []
    assert car.planner.assembler.incomplete == 0
    assert car.planner.monitor.counts['front_between'] == (hz - 10) * 2


def test_pictures_in_between_are_not_even_decoded(bundle) -> None:
    car = Car(bundle)
    for stamp_ms in (0, 100, 200):
        car.motion(stamp_ms * MS)
        car.pictures(stamp_ms * MS)
        car.pictures((stamp_ms + 50) * MS, encoding='yuv422')
    assert car.refused == []
    assert len(car.decisions) == 3
    car.pictures(300 * MS, encoding='yuv422')
    assert car.refused


def test_a_lost_picture_is_made_good_by_the_next_one(bundle) -> None:
    """At 20 Hz the set after an incomplete one is decided upon, 150 ms after the one before."""
    car = Car(bundle)
    for stamp_ms in range(0, 500, 50):
        car.motion(stamp_ms * MS)
        if stamp_ms != 200:
            car.pictures(stamp_ms * MS)
    assert [d.stamp_ns // MS for d in car.decisions] == [0, 100, 250, 350, 450]


def test_a_new_route_is_decided_upon_at_once(bundle) -> None:
    car = Car(bundle)
    for stamp_ms in (0, 50):
        car.motion(stamp_ms * MS)
        car.pictures(stamp_ms * MS)
        car.send(topics.ROUTE, route_to_message(FACTORY, Route(2, np.array([[0.0, 0.0], [50.0, 0.0]]))), stamp_ms * MS)
    assert [d.stamp_ns // MS for d in car.decisions] == [0, 50]


@pytest.mark.parametrize(
    ('hz', 'health', 'cause'),
    [
        (15, Health.DEGRADED, '7.5 Hz instead of 10, pictures come at 15.0 Hz'),
        (12, Health.STOP, '6.0 Hz instead of 10, pictures come at 12.0 Hz'),
        (25, Health.DEGRADED, '8.3 Hz instead of 10, pictures come at 25.0 Hz'),
    ],
)
def test_a_rate_that_is_no_multiple_is_named(bundle, hz, health, cause) -> None:
    car = Car(bundle)
    car.drive(hz, motion_hz=hz)
    assert [finding.health for finding in car.planner.findings] == [health]
    assert cause in car.planner.findings[0].cause
    assert 'multiple' in car.planner.findings[0].remedy


def test_motion_between_the_pictures_is_interpolated(bundle) -> None:
    """Odometry and IMU at 20 Hz, 20 ms off: nothing without the parameter, and with it the straight line."""
    cars = {age: Car(bundle, Synchronisation(interpolate_age_s=age)) for age in (0.0, 0.05)}
    for car in cars.values():
        for stamp_ms in range(0, 1500, 10):
            if stamp_ms % 50 == 20:
                car.motion(stamp_ms * MS)
            if stamp_ms % 100 == 0:
                car.pictures(stamp_ms * MS)
                car.planner.look(stamp_ms * MS)
    assert cars[0.0].decisions == []
    assert cars[0.0].planner.health is Health.STOP
    assert 'no sample of imu, odometry at the stamp' in cars[0.0].planner.findings[0].cause
    assert [d.stamp_ns // MS for d in cars[0.05].decisions] == list(range(100, 1500, 100))


def test_interpolated_motion_drives_like_motion_of_the_stamp(bundle, at_10_hz) -> None:
    """The car's motion is linear in time here, so that interpolation gives it exactly, but for rounding."""
    car = Car(bundle, Synchronisation(interpolate_age_s=0.1))
    for stamp_ms in range(-30, 2080, 10):
        if stamp_ms % 100 == 70:
            car.planner.add_imu(ImuSample(stamp_ms * MS, (stamp_ms * 1e-3, 0.0, 9.81), (0.0,) * 3), stamp_ms * MS)
            x_m = SPEED_MPS * stamp_ms * 1e-3
            found = car.planner.add_odometry(OdometrySample(stamp_ms * MS, x_m, 0, 0, SPEED_MPS, 0), stamp_ms * MS)
            car.decisions += [found] if found is not None else []
        if stamp_ms % 100 == 0 and 0 <= stamp_ms < 2000:
            car.pictures(stamp_ms * MS)
    assert [(d.stamp_ns, d.action) for d in car.decisions] == [(stamp, action) for stamp, _, action, _ in at_10_hz]
    found = [d.info['probability'] for d in car.decisions]
    assert found == pytest.approx([info['probability'] for *_, info in at_10_hz], abs=1e-4)


def test_cameras_without_a_common_trigger_are_joined_within_the_skew(bundle, at_10_hz) -> None:
    cars = {skew: Car(bundle, Synchronisation(camera_skew_s=skew)) for skew in (0.0, 0.03)}
    for car in cars.values():
        for stamp_ms in range(0, 2000, 100):
            car.motion(stamp_ms * MS)
            car.pictures(stamp_ms * MS, skew_ns=5 * MS)
            car.planner.look(stamp_ms * MS)
    assert cars[0.0].decisions == []
    assert 'at the stamp of the others' in cars[0.0].planner.findings[0].cause
    assert '--camera-skew' in cars[0.0].planner.findings[0].remedy
    assert cars[0.03].drives() == at_10_hz
    assert cars[0.03].planner.findings == []
