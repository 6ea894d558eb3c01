"""How fast the car is, from odometry and from the vehicle's signed status; notices when one of them contradicts."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field

# Two readings of one moment are copies of one value; the rest is rounding of float64.
SAME_MPS = 0.05
# Between two readings of odometry: more than any brake or throttle of a car does.
LARGEST_MPS2 = 30.0
MARGIN_MPS = 2.0
# Odometry that came before the status of its moment; at 20 and 10 Hz it is one or two samples.
EARLY_LIMIT = 20


@dataclass(frozen=True, slots=True)
class Reading:
    """One measured speed (m/s, signed, along x of `base_link`) and its stamp in seconds."""

    stamp_s: float
    speed_mps: float


@dataclass(slots=True)
class SpeedSense:
    """The speed that the gate may rely on: the status's where the vehicle sends one with a speed, else odometry's.

    Odometry cannot be signed (its message has no field for it), so a status overrules it, and without a status two
    publishers are recognised by speeds that jump.
    """

    speed_mps: float | None = None
    _status: Reading | None = None
    _status_before: Reading | None = None
    _odometry: Reading | None = None
    _early: deque[Reading] = field(default_factory=lambda: deque(maxlen=EARLY_LIMIT))

    def forget(self) -> None:
        self.speed_mps = self._status = self._status_before = self._odometry = None
        self._early.clear()

    @property
    def signed(self) -> bool:
        """Whether a status has told the speed."""
        return self._status is not None

    def odometry(self, reading: Reading) -> str:
        """Take a sample of odometry; returns what it contradicts, or ''."""
        if self._status is not None:
            if reading.stamp_s > self._status.stamp_s:
                self._early.append(reading)
                return ''
            return "the vehicle's status" if self._denied(reading) else ''
        before = self._odometry
        if before is not None:
            apart_s, change_mps = abs(reading.stamp_s - before.stamp_s), abs(reading.speed_mps - before.speed_mps)
            if change_mps > (SAME_MPS if apart_s == 0.0 else LARGEST_MPS2 * apart_s + MARGIN_MPS):
                # Which of the two is false is unknown; to believe the faster one is safe.
                faster = before if abs(before.speed_mps) > abs(reading.speed_mps) else reading
                self._odometry, self.speed_mps = faster, faster.speed_mps
                return 'itself'
            if reading.stamp_s < before.stamp_s:
                return ''
        self._odometry, self.speed_mps = reading, reading.speed_mps
        return ''

    def status(self, reading: Reading) -> str:
        """Take the speed of an authenticated status; returns what it contradicts, or ''."""
        if self._status is None or reading.stamp_s > self._status.stamp_s:
            self._status_before, self._status = self._status, reading
        self.speed_mps = reading.speed_mps
        denied = False
        while self._early and self._early[0].stamp_s <= reading.stamp_s:
            denied |= self._denied(self._early.popleft())
        return "the vehicle's status" if denied else ''

    def _denied(self, reading: Reading) -> bool:
        """Whether the status says otherwise: under the same stamp, or before and after it."""
        now, before = self._status, self._status_before
        assert now is not None
        if reading.stamp_s == now.stamp_s:
            return abs(reading.speed_mps - now.speed_mps) > SAME_MPS
        if before is None or reading.stamp_s < before.stamp_s:
            # An old sample: it moves nothing, since the speed is the status's.
            return False
        low, high = sorted((before.speed_mps, now.speed_mps))
        return not low - MARGIN_MPS <= reading.speed_mps <= high + MARGIN_MPS
