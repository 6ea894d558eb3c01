"""Assembles messages into frames: every camera, the IMU and the odometry of one stamp."""

from __future__ import annotations

from dataclasses import dataclass, field

from raw2drive_ros.contracts.public import Image8, ImuSample, OdometrySample, SensorFrame
from raw2drive_ros.driving.synchronisation import Sample, Synchronisation, sample_at

PENDING_LIMIT = 4
# Motion samples come more often than images: a second of an IMU of 400 Hz.
MOTION_LIMIT = 400


@dataclass(slots=True)
class FrameAssembler:
    """Bounded: at most `PENDING_LIMIT` incomplete sets of pictures are kept; older ones count as incomplete.

    An image older than the last complete frame is dropped, but one with the same stamp starts that frame
    again: the bridge resends a tick whose answer was lost.

    images: camera -> picture of each incomplete set, by the EARLIEST stamp of the set. That stamp is the frame's: the
    age of a decision is that of its oldest picture.
    """

    cameras: tuple[str, ...]
    sync: Synchronisation = field(default_factory=Synchronisation)
    images: dict[int, dict[str, Image8]] = field(default_factory=dict)
    imus: dict[int, ImuSample] = field(default_factory=dict)
    odometries: dict[int, OdometrySample] = field(default_factory=dict)
    incomplete: int = 0
    late: int = 0
    last_ns: int = -1
    _latest_ns: dict[int, int] = field(default_factory=dict)
    _done_ns: int = -1

    def reset(self) -> None:
        self.images.clear()
        self.imus.clear()
        self.odometries.clear()
        self._latest_ns.clear()
        self.last_ns = self._done_ns = -1

    def forget_pictures(self) -> None:
        """Drop the pictures that wait for others."""
        self.images.clear()
        self._latest_ns.clear()

    def add_image(self, camera: str, stamp_ns: int, image: Image8) -> SensorFrame | None:
        if stamp_ns < self._done_ns:
            self.late += 1
            return None
        first_ns = self._set_of(camera, stamp_ns)
        self.images[first_ns][camera] = image
        return self._complete(first_ns)

    def add_imu(self, sample: ImuSample) -> SensorFrame | None:
        self.imus[sample.stamp_ns] = sample
        return self._complete(sample.stamp_ns)

    def add_odometry(self, sample: OdometrySample) -> SensorFrame | None:
        self.odometries[sample.stamp_ns] = sample
        return self._complete(sample.stamp_ns)

    def lacks(self) -> str:
        """What the newest incomplete set of pictures lacks, in words; '' when there is none."""
        if not self.images:
            return ''
        stamp_ns = max(self.images, key=lambda stamp: (len(self.images[stamp]), stamp))
        missing = [camera for camera in self.cameras if camera not in self.images[stamp_ns]]
        if missing:
            return f'no picture of {", ".join(missing)} at the stamp of the others'
        silent = [] if self._sample(self.imus, stamp_ns) else ['imu']
        silent += [] if self._sample(self.odometries, stamp_ns) else ['odometry']
        return f'no sample of {", ".join(silent)} at the stamp of the pictures'

    def _set_of(self, camera: str, stamp_ns: int) -> int:
        """Earliest stamp of the set that a picture belongs to, which may be the picture's own."""
        skew_ns = round(self.sync.camera_skew_s * 1e9)
        for first_ns in sorted(self.images) if skew_ns and stamp_ns not in self.images else ():
            earliest, latest = min(first_ns, stamp_ns), max(self._latest_ns[first_ns], stamp_ns)
            if latest - earliest <= skew_ns and camera not in self.images[first_ns]:
                self.images[earliest] = self.images.pop(first_ns)
                self._latest_ns.pop(first_ns)
                self._latest_ns[earliest] = latest
                return earliest
        self.images.setdefault(stamp_ns, {})
        self._latest_ns.setdefault(stamp_ns, stamp_ns)
        return stamp_ns

    def _sample(self, samples: dict[int, Sample], stamp_ns: int) -> Sample | None:
        return sample_at(samples, stamp_ns, round(self.sync.interpolate_age_s * 1e9))

    def _complete(self, stamp_ns: int) -> SensorFrame | None:
        """The frame of a stamp if it is complete; its parts and everything older are then discarded. Where samples are
        interpolated, the one just added may complete an earlier set: then the earliest that is complete."""
        for candidate_ns in sorted(self.images) if self.sync.interpolate_age_s else [stamp_ns]:
            images = self.images.get(candidate_ns)
            if images is None or len(images) < len(self.cameras):
                continue
            imu, odometry = self._sample(self.imus, candidate_ns), self._sample(self.odometries, candidate_ns)
            if imu is not None and odometry is not None:
                self._discard(candidate_ns)
                return SensorFrame(candidate_ns, images, imu, odometry)
        self._bound()
        return None

    def _discard(self, stamp_ns: int) -> None:
        """A frame is complete: forget what will not be needed for a later one."""
        self.last_ns, self._done_ns = stamp_ns, self._latest_ns[stamp_ns]
        self.incomplete += sum(1 for s in self.images if s < stamp_ns)
        self.images = {s: v for s, v in self.images.items() if s > stamp_ns}
        self._latest_ns = {s: v for s, v in self._latest_ns.items() if s > stamp_ns}
        self.imus, self.odometries = self._later(self.imus, stamp_ns), self._later(self.odometries, stamp_ns)

    def _later(self, samples: dict[int, Sample], stamp_ns: int) -> dict[int, Sample]:
        """Samples after a stamp; to interpolate the next frame's, the last one before it is needed too."""
        from_ns = stamp_ns + 1
        if self.sync.interpolate_age_s:
            from_ns = max((stamp for stamp in samples if stamp <= stamp_ns), default=from_ns)
        return {s: v for s, v in samples.items() if s >= from_ns}

    def _bound(self) -> None:
        while len(self.images) > PENDING_LIMIT:
            first_ns = min(self.images)
            del self.images[first_ns], self._latest_ns[first_ns]
            self.incomplete += 1
        for samples in (self.imus, self.odometries):
            while len(samples) > MOTION_LIMIT:
                del samples[min(samples)]
