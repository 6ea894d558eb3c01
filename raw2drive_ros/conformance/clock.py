"""The vehicle's time: /clock where it is published, stamps of odometry otherwise; never the probe's own clock."""

from __future__ import annotations

from dataclasses import dataclass

# Between two messages time goes on by itself, but not further than this: a vehicle that is silent has no time.
COAST_S = 0.1
# The pace is known after so much of the probe's time.
PACE_AFTER_S = 1.0


@dataclass(slots=True)
class VehicleClock:
    """wall: seconds of any steady clock of the probe. simulated: whether `stamp` has been called for /clock."""

    newest_ns: int = 0
    newest_wall_s: float = 0.0
    first_ns: int = 0
    first_wall_s: float = 0.0
    simulated: bool = False
    running: bool = False

    def clock(self, stamp_ns: int, wall_s: float) -> None:
        """/clock says `stamp_ns`. From the first one on, stamps of odometry count no more."""
        if not self.simulated:
            self.simulated, self.running = True, False
        self._take(stamp_ns, wall_s)

    def odometry(self, stamp_ns: int, wall_s: float) -> None:
        """A sample of odometry with this stamp has arrived."""
        if not self.simulated:
            self._take(stamp_ns, wall_s)

    def _take(self, stamp_ns: int, wall_s: float) -> None:
        if not self.running:
            self.running, self.first_ns, self.first_wall_s = True, stamp_ns, wall_s
        if stamp_ns != self.newest_ns:
            self.newest_ns, self.newest_wall_s = stamp_ns, wall_s

    def now_ns(self, wall_s: float) -> int:
        """The vehicle's time at `wall_s`."""
        since_s = max(0.0, wall_s - self.newest_wall_s) * min(self.pace, 1.0)
        return self.newest_ns + round(min(since_s, COAST_S) * 1e9)

    @property
    def pace(self) -> float:
        """Seconds of the vehicle's time in a second of the probe's: 1 on a car, less where a simulation is slow."""
        wall_s = self.newest_wall_s - self.first_wall_s
        if wall_s < PACE_AFTER_S:
            return 1.0
        return max((self.newest_ns - self.first_ns) * 1e-9 / wall_s, 1e-3)
