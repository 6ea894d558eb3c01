"""The stage-1 policy as a driver, on the simulation's BEV masks."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import torch

from raw2drive_ros.contracts.actions import ACTION_COUNT, ACTIONS
from raw2drive_ros.contracts.public import Decision, SensorFrame
from raw2drive_ros.simulation.environment import DrivingEnv, Tick
from raw2drive_ros.world_model.agent import Observation, RecurrentAgent
from raw2drive_ros.world_model.distributions import sample_classes
from raw2drive_ros.world_model.mask_codec import MaskCodec
from raw2drive_ros.world_model.privileged_inputs import masks_of, vector_of
from raw2drive_ros.world_model.teacher import load_teacher

# With noise: the share of episodes that have it; bursts of one random action last less than BURST_TICKS.
NOISY_EPISODES, BURST_TICKS = 0.75, 8


class PrivilegedDriver:
    """run: whatever `load_teacher` takes. noise: chance per tick of a burst of one random action, in `NOISY_EPISODES`
    of the episodes; between bursts, these episodes sample the policy's actions instead of taking the mode."""

    needs_cameras, needs_bev = False, True

    def __init__(self, run: Path, noise: float = 0.0) -> None:
        teacher = load_teacher(run)
        self.agent = RecurrentAgent(teacher.model, teacher.policy.actor)
        self.config, self.codec = teacher.config, MaskCodec(teacher.config)
        self.noise = noise

    def reset(self, seed: int) -> None:
        self.rng = np.random.default_rng(seed)
        self.sampled = self.noise if self.rng.random() < NOISY_EPISODES else 0.0
        self.burst = 0
        self.state = self.agent.initial()

    def control(self, env: DrivingEnv, frame: SensorFrame, tick: Tick) -> Decision:
        assert tick.privileged is not None
        masks = self.codec.unpack(self.codec.pack(masks_of(tick.privileged, self.config))[None])
        vector = torch.from_numpy(vector_of(tick.privileged, self.config))[None]
        observation = Observation(torch.from_numpy(masks).float(), vector)
        choice, self.state = self.agent.step(observation, self.state)
        action = int(choice.action)
        if self.sampled:
            action = self._explored(choice.log_probs)
            self.state = self.state.acted(torch.tensor([action]))
        return Decision(frame.stamp_ns, ACTIONS[action], action)

    def _explored(self, log_probs: torch.Tensor) -> int:
        """The random action of a burst, or a sample of the policy's (1, A) log-probabilities."""
        if self.burst == 0 and self.rng.random() < self.sampled:
            self.burst = int(self.rng.integers(1, BURST_TICKS))
            self.random_action = int(self.rng.integers(ACTION_COUNT))
        if self.burst > 0:
            self.burst -= 1
            return self.random_action
        return int(sample_classes(log_probs, torch.tensor([self.rng.random()], dtype=torch.float32)))
