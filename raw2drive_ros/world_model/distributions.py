"""Categorical latents, two-hot scalars and masks: sampling and losses, without torch.distributions.

Inverse-CDF sampling with one uniform per group replaces the samplers of torch.distributions, which cost
thirty times more on a CPU; it also makes the noise an explicit input, so that two streams can share one
sample (paper, "Rollout Guidance").
"""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor

# Float32 rounds 1 - p to zero for logits above 17; this bounds the loss of a single pixel, but not its gradient.
SMALLEST = 1e-7
# Softmax over a last axis this short is ten times slower than over the axis before it (measured on 32 x 256 x 4).
FEW_CLASSES = 8


def mixed_log_probs(logits: Tensor, unimix: float) -> Tensor:
    """(..., K) logits -> log of (1 - unimix) softmax + unimix / K."""
    if logits.shape[-1] <= FEW_CLASSES:
        probs = torch.softmax(logits.transpose(-1, -2).contiguous(), -2).transpose(-1, -2)
    else:
        probs = torch.softmax(logits, -1)
    return torch.log(probs * (1.0 - unimix) + unimix / logits.shape[-1])


def sample_classes(log_probs: Tensor, uniform: Tensor) -> Tensor:
    """(..., K) log-probabilities and (...) uniforms -> (...) int64: the classes that `sample_one_hot` draws."""
    with torch.no_grad():
        cumulative = torch.cumsum(log_probs.exp(), -1)
        below = cumulative < uniform.unsqueeze(-1) * cumulative[..., -1:]
        return below[..., :-1].sum(-1)


def sample_one_hot(log_probs: Tensor, uniform: Tensor) -> Tensor:
    """(..., K) log-probabilities and (...) uniforms in [0, 1) -> (..., K) one-hot, without gradient."""
    with torch.no_grad():
        cumulative = torch.cumsum(log_probs.exp(), -1)
        # 0 ... 0 1 ... 1, with ones from the drawn class on; the differences of neighbours are the one-hot vector.
        reached = (cumulative >= uniform.unsqueeze(-1) * cumulative[..., -1:]).to(log_probs.dtype)
        reached[..., -1] = 1.0
        one_hot = reached.clone()
        one_hot[..., 1:] -= reached[..., :-1]
        return one_hot.contiguous()


def class_one_hot(chosen: Tensor, classes: int) -> Tensor:
    """(...) int64 classes -> (..., K) float one-hot."""
    return torch.nn.functional.one_hot(chosen, classes).float()


def straight_through(one_hot: Tensor, log_probs: Tensor) -> Tensor:
    """(..., K) with the value of the sample and the gradient of the probabilities (straight-through estimator)."""
    probs = log_probs.exp()
    return one_hot + (probs - probs.detach())


def categorical_kl(left: Tensor, right: Tensor) -> Tensor:
    """KL(left || right) of (..., S, K) log-probabilities, summed over the S groups -> (...)."""
    return (left.exp() * (left - right)).sum((-2, -1))


def symlog(x: Tensor) -> Tensor:
    """sign(x) log(1 + |x|), elementwise: about x near 0, logarithmic far from it (DreamerV3)."""
    return torch.sign(x) * torch.log1p(torch.abs(x))


def symexp(x: Tensor) -> Tensor:
    """sign(x) (exp(|x|) - 1), elementwise: the inverse of `symlog`."""
    return torch.sign(x) * torch.expm1(torch.abs(x))


def make_bins(count: int, limit: float = 20.0) -> Tensor:
    """(L,) bin values, evenly spaced in symlog space from -limit to limit and exactly antisymmetric; count: L, odd."""
    half = symexp(torch.linspace(-limit, 0.0, (count + 1) // 2, dtype=torch.float64))
    return torch.cat([half, -half[:-1].flip(0)]).to(torch.float32)


def two_hot(target: Tensor, bins: Tensor) -> Tensor:
    """(...) values -> (..., L) weights on the two neighbouring bins, linear in the value (not in its symlog)."""
    target = target.clamp(bins[0], bins[-1])
    above = torch.searchsorted(bins, target.contiguous(), right=True).clamp(1, len(bins) - 1)
    low, high = bins[above - 1], bins[above]
    weight = ((target - low) / (high - low)).unsqueeze(-1)
    result = torch.zeros(*target.shape, len(bins), dtype=target.dtype, device=target.device)
    result.scatter_(-1, (above - 1).unsqueeze(-1), 1.0 - weight)
    return result.scatter_add_(-1, above.unsqueeze(-1), weight)


def two_hot_mean(logits: Tensor, bins: Tensor) -> Tensor:
    """(..., L) logits -> (...) expected value.

    Opposite bins are added in pairs, smallest first, so that equal logits give exactly 0.
    """
    probs = torch.softmax(logits, -1)
    middle = len(bins) // 2
    left = (probs[..., :middle] * bins[:middle]).flip(-1)
    right = probs[..., middle + 1 :] * bins[middle + 1 :]
    return (left + right).sum(-1)


def two_hot_loss(logits: Tensor, target: Tensor, bins: Tensor) -> Tensor:
    """Cross-entropy of (..., L) logits with two-hot (...) targets -> (...)."""
    return -(two_hot(target, bins) * torch.log_softmax(logits, -1)).sum(-1)


def mask_loss(logits: Tensor, masks: Tensor, weights: Tensor | None = None) -> Tensor:
    """Binary cross-entropy of (N, C*P*P, G, G) logits with 0/1 masks, summed to (N,); weights: (C*P*P,)."""
    return _MaskLoss.apply(logits, masks, weights)


class _MaskLoss(torch.autograd.Function):
    """Binary cross-entropy that computes its gradient, sigmoid(x) - y, in the forward pass: autograd would pass over
    these tensors, the largest of a step, three times more often."""

    @staticmethod
    def forward(ctx: Any, logits: Tensor, masks: Tensor, weights: Tensor | None) -> Tensor:
        probability = torch.sigmoid(logits)
        # Probability of the true value: p where y is 1, 1 - p where it is 0.
        right = (probability + masks).sub_(1.0).abs_().clamp_(min=SMALLEST)
        slope, right = probability.sub_(masks), right.log_()
        if weights is not None:
            per_channel = weights.view(1, -1, *[1] * (right.dim() - 2))
            slope, right = slope.mul_(per_channel), right.mul_(per_channel)
        ctx.save_for_backward(slope)
        return right.sum(tuple(range(1, right.dim()))).neg_()

    @staticmethod
    def backward(ctx: Any, gradient: Tensor) -> tuple[Tensor, None, None]:
        (slope,) = ctx.saved_tensors
        return slope * gradient.view(-1, *[1] * (slope.dim() - 1)), None, None
