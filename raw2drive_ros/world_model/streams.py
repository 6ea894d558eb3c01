"""The two world models. Privileged: encoder, RSSM, decoder, reward, continue. Raw: camera encoder, RSSM, decoder.

The raw stream has no reward and no continue head: camera frames that are nearly identical can have very
different rewards, and in the paper's ablation the heads hurt. `raw_heads` switches them on for that ablation.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

import torch
from torch import Tensor, nn

from raw2drive_ros.contracts.public import CameraCalibration
from raw2drive_ros.world_model.actor_critic import Actor
from raw2drive_ros.world_model.bev_encoder import BevDecoder, BevEncoder
from raw2drive_ros.world_model.camera_encoder import CameraEncoder
from raw2drive_ros.world_model.config import ModelConfig
from raw2drive_ros.world_model.distributions import symlog
from raw2drive_ros.world_model.heads import ContinueHead, TwoHotHead
from raw2drive_ros.world_model.layers import Dense
from raw2drive_ros.world_model.rssm import Rssm

Share = Literal['init', 'tied', 'none']


class WorldModel(nn.Module):
    """What both streams have in common: vector encoder, RSSM and BEV decoder. The grid encoder is the stream's own."""

    def __init__(self, config: ModelConfig, encoder: nn.Module, vector_size: int, ego_size: int, actions: int) -> None:
        super().__init__()
        self.config = config
        self.encoder = encoder
        self.vector_encoder = Dense(vector_size, config.vector_features)
        embed = config.grid_features * config.grid**2 + config.vector_features
        self.rssm = Rssm(config, embed, actions)
        self.decoder = BevDecoder(config, ego_size)

    def encode(self, observation: Tensor, vector: Tensor) -> tuple[Tensor, Tensor]:
        """(N, ...) observation and (N, V) vector -> e_t (N, E, G, G) and vector features (N, W)."""
        grid: Tensor = self.encoder(observation)
        return grid, self.vector_encoder(symlog(vector))

    def embed(self, grid: Tensor, vector: Tensor) -> Tensor:
        """The embedding that the posterior reads: (N, E, G, G) and (N, W) -> (N, E*G*G + W)."""
        return torch.cat([grid.flatten(1), vector], -1)


class PrivilegedWorldModel(WorldModel):
    """advised: with a head that predicts the expert's action, so that states keep what this action depends on."""

    def __init__(self, config: ModelConfig, ego_size: int, actions: int, *, advised: bool = False) -> None:
        super().__init__(config, BevEncoder(config), ego_size, ego_size, actions)
        self.reward = TwoHotHead(config, 1)
        self.cont = ContinueHead(config)
        self.advice = Actor(config, actions) if advised else None


class RawWorldModel(WorldModel):
    def __init__(
        self,
        config: ModelConfig,
        cameras: Sequence[CameraCalibration],
        vector_size: int,
        ego_size: int,
        actions: int,
        heads: tuple[str, ...] = (),
    ) -> None:
        super().__init__(config, CameraEncoder(config, cameras), vector_size, ego_size, actions)
        self.reward = TwoHotHead(config, 1) if 'reward' in heads else None
        self.cont = ContinueHead(config) if 'continue' in heads else None

    def encode(self, observation: Tensor, vector: Tensor) -> tuple[Tensor, Tensor]:
        """(N, views, height, width, 3) uint8 images, (N, V) vector -> ê_t (N, E, G, G), vector features (N, W)."""
        grid: Tensor = self.encoder(observation, vector)
        return grid, self.vector_encoder(symlog(vector))

    def initialise_from(
        self, privileged: PrivilegedWorldModel, *, rssm: Share = 'init', decoder: Share = 'init'
    ) -> None:
        """Initialise RSSM and decoder (paper, Fig. 4 and its ablation).

        `init` copies the privileged weights, `tied` uses the privileged (frozen) modules themselves, `none` leaves the
        raw stream's own fresh weights.
        """
        for name, share in (('rssm', rssm), ('decoder', decoder)):
            theirs = getattr(privileged, name)
            if share == 'tied':
                setattr(self, name, theirs)
            elif share == 'init':
                getattr(self, name).load_state_dict(theirs.state_dict())
