"""All messages of one simulation tick: what the bridge publishes is what the collector writes."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from msg_adapters.compressed import compressed_image_to_message
from msg_adapters.factory import MessageFactory
from msg_adapters.privileged import bev_to_message, ego_to_message, signals_to_message, transition_to_message
from msg_adapters.privileged_actors import actor_fields, actors_to_message
from msg_adapters.sensors import (
    BASE_FRAME,
    IMU_FRAME,
    camera_info_to_message,
    fill_image,
    imu_to_message,
    new_image,
    odometry_to_message,
    optical_frame,
    route_to_message,
    transform_to_message,
)
from raw2drive_ros.contracts import topics
from raw2drive_ros.contracts.public import CameraCalibration
from raw2drive_ros.simulation.ego import IMU_X_M
from raw2drive_ros.simulation.environment import Tick

Addressed = tuple[str, int, Any]


class TickMessages:
    """Keeps one reusable Image per camera; messages are valid until the next call."""

    def __init__(
        self, factory: MessageFactory, rig: tuple[CameraCalibration, ...], *, compressed: bool = False
    ) -> None:
        self.factory = factory
        self.rig = rig
        self.compressed = compressed
        self.actor_fields = actor_fields(factory)
        self.images = {c.name: new_image(factory, c.name, c.height, c.width) for c in rig}

    def latched(self, stamp_ns: int) -> Iterator[Addressed]:
        """(topic, stamp, message) of the mounting poses, sent once."""
        for camera in self.rig:
            message = transform_to_message(
                self.factory, camera.base_from_camera, BASE_FRAME, optical_frame(camera.name), stamp_ns
            )
            yield topics.extrinsics_topic(camera.name), stamp_ns, message
        mounting = np.eye(4)
        mounting[0, 3] = IMU_X_M
        yield (
            topics.IMU_EXTRINSICS,
            stamp_ns,
            transform_to_message(self.factory, mounting, BASE_FRAME, IMU_FRAME, stamp_ns),
        )

    def route(self, tick: Tick) -> Addressed:
        return topics.ROUTE, tick.stamp_ns, route_to_message(self.factory, tick.route)

    def motion(self, tick: Tick) -> Iterator[Addressed]:
        """IMU and odometry of every physics step since the last tick."""
        for imu in tick.imu_samples:
            yield topics.IMU, imu.stamp_ns, imu_to_message(self.factory, imu)
        for odometry in tick.odometry_samples:
            yield topics.ODOMETRY, odometry.stamp_ns, odometry_to_message(self.factory, odometry)

    def cameras(self, tick: Tick) -> Iterator[Addressed]:
        """Image and calibration per camera, all with the tick's stamp."""
        for camera in self.rig:
            if camera.name not in tick.sensors.images:
                continue
            image = tick.sensors.images[camera.name]
            info = camera_info_to_message(self.factory, camera, tick.stamp_ns)
            yield topics.camera_info_topic(camera.name), tick.stamp_ns, info
            if self.compressed:
                packed = compressed_image_to_message(self.factory, camera.name, image, tick.stamp_ns)
                yield topics.compressed_topic(camera.name), tick.stamp_ns, packed
                continue
            message = self.images[camera.name]
            fill_image(message, image, tick.stamp_ns)
            yield topics.image_topic(camera.name), tick.stamp_ns, message

    def privileged(self, tick: Tick, episode: str) -> Iterator[Addressed]:
        """Masks, vectors and actors, as far as they were computed, and the transition."""
        factory, stamp_ns, frame = self.factory, tick.stamp_ns, tick.privileged
        if frame is not None:
            masks = bev_to_message(factory, frame.bev, stamp_ns)
            yield topics.BEV, stamp_ns, masks
            yield topics.EGO, stamp_ns, ego_to_message(factory, frame)
            if frame.bev_visible is not None:
                same = frame.bev_visible is frame.bev
                seen = masks if same else bev_to_message(factory, frame.bev_visible, stamp_ns)
                yield topics.BEV_VISIBLE, stamp_ns, seen
            if frame.signals is not None:
                yield topics.SIGNALS, stamp_ns, signals_to_message(factory, frame.signals, stamp_ns)
            if frame.actors is not None:
                fields = self.actor_fields
                yield topics.ACTORS, stamp_ns, actors_to_message(factory, frame.actors, stamp_ns, fields)
        message = transition_to_message(self.factory, tick.transition, episode)
        yield topics.TRANSITION, tick.stamp_ns, message
