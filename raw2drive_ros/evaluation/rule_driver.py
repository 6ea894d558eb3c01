"""A rule driver that reads the simulator's state: pure pursuit on the route, speed after the reward's v*.

It collects the first bags. Its `noise` mixes in bursts of random actions, so that the world model
also sees what happens off the ideal line.
"""

from __future__ import annotations

import numpy as np

from raw2drive_ros.actions import ACTION_COUNT, ACTIONS
from raw2drive_ros.contract import Control
from raw2drive_ros.evaluation.following import pursuit_steer
from raw2drive_ros.simulation.reward import target_speed_mps
from raw2drive_ros.simulation.world import World

LOOK_AHEAD_S = 0.9


class RuleDriver:
    """control(world) -> Control; keeps only its noise state."""

    def __init__(self, rng: np.random.Generator, noise: float = 0.0) -> None:
        self.rng = rng
        self.noise = noise
        self.burst_left = 0
        self.burst_action = 0
        self.speed_factor = 1.0 if noise == 0.0 else float(rng.uniform(0.5, 1.4))

    def control(self, world: World) -> Control:
        if self.burst_left > 0:
            self.burst_left -= 1
            return ACTIONS[self.burst_action]
        if self.noise and self.rng.random() < self.noise:
            self.burst_left = int(self.rng.integers(0, 8))
            self.burst_action = int(self.rng.integers(ACTION_COUNT - 9))
            if self.rng.random() < 0.03:
                self.burst_action = int(self.rng.integers(ACTION_COUNT))
            return ACTIONS[self.burst_action]
        return self._follow(world)

    def _follow(self, world: World) -> Control:
        speed = max(world.ego.speed, 0.0)
        steer = pursuit_steer(world, LOOK_AHEAD_S)
        target = target_speed_mps(world) * self.speed_factor
        error = target - speed
        if error < -1.5 or target < 0.3:
            return Control(0.0, min(1.0, max(0.3, -error * 0.3)), steer)
        throttle = min(max(0.12 + 0.03 * speed + 0.25 * error, 0.0), 0.8)
        return Control(throttle, 0.0, steer)
