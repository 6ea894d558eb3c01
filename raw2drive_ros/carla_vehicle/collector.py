"""Collects the measurements of one simulation frame; CARLA's sensors report from their own threads, in any order."""

from __future__ import annotations

import threading
from typing import Any

from raw2drive_ros.contracts.errors import SensorTimeoutError


class FrameCollector:
    """names: the sensors that report in every frame. Their threads call `put`, the main thread calls `take`."""

    def __init__(self, names: tuple[str, ...], timeout_s: float) -> None:
        self.names, self.timeout_s = names, timeout_s
        self._changed = threading.Condition()
        self._found: dict[int, dict[str, Any]] = {}
        self._oldest = 0

    def put(self, name: str, frame: int, measurement: Any) -> None:
        """Add a measurement; dropped if its frame was taken already."""
        with self._changed:
            if frame >= self._oldest:
                self._found.setdefault(frame, {})[name] = measurement
                self._changed.notify_all()

    def take(self, frame: int) -> dict[str, Any]:
        """All measurements of `frame` by name; drops older frames. Raises SensorTimeoutError if sensors are missing."""
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
