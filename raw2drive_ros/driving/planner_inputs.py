"""Passes messages to the planner by topic; shared by ROS callbacks, bag replay and drives under faults."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from msg_adapters.compressed import image_from_compressed_message
from msg_adapters.lens import lens_from_message
from msg_adapters.sensors import (
    calibration_from_messages,
    image_from_message,
    imu_from_message,
    odometry_from_message,
    route_from_message,
    transform_from_message,
)
from msg_adapters.stamps import stamp_ns
from raw2drive_ros.contracts import topics
from raw2drive_ros.contracts.errors import ContractError
from raw2drive_ros.contracts.public import CameraCalibration, Decision
from raw2drive_ros.driving.raw_planner import RawPlanner
from raw2drive_ros.driving.rectification import Rectifier
from raw2drive_ros.driving.synchronisation import is_due

Handler = Callable[[Any, int], Decision | None]


class PlannerInputs:
    """topics: to subscribe to, in the order in which queued messages should be handled (the route first).

    on_refused: called with (input, reason) for every message that violates its contract. on_notice: called with a line
    about what is done to the pictures of a camera, once: those of a lens with distortion are rectified to the bundle's
    camera.
    """

    def __init__(
        self,
        planner: RawPlanner,
        *,
        compressed: bool = False,
        on_refused: Callable[[str, str], None] = lambda name, why: None,
        on_notice: Callable[[str], None] = lambda text: None,
    ) -> None:
        self.planner, self.on_refused, self.on_notice = planner, on_refused, on_notice
        self.wanted = {camera.name: camera for camera in planner.bundle.rig}
        self.rectifiers: dict[str, Rectifier] = {}
        self.infos: dict[str, Any] = {}
        self.extrinsics: dict[str, Any] = {}
        self.refused = 0
        self.handlers: dict[str, tuple[str, Handler]] = {topics.ROUTE: ('route', self._route)}
        for camera in planner.cameras:
            self.handlers[topics.extrinsics_topic(camera)] = camera, self._calibration(self.extrinsics, camera)
            self.handlers[topics.camera_info_topic(camera)] = camera, self._calibration(self.infos, camera)
        self.handlers[topics.IMU] = 'imu', lambda m, now: planner.add_imu(imu_from_message(m), now)
        self.handlers[topics.ODOMETRY] = 'odometry', lambda m, now: planner.add_odometry(odometry_from_message(m), now)
        image_topic = topics.compressed_topic if compressed else topics.image_topic
        convert = image_from_compressed_message if compressed else image_from_message
        for camera in planner.cameras:
            self.handlers[image_topic(camera)] = camera, self._image(camera, convert)

    @property
    def topics(self) -> list[str]:
        return list(self.handlers)

    def receive(self, topic: str, message: Any, now_ns: int) -> Decision | None:
        """Pass a message on; one that violates its contract is counted and reported, and not used."""
        name, handle = self.handlers[topic]
        try:
            return handle(message, now_ns)
        except ContractError as error:
            self.refused += 1
            self.planner.refuse(name, str(error), now_ns)
            self.on_refused(name, str(error))
            return None

    def _route(self, message: Any, now_ns: int) -> None:
        self.planner.add_route(route_from_message(message))

    def _calibration(self, store: dict[str, Any], camera: str) -> Handler:
        def handle(message: Any, now_ns: int) -> None:
            known, store[camera] = store.get(camera), message
            if camera not in self.infos or camera not in self.extrinsics:
                return
            if camera in self.planner.calibrations and known is not None and _same(known, message):
                return
            try:
                calibration = self._calibration_of(camera)
            except ContractError:
                self.rectifiers.pop(camera, None)
                self.planner.forget_calibration(camera)
                raise
            self.planner.add_calibration(calibration)

        return handle

    def _calibration_of(self, camera: str) -> CameraCalibration:
        """The camera as the planner sees it: rectified, where the lens has distortion."""
        info, extrinsics = self.infos[camera], self.extrinsics[camera]
        lens, known = lens_from_message(camera, info), self.rectifiers.get(camera)
        if lens is None:
            if self.rectifiers.pop(camera, None) is not None:
                self.planner.forget_pictures()
            return calibration_from_messages(camera, info, extrinsics)
        if known is None or not known.fits(lens):
            self.rectifiers[camera] = known = Rectifier(lens, self.wanted[camera])
            # Pictures that wait for others are of the lens.
            self.planner.forget_pictures()
            self.on_notice(str(known))
        return known.calibration(transform_from_message(extrinsics))

    def _image(self, camera: str, convert: Callable[[Any], Any]) -> Handler:
        def handle(message: Any, now_ns: int) -> Decision | None:
            stamp = stamp_ns(message.header.stamp)
            if not is_due(stamp, self.planner.taken_ns):
                # Neither decompressed nor rectified: no decision needs it.
                self.planner.skip_image(camera, stamp, now_ns)
                return None
            image, rectify = convert(message), self.rectifiers.get(camera)
            return self.planner.add_image(camera, stamp, rectify(image) if rectify else image, now_ns)

        return handle


def _same(one: Any, other: Any) -> bool:
    """Whether two CameraInfo or TransformStamped have equal content. A CameraInfo comes with every image."""
    if hasattr(one, 'transform'):
        return bool(one.transform == other.transform)
    same = [getattr(one, name) == getattr(other, name) for name in ('width', 'height', 'distortion_model')]
    return all(same) and all(np.array_equal(getattr(one, name), getattr(other, name)) for name in 'kd')
