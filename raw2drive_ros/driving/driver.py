"""The interface of drivers: whatever decides on sensor frames, learned or not."""

from __future__ import annotations

from typing import Protocol

from raw2drive_ros.contracts.public import Decision, Route, SensorFrame


class Driver(Protocol):
    """Anything that can be evaluated: baselines and learned policies alike."""

    name: str

    def reset(self) -> None:
        """Forget the past: a new episode begins."""

    def drive(self, frame: SensorFrame, route: Route) -> Decision:
        """Decide on one frame; frames come in time order."""
