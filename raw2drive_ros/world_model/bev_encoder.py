"""BEV masks to the grid-shaped embedding e_t, and features back to masks, without full-resolution convolutions.

Masks come space-to-depth (C*P*P channels on a G x G grid), so that the first and the last layer are 1x1
convolutions: on a CPU the full-resolution layers of a usual encoder are most of its cost.
"""

from __future__ import annotations

import torch
from torch import Tensor, nn

from raw2drive_ros.world_model.config import ModelConfig
from raw2drive_ros.world_model.layers import Conv, Dense, Linear, ToCells

EMPTY_LOGIT = -4.0


class Residual(nn.Module):
    """A residual block of a 3x3 and a 1x1 convolution; two 3x3 ones cost nearly twice as much on a CPU.

    depthwise: the 3x3 convolution treats each feature separately, in a fifth of the time.
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
    """Feature (N, F) -> mask logits (N, C*P*P, G, G); `ego`: the privileged vector (N, V) in symlog space."""

    def __init__(self, config: ModelConfig, vector_size: int) -> None:
        super().__init__()
        c = config
        self.grid = c.grid
        # Half of e_t's features per cell: the linear layer that makes them is the largest one of the whole model.
        seed_features = c.grid_features // 2
        # The categoricals of a grid latent belong to cells already; only the deterministic state has to be spread.
        self.deter, placed, cells = c.feature_size, 0, c.grid**2
        if c.latent == 'grid':
            self.deter, placed = c.deter, c.stoch_size // cells
            self.seed: nn.Module = ToCells(c.deter, c.spread, cells, seed_features)
        else:
            self.seed = Linear(c.feature_size, cells * seed_features)
        self.widen = Conv(seed_features + placed, c.encoder_width, 1)
        self.body = Residual(c.encoder_width, depthwise=c.depthwise)
        self.out = Conv(c.encoder_width, len(c.mask_classes) * c.patch * c.patch, 1)
        # Most pixels of most classes are empty: without this bias the first hundred steps learn nothing but that.
        assert self.out.bias is not None
        nn.init.constant_(self.out.bias, EMPTY_LOGIT)
        small = c.small_units or c.units
        self.vector = nn.Sequential(Dense(c.feature_size, small), Linear(small, vector_size))

    def forward(self, feature: Tensor) -> Tensor:
        x = nn.functional.silu(self.seed(feature[:, : self.deter])).view(feature.shape[0], -1, self.grid, self.grid)
        if self.deter < feature.shape[1]:
            stoch = feature[:, self.deter :].view(feature.shape[0], self.grid, self.grid, -1).permute(0, 3, 1, 2)
            x = torch.cat([x, stoch], 1)
        # The memory layout of the masks, which the loss compares with the logits element by element.
        x = x.contiguous(memory_format=torch.channels_last)
        return self.out(nn.functional.silu(self.body(self.widen(x))))

    def ego(self, feature: Tensor) -> Tensor:
        return self.vector(feature)
