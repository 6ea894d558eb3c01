"""Small building blocks shared by every network."""

from __future__ import annotations

import itertools

import torch
from torch import Tensor, nn

from raw2drive_ros.world_model.one_hot_indices import OneHotIndices, SparseFeature


class RmsNorm(nn.Module):
    """Root-mean-square norm over the last axis."""

    def __init__(self, size: int) -> None:
        super().__init__()
        self.scale = nn.Parameter(torch.ones(size))

    def forward(self, x: Tensor) -> Tensor:
        return nn.functional.rms_norm(x, (x.shape[-1],), self.scale, 1e-4)


def init_linear(layer: nn.Linear | nn.Conv2d, scale: float = 1.0) -> None:
    """Fill in place: truncated normal of standard deviation scale / sqrt(fan-in), zero bias."""
    fan_in = layer.weight[0].numel()
    std = scale / max(1.0, fan_in) ** 0.5 / 0.87962566103423978
    nn.init.trunc_normal_(layer.weight, 0.0, std or 1e-8, -2 * std, 2 * std)
    if scale == 0.0:
        nn.init.zeros_(layer.weight)
    if layer.bias is not None:
        nn.init.zeros_(layer.bias)


class Linear(nn.Linear):
    """A linear layer that also takes one-hot vectors given by their indices."""

    def __init__(self, inputs: int, outputs: int, scale: float = 1.0) -> None:
        super().__init__(inputs, outputs)
        init_linear(self, scale)

    def forward(self, x: Tensor | OneHotIndices | SparseFeature) -> Tensor:
        return super().forward(x) if isinstance(x, Tensor) else x.through(self.weight, self.bias)


class Conv(nn.Conv2d):
    def __init__(self, inputs: int, outputs: int, kernel: int, stride: int = 1, groups: int = 1) -> None:
        padding = (kernel - stride + 1) // 2 if kernel > 1 else 0
        super().__init__(inputs, outputs, kernel, stride, padding, groups=groups)
        init_linear(self)


class Dense(nn.Module):
    """Linear, norm, SiLU."""

    def __init__(self, inputs: int, outputs: int) -> None:
        super().__init__()
        self.linear = Linear(inputs, outputs)
        self.norm = RmsNorm(outputs)

    def forward(self, x: Tensor) -> Tensor:
        return nn.functional.silu(self.norm(self.linear(x)))


class Mlp(nn.Sequential):
    """`layers` dense layers and a linear output, whose initial scale is `out_scale`."""

    def __init__(self, inputs: int, units: int, layers: int, outputs: int, out_scale: float = 1.0) -> None:
        sizes = [inputs] + [units] * layers
        dense = [Dense(a, b) for a, b in itertools.pairwise(sizes)]
        super().__init__(*dense, Linear(sizes[-1], outputs, out_scale))


class ToCells(nn.Sequential):
    """The deterministic state to features of every grid cell: (..., D) -> (..., G*G*features)."""

    def __init__(self, deter: int, hidden: int, cells: int, features: int) -> None:
        super().__init__(Dense(deter, hidden), Linear(hidden, cells * features))


class BlockLinear(nn.Module):
    """`blocks` independent linear maps, each of one slice of a vector: a block-diagonal linear layer."""

    def __init__(self, blocks: int, inputs: int, outputs: int) -> None:
        super().__init__()
        self.weight = nn.Parameter(torch.empty(blocks, inputs, outputs))
        self.bias = nn.Parameter(torch.zeros(blocks, 1, outputs))
        std = (1.0 / inputs) ** 0.5 / 0.87962566103423978
        nn.init.trunc_normal_(self.weight, 0.0, std, -2 * std, 2 * std)

    def forward(self, x: Tensor) -> Tensor:
        """x: (blocks, N, I) -> (blocks, N, O)."""
        return torch.baddbmm(self.bias, x, self.weight)
