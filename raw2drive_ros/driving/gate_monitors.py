"""Monitors of a sequence of steering commands: oscillation, and saturation at full lock."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field


@dataclass(slots=True)
class Oscillation:
    """Steering that swings by at least `swing` one way and back, `turns` times within `window_s`."""

    swing: float
    turns: int
    window_s: float
    times: deque[float] = field(default_factory=deque)
    low: float = 0.0
    high: float = 0.0
    rising: bool | None = None

    def see(self, steer: float, now_s: float) -> bool:
        """Add a command; whether there were too many swings in the last `window_s`."""
        self.low, self.high = min(self.low, steer), max(self.high, steer)
        if self.rising is not False and self.high - steer >= self.swing:
            self._turn(steer, now_s, rising=False)
        elif self.rising is not True and steer - self.low >= self.swing:
            self._turn(steer, now_s, rising=True)
        while self.times and now_s - self.times[0] > self.window_s:
            self.times.popleft()
        return len(self.times) >= self.turns

    def _turn(self, steer: float, now_s: float, *, rising: bool) -> None:
        self.rising, self.low, self.high = rising, steer, steer
        self.times.append(now_s)

    def reset(self) -> None:
        self.times.clear()
        self.low = self.high = 0.0
        self.rising = None


@dataclass(slots=True)
class Saturation:
    """The wheel held at full lock for longer than `after_s`."""

    after_s: float
    full: float = 0.999
    since_s: float | None = None

    def see(self, steer: float, now_s: float) -> bool:
        if abs(steer) < self.full:
            self.since_s = None
            return False
        if self.since_s is None:
            self.since_s = now_s
        return now_s - self.since_s > self.after_s

    def reset(self) -> None:
        self.since_s = None
