"""Actor over the 39 actions, two-hot critic with a slow copy, lambda-returns, return normalisation (DreamerV3)."""

from __future__ import annotations

import copy

import torch
from torch import Tensor, nn

from raw2drive_ros.world_model.config import ModelConfig
from raw2drive_ros.world_model.distributions import mixed_log_probs, two_hot_loss, two_hot_mean
from raw2drive_ros.world_model.heads import TwoHotHead
from raw2drive_ros.world_model.layers import Mlp
from raw2drive_ros.world_model.one_hot_indices import Feature


class Actor(nn.Module):
    def __init__(self, config: ModelConfig, actions: int) -> None:
        super().__init__()
        self.net = Mlp(config.feature_size, config.units, config.head_layers, actions, out_scale=0.01)
        self.unimix, self.actions = config.unimix, actions

    def forward(self, feature: Feature) -> Tensor:
        """(..., F) -> (..., A) log-probabilities."""
        return mixed_log_probs(self.net(feature), self.unimix)


class Critic(nn.Module):
    """A value head that learns (fast) and a moving average of its weights (slow), which regularises it."""

    def __init__(self, config: ModelConfig) -> None:
        super().__init__()
        self.fast = TwoHotHead(config, config.head_layers)
        self.slow = copy.deepcopy(self.fast).requires_grad_(requires_grad=False)

    def forward(self, feature: Feature) -> Tensor:
        value: Tensor = self.fast(feature)
        return value

    def judge(self, feature: Feature) -> tuple[Tensor, Tensor]:
        """Logits (..., L), for `loss`, and values (...) without gradient, of one forward pass."""
        logits: Tensor = self.fast.net(feature)
        return logits, two_hot_mean(logits.detach(), self.fast.bins)

    def loss(self, logits: Tensor, feature: Feature, target: Tensor, slow_weight: float) -> Tensor:
        """(...) cross-entropy with the returns `target`, plus `slow_weight` times that with the slow critic's value."""
        with torch.no_grad():
            slow = self.slow(feature)
        loss = two_hot_loss(logits, target, self.fast.bins)
        return loss + slow_weight * two_hot_loss(logits, slow, self.fast.bins)

    @torch.no_grad()
    def follow(self, rate: float) -> None:
        """Move the slow copy by `rate` towards the fast head."""
        torch._foreach_lerp_(list(self.slow.parameters()), list(self.fast.parameters()), rate)


class ReturnScale(nn.Module):
    """The divisor of advantages: max(1, P95 - P5 of the returns), from moving averages of the two quantiles."""

    low: Tensor
    high: Tensor

    def __init__(self, rate: float = 0.01) -> None:
        super().__init__()
        self.rate = rate
        self.register_buffer('low', torch.zeros(()))
        self.register_buffer('high', torch.zeros(()))

    @staticmethod
    @torch.no_grad()
    def spread(returns: Tensor) -> Tensor:
        """(2,) the 5 % and 95 % quantiles of returns of any shape."""
        return torch.quantile(returns.flatten(), torch.tensor([0.05, 0.95]))

    @torch.no_grad()
    def follow(self, quantiles: Tensor) -> Tensor:
        """Move the averages towards (2,) new quantiles; returns the scale, a scalar."""
        self.low.lerp_(quantiles[0], self.rate)
        self.high.lerp_(quantiles[1], self.rate)
        return (self.high - self.low).clamp(min=1.0)


class Policy(nn.Module):
    """Actor, critic and return scale of one stream."""

    def __init__(self, config: ModelConfig, actions: int) -> None:
        super().__init__()
        self.actor = Actor(config, actions)
        self.critic = Critic(config)
        self.scale = ReturnScale()


def lambda_returns(rewards: Tensor, discounts: Tensor, values: Tensor, lambda_: float) -> Tensor:
    """(H, N) returns of steps 0..H-1.

    rewards, discounts (gamma * continue): (H, N), entry i belongs to ARRIVING at step i+1. values: (H+1, N).
    R_i = r_{i+1} + d_{i+1} ((1 - lambda) v_{i+1} + lambda R_{i+1}), R_H = v_H.
    """
    last = values[-1]
    returns = []
    for i in reversed(range(rewards.shape[0])):
        last = rewards[i] + discounts[i] * ((1.0 - lambda_) * values[i + 1] + lambda_ * last)
        returns.append(last)
    return torch.stack(returns[::-1])
