"""Every driver behind one interface for the in-process loop: `control(env, frame, tick) -> Decision`."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from pathlib import Path
from typing import Protocol

import numpy as np
import torch

from raw2drive_ros.actions import ACTION_COUNT, ACTIONS, nearest_action
from raw2drive_ros.contract import Control, Decision, SensorFrame
from raw2drive_ros.driving.baselines import RandomDriver, StraightDriver
from raw2drive_ros.driving.driver import Driver
from raw2drive_ros.errors import UnknownDriverError
from raw2drive_ros.evaluation.expert import ExpertDriver
from raw2drive_ros.evaluation.rule_driver import RuleDriver
from raw2drive_ros.evaluation.simple_drivers import IdmMobilDriver, constant_speed
from raw2drive_ros.rates import SUBSTEPS
from raw2drive_ros.settings import default_teacher
from raw2drive_ros.simulation.environment import DrivingEnv, Tick
from raw2drive_ros.simulation.world import World
from raw2drive_ros.world_model.distributions import sample_one_hot
from raw2drive_ros.world_model.mask_codec import MaskCodec
from raw2drive_ros.world_model.rssm import State

DRIVER_NAMES = ('raw', 'privileged', 'expert', 'rule', 'idm', 'constant', 'straight', 'random')


class EpisodeDriver(Protocol):
    """Sees the sensor frame; drivers that are privileged by design may also read the environment."""

    needs_cameras: bool
    needs_bev: bool

    def reset(self, seed: int) -> None:
        """A new episode begins."""

    def control(self, env: DrivingEnv, frame: SensorFrame, tick: Tick) -> Decision:
        """Decide on one tick."""


class SensorDriver:
    """A `driving.Driver`: exactly what the planner node runs."""

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
        return RuleDriver(rng, noise if rng.random() < 0.75 else 0.0).control

    return WorldDriver(make)


def expert_driver(*, coarse: bool = False) -> WorldDriver:
    """The expert; coarse: rehearsing in steps of a decision, which halves its cost and solves as many routes."""
    return WorldDriver(lambda seed: ExpertDriver(SUBSTEPS if coarse else 1).control)


class PrivilegedDriver:
    """The stage-1 policy on BEV masks.

    run: whatever `load_teacher` takes. noise: share of decisions that are sampled instead of the mode.
    """

    needs_cameras, needs_bev = False, True

    def __init__(self, run: Path, noise: float = 0.0) -> None:
        from raw2drive_ros.training.teacher import load_teacher

        trainer = load_teacher(run)
        self.model, self.actor = trainer.model.eval(), trainer.policy.actor.eval()
        self.codec = MaskCodec(trainer.config.model)
        with torch.inference_mode():
            self.maps = self.model.rssm.plain_maps()
        self.noise = noise

    def reset(self, seed: int) -> None:
        self.rng = np.random.default_rng(seed)
        self.sampled = self.noise if self.rng.random() < 0.75 else 0.0
        self.burst = 0
        self.state = self.model.rssm.initial(1)
        self.action = torch.zeros(1, ACTION_COUNT)

    @torch.inference_mode()
    def control(self, env: DrivingEnv, frame: SensorFrame, tick: Tick) -> Decision:
        assert tick.privileged is not None
        deep = self.codec.unpack(self.codec.pack(tick.privileged.bev)[None])
        masks = torch.from_numpy(deep).float()
        grid, vector = self.model.encode(masks, torch.from_numpy(tick.privileged.ego)[None])
        rssm = self.model.rssm
        deter = rssm.step_deter(self.state, self.action, self.maps)
        post = rssm.posterior(deter, rssm.post_embed(self.model.embed(grid, vector)))
        stoch = torch.nn.functional.one_hot(post.argmax(-1), post.shape[-1]).float().flatten(-2)
        self.state = State(deter, stoch)
        log_probs = self.actor(self.state.feature)
        action = int(log_probs.argmax(-1))
        if self.burst == 0 and self.sampled and self.rng.random() < self.sampled:
            self.burst = int(self.rng.integers(1, 8))
            self.random_action = int(self.rng.integers(ACTION_COUNT))
        if self.burst > 0:
            self.burst -= 1
            action = self.random_action
        elif self.sampled:
            uniform = torch.tensor([self.rng.random()], dtype=torch.float32)
            action = int(sample_one_hot(log_probs, uniform).argmax(-1))
        self.action = torch.nn.functional.one_hot(torch.tensor([action]), ACTION_COUNT).float()
        return Decision(frame.stamp_ns, ACTIONS[action], action)


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


def make_driver(
    name: str, bundle: Path | None = None, run: Path | None = None, noise: float = 0.0, threads: int = 1
) -> EpisodeDriver:
    """A driver by name; `privileged` without a run is the shipped teacher.

    Raises UnknownDriverError, BundleError or CheckpointError.
    """
    if name == 'random':
        return SensorDriver(RandomDriver(), cameras=False)
    if name == 'straight':
        return SensorDriver(StraightDriver(), cameras=False)
    if name == 'rule':
        return rule_driver(noise)
    if name in ('idm', 'constant'):
        return WorldDriver(lambda seed: IdmMobilDriver().control if name == 'idm' else constant_speed)
    if name == 'expert':
        return expert_driver()
    if name == 'privileged':
        if run is None and not default_teacher().is_dir():
            raise UnknownDriverError(
                f'driver privileged needs --run: the shipped teacher is not at {default_teacher()}'
            )
        return PrivilegedDriver(run or default_teacher(), noise)
    if name == 'raw':
        from raw2drive_ros.driving.bundle import load_bundle
        from raw2drive_ros.driving.driver import RawDriver

        if bundle is None:
            raise UnknownDriverError('driver raw needs a policy bundle (--bundle)')
        return SensorDriver(RawDriver(load_bundle(bundle), threads), cameras=True)
    raise UnknownDriverError(f'unknown driver {name!r}; known: {", ".join(DRIVER_NAMES)}')
