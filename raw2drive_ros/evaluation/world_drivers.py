"""Drivers that read the simulator's state; a new one is made for every episode."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from raw2drive_ros.contracts.actions import nearest_action
from raw2drive_ros.contracts.public import Control, Decision, SensorFrame
from raw2drive_ros.evaluation.oracle import OracleDriver
from raw2drive_ros.evaluation.rule_driver import RuleDriver
from raw2drive_ros.evaluation.simple_drivers import IdmMobilDriver, constant_speed
from raw2drive_ros.simulation.environment import DrivingEnv, Tick
from raw2drive_ros.simulation.world import World
from raw2drive_ros.tables.rates import SUBSTEPS

# Share of the episodes of a rule driver with noise that have bursts of random actions.
NOISY_EPISODES = 0.75


class WorldDriver:
    """A driver that reads the simulator's state. make: seed -> a fresh decision function for one episode."""

    needs_cameras = needs_bev = False

    def __init__(self, make: Callable[[int], Callable[[World], Control]]) -> None:
        self.make = make

    def reset(self, seed: int) -> None:
        self.decide = self.make(seed)

    def control(self, env: DrivingEnv, frame: SensorFrame, tick: Tick) -> Decision:
        assert env.world is not None
        control = self.decide(env.world)
        return Decision(frame.stamp_ns, control, nearest_action(control))


def rule_driver(noise: float = 0.0) -> WorldDriver:
    """The rule driver; with noise, three of four episodes have bursts of random actions."""

    def make(seed: int) -> Callable[[World], Control]:
        rng = np.random.default_rng(seed)
        return RuleDriver(rng, noise if rng.random() < NOISY_EPISODES else 0.0).control

    return WorldDriver(make)


def oracle_driver(*, coarse: bool = False) -> WorldDriver:
    """The oracle; coarse: plans are simulated in steps of a decision; half the cost, and no fewer routes are solved."""
    return WorldDriver(lambda seed: OracleDriver(SUBSTEPS if coarse else 1).control)


def idm_driver() -> WorldDriver:
    """IDM and MOBIL, which know their own lane and the next one."""
    return WorldDriver(lambda seed: IdmMobilDriver().control)


def constant_driver() -> WorldDriver:
    """A constant share of the speed limit, whatever is ahead."""
    return WorldDriver(lambda seed: constant_speed)
