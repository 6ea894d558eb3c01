"""Turns a continuous driver's commands into the policy's 39 discrete actions, so that a policy can imitate its bags.

The table brakes fully or not at all and steers in steps. Each command becomes the closest action, and the rounding
error is not carried over to the next tick. The action then depends on the current state alone, which a policy can
learn, and the driver corrects the error a tick later because it sees the resulting state.
"""

from __future__ import annotations

import dataclasses

import numpy as np

from raw2drive_ros.contracts.actions import ACTIONS, BRAKE_ACTION
from raw2drive_ros.contracts.privileged import MAX_REASON_CHARACTERS
from raw2drive_ros.contracts.public import Control, Decision, SensorFrame
from raw2drive_ros.contracts.texts import shown
from raw2drive_ros.evaluation.episode_driver import EpisodeDriver
from raw2drive_ros.evaluation.world_drivers import oracle_driver
from raw2drive_ros.simulation.environment import DrivingEnv, Tick
from raw2drive_ros.simulation.world import World

# Actions that drive forward or roll; `table_action` decides on braking first.
ROLLING = [i for i, action in enumerate(ACTIONS) if not action.reverse and not action.brake]
THROTTLE = np.array([ACTIONS[i].throttle for i in ROLLING])
STEER = np.array([ACTIONS[i].steer for i in ROLLING])
# An error of 1 m/s2 costs as much as a steering error of this share of full lock.
STEER_PER_MPS2 = 0.08
# A wanted deceleration above this becomes braking; a smaller one is left to rolling.
BRAKING_MPS2 = 1.2
STANDING_MPS = 0.3
BURST_TICKS = 7
# Of this many ticks in a row an adviser is asked each time.
ASKED_TICKS = 4
# Keys of `Decision.info`: why the driver does it (a text; any driver may say it), an expert's action, and its reason.
REASON, ADVICE, ADVICE_REASON = 'reason', 'advice', 'advice_reason'


def reason_of(decision: Decision) -> str:
    """Why the driver decided so: the rule and whom it minds, one line for people; '' where it does not say."""
    return shown(decision.info.get(REASON, ''))[:MAX_REASON_CHARACTERS]


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
    """Wraps a driver and turns its commands into actions of the table.

    noise: chance per tick of a burst of one random action, in half of the episodes, for bags that show how to recover.
    advises: record the wrapped driver's own action as advice on every tick, also during bursts.
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
        wanted = self.inner.control(env, frame, tick)
        action = advice = table_action(env.world, wanted.control)
        if self.burst == 0 and self.chance and self.rng.random() < self.chance:
            self.burst, self.random_action = int(self.rng.integers(1, BURST_TICKS)), int(self.rng.choice(ROLLING))
        if self.burst > 0:
            self.burst -= 1
            action = self.random_action
        info = wanted.info | ({ADVICE: advice, ADVICE_REASON: reason_of(wanted)} if self.advises else {})
        return Decision(frame.stamp_ns, ACTIONS[action], action, info=info)


def through_table(name: str, driver: EpisodeDriver, noise: float = 0.0) -> TableActionDriver:
    """The driver that `--table` makes of a named one. The expert notes its choice as advice; the oracle plans coarsely."""
    return TableActionDriver(
        oracle_driver(coarse=True) if name == 'oracle' else driver, noise, advises=name == 'expert'
    )


class AdvisedDriver:
    """One driver drives, another one labels the states with the action that it would take there (as in DAgger).

    every: out of this many ticks, the adviser is asked on the first `ASKED_TICKS`. Its cost is planning, and one plan
    holds for those ticks; asking more often adds little, because neighbouring ticks are nearly the same example.
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
        advised = self.adviser.control(env, frame, tick) if asked else None
        decision = self.inner.control(env, frame, tick)
        if advised is None:
            return decision
        advice = {ADVICE: table_action(env.world, advised.control), ADVICE_REASON: reason_of(advised)}
        return dataclasses.replace(decision, info=decision.info | advice)
