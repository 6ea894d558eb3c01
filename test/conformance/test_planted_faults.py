"""check-vehicle names what a stranger gets wrong, by its cause and by nothing else, and leaves good vehicles alone."""

import cv2
import numpy as np
import pytest
from planted_faults import FAULTS, found, names_it
from planted_vehicle import HEALTHY, check, drive_with

from msg_adapters.factory import RosbagsFactory
from raw2drive_ros.conformance.active import conclude, what_forbids_motion
from raw2drive_ros.conformance.collector import Collector
from raw2drive_ros.conformance.mosaic import expectation, mosaic
from raw2drive_ros.conformance.observation import Observation
from raw2drive_ros.conformance.passive import judge
from raw2drive_ros.contracts import topics
from raw2drive_ros.contracts.public import Control
from raw2drive_ros.evaluation.tick_messages import TickMessages
from raw2drive_ros.simulation.camera_rig import camera_rig
from raw2drive_ros.simulation.environment import DrivingEnv, SimulationConfig
from raw2drive_ros.simulation.route_id import RouteId


def test_there_are_enough_faults() -> None:
    assert len(FAULTS) >= 20
    assert len({fault.name for fault in FAULTS}) == len(FAULTS)


@pytest.mark.parametrize('fault', FAULTS, ids=lambda fault: fault.name)
def test_a_planted_fault_is_named_by_its_cause_alone(fault) -> None:
    verdicts = found(fault)
    assert names_it(fault, verdicts), verdicts
    assert len(verdicts) == 1, verdicts
    assert all(verdict.remedy for verdict in verdicts)


def test_the_healthy_car_has_every_check_passed() -> None:
    verdicts = check(HEALTHY)
    assert [v for v in verdicts if v.severity != 'passed'] == []
    assert sum(v.check.endswith(': motion of the picture') for v in verdicts) == 6
    still = check(HEALTHY, motion=False)
    assert [v for v in still if v.severity in ('error', 'warning')] == []
    assert sum(v.severity == 'skipped' for v in still) >= 10


class SimulatedVehicle:
    """The simulation with its own messages, one decision a `tick`; time and commands as of `PlantedVehicle`."""

    def __init__(self, route: str, collector: Collector) -> None:
        self.env = DrivingEnv(SimulationConfig(bev=False, end_on_infraction=False))
        self.now, _ = self.env.reset_to(RouteId.parse(route))
        self.messages = TickMessages(RosbagsFactory(), self.env.rig)
        self.collector, self.control, self.silent = collector, Control(), 0
        for topic, _, message in self.messages.latched(1):
            if topic != topics.IMU_EXTRINSICS:
                collector.note(topic, message, 1)
        self._publish()

    @property
    def now_ns(self) -> int:
        return self.now.stamp_ns

    def command(self, control: Control, *, foreign: bool = False) -> None:
        if foreign:
            return
        try:
            self.control, self.silent = control.validate(), 0
        except ValueError:
            return

    def decide(self) -> None:
        self.silent += 1
        self.now, *_ = self.env.step(self.control if self.silent <= 3 else Control(brake=0.6))
        self._publish()

    def _publish(self) -> None:
        for source in (
            self.messages.motion(self.now),
            self.messages.cameras(self.now),
            [self.messages.route(self.now)],
        ):
            for topic, stamp, message in source:
                self.collector.note(topic, message, stamp)


@pytest.mark.parametrize('route', ['LaneFollowing/1', 'LaneFollowing/4/ClearSunset/1', 'LaneFollowing/3/HardRainNight'])
def test_the_simulation_has_no_error_in_any_weather(route) -> None:
    collector = Collector(2.0)
    vehicle = SimulatedVehicle(route, collector)
    for _ in range(20):
        vehicle.decide()
    for seen in collector.seen.topics.values():
        seen.publishers = 1
    listened = [v for v in judge(collector.seen, vehicle.env.rig) if not v.check.endswith((': publisher', ': QoS'))]
    listened = [v for v in listened if not v.check.startswith('/control')]
    assert what_forbids_motion(listened) == []
    verdicts = conclude(collector.seen, listened, drive_with(vehicle, collector))
    assert [v for v in verdicts if v.severity in ('error', 'warning')] == []
    seen = [v for v in verdicts if v.check.endswith(': motion of the picture') and v.severity == 'passed']
    assert len(seen) >= 5


def test_the_mosaic_puts_the_cars_left_on_the_left_and_says_what_to_see() -> None:
    rig = camera_rig(96, 160)
    colours = {camera.name: (40 * i + 20, 255 - 40 * i, 90) for i, camera in enumerate(rig)}
    seen = Observation(1.0)
    for name, colour in colours.items():
        seen.images[name] = np.full((96, 160, 3), colour, np.uint8)
    sheet = mosaic(seen, rig)
    assert sheet.shape == (762, 1472, 3)
    shown = [[tuple(sheet[y, x]) for x in (240, 728, 1216)] for y in (60, 426)]
    names = {colour: name for name, colour in colours.items()}
    found = [[names[tuple(int(v) for v in colour)] for colour in row] for row in shown]
    assert found == [['front_left', 'front', 'front_right'], ['back_left', 'back', 'back_right']]
    words = {camera.name: ' '.join(expectation(camera)) for camera in rig}
    assert 'looks ahead' in words['front'] and 'towards the car' in words['front']
    assert '55 degrees to the left' in words['front_left'] and words['front_left'].endswith('moves to the left')
    assert '110 degrees to the right' in words['back_right'] and words['back_right'].endswith('moves to the right')
    assert 'looks back' in words['back'] and 'away from the car' in words['back']
    # The horizon is drawn where K and mounting have it: in the middle of each picture.
    red = np.abs(sheet[30:318, 8:488].astype(int) - (230, 40, 40)).sum(axis=2) < 60
    assert abs(float(np.flatnonzero(red.any(axis=1)).mean()) - 144.0) < 2.0
    assert cv2.imencode('.png', sheet)[0]


def test_a_missing_camera_has_its_place_in_the_mosaic() -> None:
    assert mosaic(Observation(1.0), camera_rig(96, 160)).shape == (762, 1472, 3)
