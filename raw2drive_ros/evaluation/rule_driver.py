"""A rule-based driver that reads the simulator's state: pure pursuit, IDM, a conflict check, signs and lights.

It collects the first bags. `noise` inserts bursts of random actions, so that the bags also cover states away from the
route.
"""

from __future__ import annotations

import math

import numpy as np

from raw2drive_ros.contracts.actions import ACTION_COUNT, ACTIONS
from raw2drive_ros.contracts.public import Control
from raw2drive_ros.evaluation.following import (
    SIGHT_M,
    idm_acceleration,
    leader,
    pedals,
    pursuit_steer,
    route_window,
    stop_line_m,
    stopping,
)
from raw2drive_ros.simulation.world import World

SPEED_SHARE = 0.85
CONFLICT_S, STEP_S = 3.0, 0.25
# Speed that the conflict check assumes for a slower ego, and distance from its centre that others have to keep.
CREEP_MPS = 3.0
CLEAR_M = 2.5


class RuleDriver:
    """`control(world)` returns a `Control`. noise: probability per tick that a burst of random actions begins."""

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
        wanted = SPEED_SHARE * self.speed_factor * world.speed_limit_at(world.route_s_m)
        gap, closing = leader(world, route_window(world))
        acceleration = min(
            idm_acceleration(speed, wanted, gap, closing),
            stopping(speed, stop_line_m(world)),
            stopping(speed, conflict_m(world)),
        )
        return pedals(world, acceleration, pursuit_steer(world))


def conflict_m(world: World) -> float:
    """Distance (m) along the route to the nearest conflict with an actor that keeps speed and heading, or inf."""
    ego = world.ego
    if not len(world.actors):
        return math.inf
    velocity = world.speeds[:-1, None] * np.stack([np.cos(world.headings[:-1]), np.sin(world.headings[:-1])], 1)
    delta = world.positions[:-1] - ego.position
    ahead = delta @ (math.cos(ego.heading), math.sin(ego.heading))
    facing = np.cos(world.headings[:-1] - ego.heading)
    # Actors behind the ego with its heading are followers, which do not matter.
    watched = (world.speeds[:-1] > 0.3) & (np.abs(delta).max(axis=1) < SIGHT_M) & ((ahead > 0.0) | (facing < 0.7))
    if not watched.any():
        return math.inf
    pace = max(ego.speed, CREEP_MPS)
    times = np.arange(0.0, CONFLICT_S, STEP_S)
    stations = world.route_s_m + pace * times
    own = np.array([world.route.pose(float(s))[:2] for s in stations])
    theirs = world.positions[:-1][watched, None] + velocity[watched, None] * times[:, None]
    near = np.hypot(*(theirs - own).transpose(2, 0, 1)) < (world.half_lengths[:-1][watched, None] + CLEAR_M)
    meets = near.any(axis=0)
    if not meets.any():
        return math.inf
    return max(0.0, float(stations[int(np.argmax(meets))] - world.route_s_m) - CLEAR_M)
