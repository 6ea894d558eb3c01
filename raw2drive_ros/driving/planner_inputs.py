"""Converts and checks messages by topic; shared by ROS callbacks, drives under faults and the reader of bags.

Whoever receives the samples, a message gets the same verdict.
"""

from __future__ import annotations

from collections.abc import Callable, Collection
from typing import Any, Protocol

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
from raw2drive_ros.contracts.public import (
    CameraCalibration,
    Decision,
    Image8,
    ImuSample,
    OdometrySample,
    Route,
    check_image,
)
from raw2drive_ros.contracts.verdicts import Verdicts
from raw2drive_ros.driving.rectification import Rectifier
from raw2drive_ros.driving.synchronisation import is_due

Handler = Callable[[Any, int], Decision | None]


class Receiver(Protocol):
    """Takes the samples: `RawPlanner`, or a reader of bags.

    cameras: names. rig: the cameras to which pictures of a lens with distortion are rectified; without one such
    pictures are refused. calibrations: the usable ones so far. taken_ns: stamp of the last pictures that were taken,
    None where every picture is.
    """

    cameras: tuple[str, ...]
    calibrations: dict[str, CameraCalibration]
    taken_ns: int | None

    @property
    def rig(self) -> tuple[CameraCalibration, ...]: ...

    def forget_pictures(self) -> None: ...

    def skip_image(self, camera: str, stamp_ns: int, now_ns: int) -> None: ...

    def add_route(self, route: Route) -> None: ...

    def add_calibration(self, calibration: CameraCalibration) -> None: ...

    def forget_calibration(self, camera: str) -> None: ...

    def add_image(self, camera: str, stamp_ns: int, image: Image8, now_ns: int) -> Decision | None: ...

    def add_imu(self, sample: ImuSample, now_ns: int) -> Decision | None: ...

    def add_odometry(self, sample: OdometrySample, now_ns: int) -> Decision | None: ...

    def refuse(self, name: str, why: str, now_ns: int) -> None: ...


class PlannerInputs:
    """topics: to subscribe to, in the order in which queued messages should be handled (the route first).

    compressed: whether images come on the compressed topics, or the cameras whose images do. on_refused: called with
    (input, reason) for every message that violates its contract. on_notice: called with a line about what is done to
    the pictures of a camera, once: those of a lens with distortion are rectified to the receiver's camera. verdicts:
    messages by topic.
    """

    def __init__(
        self,
        planner: Receiver,
        *,
        compressed: bool | Collection[str] = False,
        on_refused: Callable[[str, str], None] = lambda name, why: None,
        on_notice: Callable[[str], None] = lambda text: None,
    ) -> None:
        self.planner, self.on_refused, self.on_notice = planner, on_refused, on_notice
        self.wanted = {camera.name: camera for camera in planner.rig}
        self.rectifiers: dict[str, Rectifier] = {}
        self.infos: dict[str, Any] = {}
        self.extrinsics: dict[str, Any] = {}
        self.verdicts = Verdicts()
        self.handlers: dict[str, tuple[str, Handler]] = {topics.ROUTE: ('route', self._route)}
        for camera in planner.cameras:
            self.handlers[topics.extrinsics_topic(camera)] = camera, self._calibration(self.extrinsics, camera)
            self.handlers[topics.camera_info_topic(camera)] = camera, self._calibration(self.infos, camera)
        self.handlers[topics.IMU] = 'imu', lambda m, now: planner.add_imu(imu_from_message(m), now)
        self.handlers[topics.ODOMETRY] = 'odometry', lambda m, now: planner.add_odometry(odometry_from_message(m), now)
        for camera in planner.cameras:
            packed = compressed if isinstance(compressed, bool) else camera in compressed
            image_topic = topics.compressed_topic if packed else topics.image_topic
            convert = image_from_compressed_message if packed else image_from_message
            self.handlers[image_topic(camera)] = camera, self._image(camera, convert)

    @property
    def topics(self) -> list[str]:
        return list(self.handlers)

    @property
    def refused(self) -> int:
        """Messages that violated their contract, of all topics."""
        return sum(self.verdicts.refused.values())

    def receive(self, topic: str, message: Any, now_ns: int) -> Decision | None:
        """Pass a message on; one that violates its contract is counted and reported, and not used."""
        name, handle = self.handlers[topic]
        try:
            decision = handle(message, now_ns)
        except ContractError as error:
            self.verdicts.refuse(topic, stamp_ns(message.header.stamp), str(error))
            self.planner.refuse(name, str(error), now_ns)
            self.on_refused(name, str(error))
            return None
        self.verdicts.accept(topic)
        return decision

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
        if lens is None or camera not in self.wanted:
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
            image = check_image(rectify(image) if rectify else image, self.planner.calibrations.get(camera))
            return self.planner.add_image(camera, stamp, image, now_ns)

        return handle


def _same(one: Any, other: Any) -> bool:
    """Whether two CameraInfo or TransformStamped have equal content. A CameraInfo comes with every image."""
    if hasattr(one, 'transform'):
        return bool(one.transform == other.transform)
    same = [getattr(one, name) == getattr(other, name) for name in ('width', 'height', 'distortion_model')]
    return all(same) and all(np.array_equal(getattr(one, name), getattr(other, name)) for name in 'kd')
