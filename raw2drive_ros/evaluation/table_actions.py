"""A continuous driver made to speak the policy's 39 actions, so that what it did can be learnt from its bags.

The table brakes fully or not at all and steers in steps. Each command becomes the action that comes closest now, and
nothing is owed to the next tick: the action is a function of what the driver wants in the state that it is in, which a
policy can learn, and the state itself asks for the rest a tick later.
"""

from __future__ import annotations

import dataclasses

import numpy as np

from raw2drive_ros.actions import ACTIONS, BRAKE_ACTION
from raw2drive_ros.contract import Control, Decision, SensorFrame
from raw2drive_ros.evaluation.episode_driver import EpisodeDriver
from raw2drive_ros.evaluation.expert import REPLAN_TICKS
from raw2drive_ros.evaluation.world_drivers import expert_driver
from raw2drive_ros.simulation.environment import DrivingEnv, Tick
from raw2drive_ros.simulation.world import World

# Actions that drive forward or roll; braking is decided on before.
ROLLING = [i for i, action in enumerate(ACTIONS) if not action.reverse and not action.brake]
THROTTLE = np.array([ACTIONS[i].throttle for i in ROLLING])
STEER = np.array([ACTIONS[i].steer for i in ROLLING])
# 1 m/s2 too much weighs as much as this share of full lock.
STEER_PER_MPS2 = 0.08
# Who wants to slow down by more than this brakes; less is left to rolling.
BRAKING_MPS2 = 1.2
STANDING_MPS = 0.3
BURST_TICKS = 7
ASKED_TICKS = REPLAN_TICKS


def table_action(world: World, wanted: Control) -> int:
    """Index of the table's action that comes closest to a continuous command in this state."""
    p, speed = world.ego.parameters, max(world.ego.speed, 0.0)
    braking = wanted.brake * p.brake_deceleration_mps2
    if wanted.brake > 0.0 and (speed < STANDING_MPS or braking > BRAKING_MPS2):
        return BRAKE_ACTION
    strength = min(p.drive_acceleration_mps2, p.drive_power_mps3 / max(speed, 1e-6))
    miss = (THROTTLE - wanted.throttle) * strength + braking
    cost = np.square(miss * STEER_PER_MPS2) + np.square(STEER - wanted.steer)
    return ROLLING[int(np.argmin(cost))]


class TableActionDriver:
    """Another driver, its commands turned into actions of the table.

    noise: chance per tick of a burst of one random action, in half of the episodes, for bags that show how to recover.
    advises: note what the driver itself wanted as advice, bursts or not.
    """

    def __init__(self, inner: EpisodeDriver, noise: float = 0.0, *, advises: bool = False) -> None:
        self.inner, self.noise, self.advises = inner, noise, advises
        self.needs_cameras, self.needs_bev = inner.needs_cameras, inner.needs_bev

    def reset(self, seed: int) -> None:
        self.inner.reset(seed)
        self.rng = np.random.default_rng(seed)
        self.chance = self.noise if self.rng.random() < 0.5 else 0.0
        self.burst, self.random_action = 0, BRAKE_ACTION

    def control(self, env: DrivingEnv, frame: SensorFrame, tick: Tick) -> Decision:
        assert env.world is not None
        action = advice = table_action(env.world, self.inner.control(env, frame, tick).control)
        if self.burst == 0 and self.chance and self.rng.random() < self.chance:
            self.burst, self.random_action = int(self.rng.integers(1, BURST_TICKS)), int(self.rng.choice(ROLLING))
        if self.burst > 0:
            self.burst -= 1
            action = self.random_action
        return Decision(frame.stamp_ns, ACTIONS[action], action, info={'advice': advice} if self.advises else {})


def through_table(name: str, driver: EpisodeDriver, noise: float = 0.0) -> TableActionDriver:
    """A driver by its name as `--table` makes it: the expert rehearses coarsely and its bags hold what it wanted."""
    is_expert = name == 'expert'
    return TableActionDriver(expert_driver(coarse=True) if is_expert else driver, noise, advises=is_expert)


class AdvisedDriver:
    """A driver with another one beside it, who says what it would do in that state (as DAgger asks).

    every: the adviser is asked at `ASKED_TICKS` ticks in a row out of so many. Planning is what it costs, a plan holds
    for those ticks, and neighbouring ticks teach nearly the same.
    """

    def __init__(self, inner: EpisodeDriver, adviser: EpisodeDriver, every: int = ASKED_TICKS) -> None:
        if every < ASKED_TICKS:
            raise ValueError(f'an adviser is asked {ASKED_TICKS} times in a row: every {every} ticks is too often')
        self.inner, self.adviser, self.every = inner, adviser, every
        self.needs_cameras, self.needs_bev = inner.needs_cameras, inner.needs_bev

    def reset(self, seed: int) -> None:
        self.inner.reset(seed)
        self.adviser.reset(seed)
        self.ticks = 0

    def control(self, env: DrivingEnv, frame: SensorFrame, tick: Tick) -> Decision:
        assert env.world is not None
        asked = self.ticks % self.every < ASKED_TICKS
        self.ticks += 1
        advice = table_action(env.world, self.adviser.control(env, frame, tick).control) if asked else -1
        decision = self.inner.control(env, frame, tick)
        return dataclasses.replace(decision, info=decision.info | {'advice': advice}) if asked else decision
