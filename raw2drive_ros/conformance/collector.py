"""Messages of a vehicle into an `Observation`; knows nothing of where they come from."""

from __future__ import annotations

import math
from typing import Any

import cv2
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
from raw2drive_ros.conformance.observation import Observation, TopicSeen
from raw2drive_ros.contracts import topics
from raw2drive_ros.contracts.errors import ContractError

# Twenty seconds of one camera while the car moves; more would not tell more.
PICTURES = 200
MOVES_MPS = 0.2


class Collector:
    """compressed: pictures come as CompressedImage. seen: grows with every message of `note`."""

    def __init__(self, seconds: float, *, compressed: bool = False) -> None:
        self.seen = Observation(seconds)
        self.convert = image_from_compressed_message if compressed else image_from_message
        self.infos: dict[str, Any] = {}
        self.extrinsics: dict[str, Any] = {}
        self.moves = False

    def note(self, name: str, message: Any, now_ns: int) -> None:
        """A message of topic `name` that arrived at `now_ns`, ROS time. One that breaks its contract is counted."""
        topic = self.seen.topics.setdefault(name, TopicSeen())
        stamp = stamp_ns(message.header.stamp)
        topic.stamps_ns.append(stamp)
        topic.ages_s.append((now_ns - stamp) * 1e-9)
        topic.frames.add(str(message.header.frame_id))
        try:
            self._keep(name, message, stamp)
        except ContractError as error:
            topic.refused.append(str(error))

    def _keep(self, name: str, message: Any, stamp: int) -> None:
        seen = self.seen
        if name == topics.IMU:
            seen.imu.append(imu_from_message(message))
        elif name == topics.ODOMETRY:
            self._odometry(message)
        elif name == topics.ROUTE:
            seen.route = route_from_message(message)
        else:
            camera = name.split('/')[3]
            if name == topics.camera_info_topic(camera):
                self._camera_info(camera, message)
            elif name == topics.extrinsics_topic(camera):
                self.extrinsics[camera] = message
                self._calibrate(camera)
            else:
                self._picture(camera, message, stamp)

    def _odometry(self, message: Any) -> None:
        found = odometry_from_message(message)
        lateral = float(message.twist.twist.linear.y)
        self.seen.odometry.append(found)
        self.seen.lateral_mps.append(lateral if math.isfinite(lateral) else 0.0)
        self.moves = math.hypot(found.speed_mps, self.seen.lateral_mps[-1]) > MOVES_MPS

    def _picture(self, camera: str, message: Any, stamp: int) -> None:
        image = self.convert(message)
        self.seen.images[camera] = np.array(image)
        kept = self.seen.pictures.setdefault(camera, [])
        if self.moves and len(kept) < PICTURES:
            kept.append((stamp, cv2.cvtColor(self.seen.images[camera], cv2.COLOR_RGB2GRAY)))

    def _camera_info(self, camera: str, message: Any) -> None:
        distortion = tuple(float(value) for value in message.d)
        if any(distortion):
            # One fault, one finding: without this, every check of the camera would report the same lens.
            self.seen.distortion[camera] = distortion
            self.seen.calibrations.pop(camera, None)
            return
        self.infos[camera] = message
        self._calibrate(camera)

    def _calibrate(self, camera: str) -> None:
        if camera in self.infos and camera in self.extrinsics:
            found = calibration_from_messages(camera, self.infos[camera], self.extrinsics[camera])
            self.seen.calibrations[camera] = found
