"""Assembles messages into frames: every camera, the IMU and the odometry of one stamp."""

from __future__ import annotations

from dataclasses import dataclass, field

from raw2drive_ros.contracts.public import Image8, ImuSample, OdometrySample, SensorFrame

PENDING_LIMIT = 4


@dataclass(slots=True)
class FrameAssembler:
    """Bounded: at most `PENDING_LIMIT` incomplete stamps are kept; older ones count as incomplete.

    An image older than the last complete frame is dropped, but one with the same stamp starts that frame
    again: the bridge resends a tick whose answer was lost.
    """

    cameras: tuple[str, ...]
    images: dict[int, dict[str, Image8]] = field(default_factory=dict)
    imus: dict[int, ImuSample] = field(default_factory=dict)
    odometries: dict[int, OdometrySample] = field(default_factory=dict)
    incomplete: int = 0
    late: int = 0
    last_ns: int = -1

    def reset(self) -> None:
        self.images.clear()
        self.imus.clear()
        self.odometries.clear()
        self.last_ns = -1

    def add_image(self, camera: str, stamp_ns: int, image: Image8) -> SensorFrame | None:
        if stamp_ns < self.last_ns:
            self.late += 1
            return None
        self.images.setdefault(stamp_ns, {})[camera] = image
        return self._complete(stamp_ns)

    def add_imu(self, sample: ImuSample) -> SensorFrame | None:
        self.imus[sample.stamp_ns] = sample
        return self._complete(sample.stamp_ns)

    def add_odometry(self, sample: OdometrySample) -> SensorFrame | None:
        self.odometries[sample.stamp_ns] = sample
        return self._complete(sample.stamp_ns)

    def _complete(self, stamp_ns: int) -> SensorFrame | None:
        """The frame of a stamp if it is complete; its parts and everything older are then discarded."""
        images = self.images.get(stamp_ns)
        imu, odometry = self.imus.get(stamp_ns), self.odometries.get(stamp_ns)
        if images is None or len(images) < len(self.cameras) or imu is None or odometry is None:
            self._bound()
            return None
        frame = SensorFrame(stamp_ns, images, imu, odometry)
        self.incomplete += sum(1 for s in self.images if s < stamp_ns)
        self.images = {s: v for s, v in self.images.items() if s > stamp_ns}
        self.imus = {s: v for s, v in self.imus.items() if s > stamp_ns}
        self.odometries = {s: v for s, v in self.odometries.items() if s > stamp_ns}
        self.last_ns = stamp_ns
        return frame

    def _bound(self) -> None:
        while len(self.images) > PENDING_LIMIT:
            del self.images[min(self.images)]
            self.incomplete += 1
        # Motion samples come more often than images; 40 of them are two seconds.
        for samples in (self.imus, self.odometries):
            while len(samples) > 10 * PENDING_LIMIT:
                del samples[min(samples)]
