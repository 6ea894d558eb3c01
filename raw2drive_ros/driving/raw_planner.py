"""The planner without ROS: samples in, decisions out. The node and the evaluation under faults both run this."""

from __future__ import annotations

from collections import deque

import numpy as np

from raw2drive_ros.contracts import topics
from raw2drive_ros.contracts.errors import BundleError, ContractError
from raw2drive_ros.contracts.public import (
    CameraCalibration,
    Decision,
    Image8,
    ImuSample,
    OdometrySample,
    Route,
    SensorFrame,
)
from raw2drive_ros.driving.bundle import Bundle, check_rig
from raw2drive_ros.driving.frame_assembler import FrameAssembler
from raw2drive_ros.driving.raw_driver import RawDriver
from raw2drive_ros.driving.sensor_monitor import Finding, Health, MonitorLimits, SensorMonitor
from raw2drive_ros.driving.synchronisation import Synchronisation, is_due

NO_ROUTE = f'no route yet: who publishes {topics.ROUTE}?'


class RawPlanner:
    """Assembles frames, watches the sensors and decides; `None` is silence, which makes the gate stop the car.

    Decides once per decision period, by the stamps; pictures in between are left out. Every `add_*` takes `now_ns`, the
    ROS time of arrival. `failure`: why it is silent although the sensors are healthy.
    """

    def __init__(
        self, bundle: Bundle, limits: MonitorLimits, threads: int = 1, sync: Synchronisation | None = None
    ) -> None:
        self.bundle = bundle
        self.sync = sync or Synchronisation()
        self.driver = RawDriver(bundle, threads)
        self.cameras = tuple(camera.name for camera in bundle.rig)
        self.monitor = SensorMonitor(self.cameras, limits)
        # Of the last 17 minutes only: its quantiles are computed every second, while driving.
        self.latency_ms: deque[float] = deque(maxlen=10_000)
        self.decisions = 0
        self._warm_up()
        self.start(0)

    def start(self, now_ns: int, *, same_vehicle: bool = False) -> None:
        """Start, or start again without the samples so far. same_vehicle: keep route and calibrations, which are
        latched and not sent again, as after a jump of time."""
        self.assembler = FrameAssembler(self.cameras, self.sync)
        self.monitor.reset()
        self.monitor.start(now_ns)
        self.started_ns = now_ns
        self.driver.reset()
        self.answered: Decision | None = None
        self.taken_ns: int | None = None
        if not same_vehicle:
            self.route: Route | None = None
            self.calibrations: dict[str, CameraCalibration] = {}
            self.rig_checked = False
        self.failure = ''
        self.findings: list[Finding] = []

    @property
    def rig(self) -> tuple[CameraCalibration, ...]:
        """The cameras that the bundle was trained with."""
        return self.bundle.rig

    @property
    def health(self) -> Health:
        """Health of the sensors at the last `look`."""
        return self.findings[0].health if self.findings else Health.NOMINAL

    def look(self, now_ns: int) -> None:
        """Check the sensors at `now_ns`; the result is in `findings` and `health`."""
        self.findings = self.monitor.findings(now_ns)
        if self.health is not Health.STOP:
            self.findings = [*self._without_frames(now_ns), *self.findings]

    def _without_frames(self, now_ns: int) -> list[Finding]:
        """Every input is heard, but no frame has been complete for a while: that must not pass in silence."""
        since_s = (now_ns - max(self.assembler.last_ns, self.started_ns)) * 1e-9
        lacks = self.assembler.lacks()
        if since_s <= self.monitor.limits.memory_s or not lacks or not self.monitor.complete:
            return []
        remedy = 'trigger the sensors together, or see `raw2drive drive --camera-skew` and `--interpolate-age`'
        return [Finding(Health.STOP, f'frames: none for {since_s:.1f} s, {lacks}', remedy)]

    def add_route(self, route: Route) -> None:
        if self.route is not None and route.stamp_ns != self.route.stamp_ns:
            self.taken_ns = None
        self.route = route
        if self.failure == NO_ROUTE:
            self.failure = ''

    def add_calibration(self, calibration: CameraCalibration) -> None:
        """May be called repeatedly; a changed one is checked against the bundle before the next decision."""
        known = self.calibrations.get(calibration.name)
        if known is None or not known.equals(calibration):
            self.calibrations[calibration.name] = calibration
            self.rig_checked = False

    def forget_calibration(self, camera: str) -> None:
        """The camera's calibration became unusable: no decisions until a usable one arrives."""
        self.calibrations.pop(camera, None)
        self.rig_checked = False

    def forget_pictures(self) -> None:
        """The calibration of a camera has become another one: drop the pictures that wait for others."""
        self.assembler.forget_pictures()

    def add_image(self, camera: str, stamp_ns: int, image: Image8, now_ns: int) -> Decision | None:
        if not is_due(stamp_ns, self.taken_ns):
            self.skip_image(camera, stamp_ns, now_ns)
            return None
        if not self.monitor.heard(camera, stamp_ns, now_ns):
            return None
        return self._decide(self.assembler.add_image(camera, stamp_ns, image), now_ns)

    def skip_image(self, camera: str, stamp_ns: int, now_ns: int) -> None:
        """A picture arrived that no decision needs: the camera is alive."""
        if self.monitor.heard(camera, stamp_ns, now_ns):
            self.monitor.between(camera)

    def add_imu(self, sample: ImuSample, now_ns: int) -> Decision | None:
        if not self.monitor.heard('imu', sample.stamp_ns, now_ns):
            return None
        self.monitor.imu(sample)
        return self._decide(self.assembler.add_imu(sample), now_ns)

    def add_odometry(self, sample: OdometrySample, now_ns: int) -> Decision | None:
        if not self.monitor.heard('odometry', sample.stamp_ns, now_ns):
            return None
        return self._decide(self.assembler.add_odometry(sample), now_ns)

    def refuse(self, name: str, why: str, now_ns: int) -> None:
        """Report a message of input `name` that violated its contract."""
        self.monitor.refused(name, why, now_ns)

    def _decide(self, frame: SensorFrame | None, now_ns: int) -> Decision | None:
        if frame is None:
            return None
        if self.route is None:
            self.failure = NO_ROUTE
            return None
        if self.answered is not None and self.answered.stamp_ns == frame.stamp_ns:
            # The same tick again: its answer was lost. Deciding twice would advance the recurrent state twice.
            return self.answered
        if not is_due(frame.stamp_ns, self.taken_ns):
            return None
        self.taken_ns = frame.stamp_ns
        self.monitor.frame(frame)
        self.look(now_ns)
        if self.health is Health.STOP:
            return None
        try:
            if not self.rig_checked:
                self.check_cameras()
            decision = self.driver.drive(frame, self.route)
        except (ContractError, BundleError) as error:
            self.failure = str(error)
            return None
        self.failure = ''
        self.answered = decision
        self.latency_ms.append(decision.inference_ms)
        self.decisions += 1
        return decision

    def check_cameras(self) -> None:
        """Raises BundleError until every camera's calibration is known and equals the bundle's."""
        missing = [camera for camera in self.cameras if camera not in self.calibrations]
        if missing:
            raise BundleError(f'no calibration yet for {", ".join(missing)}')
        check_rig(self.bundle, tuple(self.calibrations[camera] for camera in self.cameras))
        self.rig_checked = True

    def _warm_up(self) -> None:
        """Decide on an empty frame, so that the first real one is fast."""
        height, width = self.bundle.config.image_size
        blank = np.zeros((height, width, 3), np.uint8)
        imu, odometry = ImuSample(0, (0.0, 0.0, 9.81), (0.0,) * 3), OdometrySample(0, 0, 0, 0, 0, 0)
        frame = SensorFrame(0, dict.fromkeys(self.cameras, blank), imu, odometry)
        for _ in range(3):
            self.driver.drive(frame, Route(0, np.array([[0.0, 0.0], [25.0, 0.0]])))
