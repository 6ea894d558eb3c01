"""What the sensors of one simulation frame measured: they report from threads of their own, in any order."""

from __future__ import annotations

import threading
from typing import Any

from raw2drive_ros.errors import SensorTimeoutError


class FrameCollector:
    """names: sensors that have to report every frame. `put` is called by their threads, `take` by ours."""

    def __init__(self, names: tuple[str, ...], timeout_s: float) -> None:
        self.names, self.timeout_s = names, timeout_s
        self._changed = threading.Condition()
        self._found: dict[int, dict[str, Any]] = {}
        self._oldest = 0

    def put(self, name: str, frame: int, measurement: Any) -> None:
        """Measurements of frames that were taken already are dropped."""
        with self._changed:
            if frame >= self._oldest:
                self._found.setdefault(frame, {})[name] = measurement
                self._changed.notify_all()

    def take(self, frame: int) -> dict[str, Any]:
        """All measurements of `frame` by name; forgets older frames. Raises SensorTimeoutError with who is missing."""
        with self._changed:
            complete = self._changed.wait_for(
                lambda: len(self._found.get(frame, ())) == len(self.names), self.timeout_s
            )
            found = self._found.get(frame, {})
            self._oldest = frame + 1
            self._found = {other: kept for other, kept in self._found.items() if other > frame}
        if not complete:
            missing = ', '.join(name for name in self.names if name not in found)
            raise SensorTimeoutError(f'no measurement of frame {frame} within {self.timeout_s:g} s from: {missing}')
        return found
