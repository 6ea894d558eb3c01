"""Passes messages to the planner by topic; shared by ROS callbacks, bag replay and drives under faults."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from msg_adapters.compressed import image_from_compressed_message
from msg_adapters.sensors import (
    calibration_from_messages,
    image_from_message,
    imu_from_message,
    odometry_from_message,
    route_from_message,
)
from msg_adapters.stamps import stamp_ns
from raw2drive_ros.contracts import topics
from raw2drive_ros.contracts.errors import ContractError
from raw2drive_ros.contracts.public import Decision
from raw2drive_ros.driving.raw_planner import RawPlanner

Handler = Callable[[Any, int], Decision | None]


class PlannerInputs:
    """topics: to subscribe to, in the order in which queued messages should be handled (the route first).

    on_refused: called with (input, reason) for every message that violates its contract.
    """

    def __init__(
        self,
        planner: RawPlanner,
        *,
        compressed: bool = False,
        on_refused: Callable[[str, str], None] = lambda name, why: None,
    ) -> None:
        self.planner, self.on_refused = planner, on_refused
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
                calibration = calibration_from_messages(camera, self.infos[camera], self.extrinsics[camera])
            except ContractError:
                self.planner.forget_calibration(camera)
                raise
            self.planner.add_calibration(calibration)

        return handle

    def _image(self, camera: str, convert: Callable[[Any], Any]) -> Handler:
        def handle(message: Any, now_ns: int) -> Decision | None:
            image = convert(message)
            return self.planner.add_image(camera, stamp_ns(message.header.stamp), image, now_ns)

        return handle


def _same(one: Any, other: Any) -> bool:
    """Whether two CameraInfo or TransformStamped have equal content. A CameraInfo comes with every image."""
    if hasattr(one, 'transform'):
        return bool(one.transform == other.transform)
    return (one.width, one.height) == (other.width, other.height) and all(
        np.array_equal(getattr(one, name), getattr(other, name)) for name in 'kd'
    )
