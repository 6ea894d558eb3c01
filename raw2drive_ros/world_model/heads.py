"""Reward, continue and value heads."""

from __future__ import annotations

import torch
from torch import Tensor, nn

from raw2drive_ros.world_model.config import ModelConfig
from raw2drive_ros.world_model.distributions import make_bins, two_hot_loss, two_hot_mean
from raw2drive_ros.world_model.layers import Mlp
from raw2drive_ros.world_model.one_hot_indices import Feature


class TwoHotHead(nn.Module):
    """A scalar as a distribution over symexp-spaced bins; the last layer starts at zero, and so does the prediction."""

    bins: Tensor

    def __init__(self, config: ModelConfig, layers: int) -> None:
        super().__init__()
        self.net = Mlp(config.feature_size, config.units, layers, config.bins, out_scale=0.0)
        self.register_buffer('bins', make_bins(config.bins), persistent=False)

    def forward(self, feature: Feature) -> Tensor:
        """(..., F) -> (...) expected value."""
        return two_hot_mean(self.net(feature), self.bins)

    def loss(self, feature: Feature, target: Tensor) -> Tensor:
        """(..., F) features, (...) targets -> (...) cross-entropy."""
        return two_hot_loss(self.net(feature), target, self.bins)


class ContinueHead(nn.Module):
    """Probability that the episode continues: (..., F) -> (...)."""

    def __init__(self, config: ModelConfig) -> None:
        super().__init__()
        self.net = Mlp(config.feature_size, config.small_units or config.units, 1, 1)

    def forward(self, feature: Feature) -> Tensor:
        return torch.sigmoid(self.net(feature).squeeze(-1))

    def loss(self, feature: Feature, target: Tensor) -> Tensor:
        logits = self.net(feature).squeeze(-1)
        return nn.functional.binary_cross_entropy_with_logits(logits, target, reduction='none')
