"""Masks in, grid-shaped e_t out, and back: a patch stem instead of full-resolution convolutions.

Masks arrive space-to-depth (C*P*P channels on a G x G grid), so that a 1x1 convolution is the first
and the last layer: on a CPU the full-resolution layers of a usual encoder are most of its cost.
"""

from __future__ import annotations

import torch
from torch import Tensor, nn

from raw2drive_ros.world_model.config import ModelConfig
from raw2drive_ros.world_model.layers import Conv, Dense, Linear, ToCells

EMPTY_LOGIT = -4.0


class Residual(nn.Module):
    """A 3x3 and a 1x1 convolution around a skip; two 3x3 cost nearly twice as much on a CPU.

    depthwise: the 3x3 looks at each feature alone, a fifth of the time.
    """

    def __init__(self, width: int, *, depthwise: bool = False) -> None:
        super().__init__()
        self.first = Conv(width, width, 3, groups=width if depthwise else 1)
        self.second = Conv(width, width, 1)

    def forward(self, x: Tensor) -> Tensor:
        y: Tensor = self.second(nn.functional.silu(self.first(nn.functional.silu(x))))
        return x + y


class BevEncoder(nn.Module):
    """(N, C*P*P, G, G) masks -> e_t (N, E, G, G)."""

    def __init__(self, config: ModelConfig) -> None:
        super().__init__()
        c = config
        channels = len(c.mask_classes) * c.patch * c.patch
        self.stem = Conv(channels, c.encoder_width, 1)
        self.body = Residual(c.encoder_width, depthwise=c.depthwise)
        self.out = Conv(c.encoder_width, c.grid_features, 1)

    def forward(self, masks: Tensor) -> Tensor:
        return torch.tanh(self.out(nn.functional.silu(self.body(self.stem(masks)))))


class BevDecoder(nn.Module):
    """Feature (N, F) -> mask logits (N, C*P*P, G, G) and the ego vector (N, V)."""

    def __init__(self, config: ModelConfig, vector_size: int) -> None:
        super().__init__()
        c = config
        self.grid = c.grid
        # Half of e_t's features per cell: this linear layer is the largest one of the whole model.
        seed_features = c.grid_features // 2
        # A grid latent is where it belongs already; only the deterministic state has to be spread over the cells.
        self.deter, placed, cells = c.feature_size, 0, c.grid**2
        if c.latent == 'grid':
            self.deter, placed = c.deter, c.stoch_size // cells
            self.seed: nn.Module = ToCells(c.deter, c.spread, cells, seed_features)
        else:
            self.seed = Linear(c.feature_size, cells * seed_features)
        self.widen = Conv(seed_features + placed, c.encoder_width, 1)
        self.body = Residual(c.encoder_width, depthwise=c.depthwise)
        self.out = Conv(c.encoder_width, len(c.mask_classes) * c.patch * c.patch, 1)
        # Most pixels of most classes are empty: without this the first hundred steps learn nothing but that.
        assert self.out.bias is not None
        nn.init.constant_(self.out.bias, EMPTY_LOGIT)
        small = c.small_units or c.units
        self.vector = nn.Sequential(Dense(c.feature_size, small), Linear(small, vector_size))

    def forward(self, feature: Tensor) -> Tensor:
        x = nn.functional.silu(self.seed(feature[:, : self.deter])).view(feature.shape[0], -1, self.grid, self.grid)
        if self.deter < feature.shape[1]:
            stoch = feature[:, self.deter :].view(feature.shape[0], self.grid, self.grid, -1).permute(0, 3, 1, 2)
            x = torch.cat([x, stoch], 1)
        # As the masks lie in memory: the loss compares the two element by element.
        x = x.contiguous(memory_format=torch.channels_last)
        return self.out(nn.functional.silu(self.body(self.widen(x))))

    def ego(self, feature: Tensor) -> Tensor:
        return self.vector(feature)
