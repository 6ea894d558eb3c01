"""Drivers that need no learning. `random` and `straight` are reference scores; neither reads a sensor."""

from __future__ import annotations

import numpy as np

from raw2drive_ros.contracts.actions import ACTION_COUNT, ACTIONS, nearest_action
from raw2drive_ros.contracts.public import Control, Decision, Route, SensorFrame


class RandomDriver:
    """A uniformly random action at every decision."""

    name = 'random'

    def __init__(self, seed: int = 0) -> None:
        self.seed = seed

    def reset(self) -> None:
        self.rng = np.random.default_rng(self.seed)

    def drive(self, frame: SensorFrame, route: Route) -> Decision:
        action = int(self.rng.integers(ACTION_COUNT))
        return Decision(frame.stamp_ns, ACTIONS[action], action)


class StraightDriver:
    """Gentle throttle, wheel straight."""

    name = 'straight'

    def reset(self) -> None:
        """There is no state to reset."""

    def drive(self, frame: SensorFrame, route: Route) -> Decision:
        control = Control(0.3)
        return Decision(frame.stamp_ns, control, nearest_action(control))
