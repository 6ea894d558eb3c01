"""The interface of drivers of in-process episodes, and the drivers that use only the simulated sensors."""

from __future__ import annotations

import dataclasses
from typing import Protocol

import numpy as np

from raw2drive_ros.contracts.public import Decision, SensorFrame
from raw2drive_ros.driving.baselines import RandomDriver
from raw2drive_ros.driving.driver import Driver
from raw2drive_ros.simulation.environment import DrivingEnv, Tick


class EpisodeDriver(Protocol):
    """Sees the sensor frame; drivers that are privileged by design may also read the environment."""

    needs_cameras: bool
    needs_bev: bool

    def reset(self, seed: int) -> None:
        """A new episode begins."""

    def control(self, env: DrivingEnv, frame: SensorFrame, tick: Tick) -> Decision:
        """Decide on one tick."""


class SensorDriver:
    """Wraps a `driving.driver.Driver`, which is exactly what the planner node runs."""

    needs_bev = False

    def __init__(self, driver: Driver, *, cameras: bool) -> None:
        self.driver = driver
        self.needs_cameras = cameras

    def reset(self, seed: int) -> None:
        if isinstance(self.driver, RandomDriver):
            self.driver.seed = seed
        self.driver.reset()

    def control(self, env: DrivingEnv, frame: SensorFrame, tick: Tick) -> Decision:
        return self.driver.drive(frame, tick.route)


class BlindfoldedDriver:
    """Another driver with every camera blacked out: shows how much of its driving comes from the cameras."""

    def __init__(self, inner: EpisodeDriver) -> None:
        self.inner = inner
        self.needs_cameras, self.needs_bev = inner.needs_cameras, inner.needs_bev

    def reset(self, seed: int) -> None:
        self.inner.reset(seed)

    def control(self, env: DrivingEnv, frame: SensorFrame, tick: Tick) -> Decision:
        dark = {name: np.zeros_like(image) for name, image in frame.images.items()}
        return self.inner.control(env, dataclasses.replace(frame, images=dark), tick)
