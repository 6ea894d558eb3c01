"""Losses that both stages have, and the weighted sum of all losses."""

from __future__ import annotations

import torch
from torch import Tensor

from raw2drive_ros.training.parallel import Ranks
from raw2drive_ros.training.replay import Batch
from raw2drive_ros.world_model.bev_encoder import BevDecoder
from raw2drive_ros.world_model.distributions import categorical_kl, mask_loss, symlog

# The one loss of (M,), because only M of the states are decoded (`decoded_rows`), not of (B, T).
MASKS = 'masks'


def dynamics_losses(post: Tensor, prior: Tensor, free_nats: float) -> tuple[Tensor, Tensor]:
    """(dyn, rep), (B, T) each: KL of (B, T, S, K) log-probabilities, at least `free_nats`.

    dyn trains the prior, with the posterior's gradient stopped; rep trains the posterior, with the prior's stopped.
    """
    dyn = categorical_kl(post.detach(), prior).clamp(min=free_nats)
    rep = categorical_kl(post, prior.detach()).clamp(min=free_nats)
    return dyn, rep


def decoded_rows(count: int, share: float, ranks: Ranks, generator: torch.Generator) -> slice | Tensor:
    """Which of `count` states have their masks decoded: all, or a random share, as the decoder takes the most time."""
    if share >= 1.0:
        return slice(None)
    return ranks.rand(count, generator=generator).argsort()[: max(1, round(share * count))]


def picked(masks: Tensor, rows: slice | Tensor) -> Tensor:
    """Rows of (N, C*P*P, G, G) masks -> (M, C*P*P, G, G), still channels last in memory."""
    return masks.permute(0, 2, 3, 1)[rows].permute(0, 3, 1, 2)


def reconstruction_losses(
    decoder: BevDecoder, feature: Tensor, batch: Batch, rows: slice | Tensor, channel_weights: Tensor
) -> dict[str, Tensor]:
    """masks: (M,) of the M `rows` of B*T states. ego: (B, T).

    feature: (B, T, F). channel_weights: (C*P*P,). The paper prints e_t as the target of L_pred; here it is the
    observation itself, as in DreamerV3.
    """
    b, t = batch.action.shape[:2]
    flat = feature.flatten(0, 1)
    truth = picked(batch.masks.flatten(0, 1), rows)
    ego_error = decoder.ego(flat) - symlog(batch.ego.flatten(0, 1))
    return {
        MASKS: mask_loss(decoder(flat[rows]), truth, channel_weights),
        'ego': ego_error.square().sum(-1).view(b, t),
    }


def weighted_sum(losses: dict[str, Tensor], weights: dict[str, float], batch: int, length: int) -> Tensor:
    """Sum of weight times mean. Every loss has to be (B, T), `MASKS` (M,).

    A missing or unknown name is an error, so that no term is lost by a typo; so is another shape, because a mean over
    an axis too many or too few silently changes a weight. Raises KeyError, ValueError.
    """
    if set(weights) != set(losses):
        raise KeyError(f'losses {sorted(losses)} do not match weights {sorted(weights)}')
    for name, loss in losses.items():
        right = loss.dim() == 1 if name == MASKS else loss.shape == (batch, length)
        if not right:
            wanted = '(M,)' if name == MASKS else f'({batch}, {length})'
            raise ValueError(f'loss {name} has shape {tuple(loss.shape)}, not {wanted}')
    return torch.stack([weights[name] * losses[name].mean() for name in weights]).sum()
