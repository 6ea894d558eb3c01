"""A continuous driver made to speak the policy's 39 actions, so that what it did can be learnt from its bags.

The table brakes fully or not at all and steers in steps. Rounding each command would lose every gentle braking; here
what a tick's action gave too much or too little is owed to the next one, so that a few ticks do what was asked.
"""

from __future__ import annotations

import numpy as np

from raw2drive_ros.actions import ACTIONS, BRAKE_ACTION
from raw2drive_ros.contract import Control, Decision, SensorFrame
from raw2drive_ros.evaluation.drivers import EpisodeDriver
from raw2drive_ros.simulation.environment import DrivingEnv, Tick
from raw2drive_ros.simulation.world import World

FORWARD = [i for i, action in enumerate(ACTIONS) if not action.reverse]
THROTTLE = np.array([ACTIONS[i].throttle for i in FORWARD])
BRAKE = np.array([ACTIONS[i].brake for i in FORWARD])
STEER = np.array([ACTIONS[i].steer for i in FORWARD])
# 1 m/s2 too much weighs as much as this share of full lock.
STEER_PER_MPS2 = 0.08
LEAK = 0.85
OWED_MPS2, OWED_STEER = 4.0, 0.4
STANDING_MPS = 0.3
BURST_TICKS = 7


class TableActions:
    """Another driver, its commands turned into actions of the table.

    noise: chance per tick of a burst of one random action, in half of the episodes, for bags that show how to recover.
    """

    def __init__(self, inner: EpisodeDriver, noise: float = 0.0) -> None:
        self.inner, self.noise = inner, noise
        self.needs_cameras, self.needs_bev = inner.needs_cameras, inner.needs_bev

    def reset(self, seed: int) -> None:
        self.inner.reset(seed)
        self.rng = np.random.default_rng(seed)
        self.chance = self.noise if self.rng.random() < 0.5 else 0.0
        self.burst, self.random_action = 0, BRAKE_ACTION
        self.owed_mps2 = self.owed_steer = 0.0

    def control(self, env: DrivingEnv, frame: SensorFrame, tick: Tick) -> Decision:
        assert env.world is not None
        wanted = self.inner.control(env, frame, tick).control
        if self.burst == 0 and self.chance and self.rng.random() < self.chance:
            self.burst, self.random_action = int(self.rng.integers(1, BURST_TICKS)), int(self.rng.choice(FORWARD))
        if self.burst > 0:
            self.burst -= 1
            action = self.random_action
        else:
            action = self.choose(env.world, wanted)
        return Decision(frame.stamp_ns, ACTIONS[action], action)

    def choose(self, world: World, wanted: Control) -> int:
        """Index of the action that, with what is owed, comes closest to `wanted`."""
        p, speed = world.ego.parameters, max(world.ego.speed, 0.0)
        if wanted.brake > 0.0 and speed < STANDING_MPS:
            self.owed_mps2 = self.owed_steer = 0.0
            return BRAKE_ACTION
        strength = min(p.drive_acceleration_mps2, p.drive_power_mps3 / max(speed, 1e-6))
        gives = THROTTLE * strength - BRAKE * p.brake_deceleration_mps2
        asked = wanted.throttle * strength - wanted.brake * p.brake_deceleration_mps2 + self.owed_mps2
        steer = wanted.steer + self.owed_steer
        cost = np.square((gives - asked) * STEER_PER_MPS2) + np.square(STEER - steer)
        best = int(np.argmin(cost))
        self.owed_mps2 = float(np.clip(LEAK * (asked - gives[best]), -OWED_MPS2, OWED_MPS2))
        self.owed_steer = float(np.clip(LEAK * (steer - STEER[best]), -OWED_STEER, OWED_STEER))
        return FORWARD[best]
