"""Rollout guidance: losses that align the raw stream's rollout with the privileged one (paper, section 3.3)."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from raw2drive_ros.training.config import TrainConfig
from raw2drive_ros.world_model.distributions import categorical_kl
from raw2drive_ros.world_model.rssm import Rssm, State


@dataclass(slots=True)
class PairedRollout:
    """Posterior states (B, T, ...) of both streams on the same sequences, and their log-probabilities (B, T, S, K)."""

    raw: State
    raw_post: Tensor
    privileged: State
    privileged_post: Tensor


def observe_pair(
    raw: Rssm,
    privileged: Rssm,
    raw_embed: Tensor,
    privileged_embed: Tensor,
    actions: Tensor,
    is_first: Tensor,
    uniform: Tensor,
    source: str = 'raw',
    *,
    raw_uniform: Tensor | None = None,
) -> PairedRollout:
    """Posterior states of both streams, step by step.

    embeddings: (B, T, E*G*G + W). actions: (B, T, A), the action that LED to step t. is_first: (B, T) bool.
    uniform: (B, T, S).

    One stochastic sample per step, drawn from the stream that `source` names, is the sample of both streams; two draws
    would let the two deterministic states drift apart by sampling noise alone. `independent` does draw twice (the
    ablation) and needs `raw_uniform`, (B, T, S), a second set of uniforms for the raw stream. No gradient
    reaches the privileged stream. Raises ValueError for `independent` without uniforms that differ.
    """
    if source == 'independent' and (raw_uniform is None or raw_uniform is uniform):
        raise ValueError('independent sampling needs uniforms of its own for the raw stream')
    batch, length = actions.shape[:2]
    raw_state, privileged_state = raw.initial(batch), privileged.initial(batch)
    raw_hidden = raw.post_embed(raw_embed)
    with torch.no_grad():
        privileged_hidden, privileged_maps = privileged.post_embed(privileged_embed), privileged.plain_maps()
    keep = (~is_first).to(actions.dtype).unsqueeze(-1)
    acted, maps = raw.input_action(actions * keep), raw.maps()
    found: dict[str, list[Tensor]] = {name: [] for name in ('rd', 'rs', 'rp', 'pd', 'ps', 'pp')}
    for t in range(length):
        mask = keep[:, t]
        action = actions[:, t] * mask
        raw_state = State(raw_state.deter * mask, raw_state.stoch * mask)
        raw_deter = raw.next_deter(raw_state, acted[:, t], maps)
        raw_post = raw.posterior(raw_deter, raw_hidden[:, t], maps)
        with torch.no_grad():
            old = State(privileged_state.deter * mask, privileged_state.stoch * mask)
            privileged_deter = privileged.step_deter(old, action, privileged_maps)
            privileged_post = privileged.posterior(privileged_deter, privileged_hidden[:, t])
        if source == 'raw':
            raw_stoch = raw.sample(raw_post, uniform[:, t])
            privileged_stoch = raw_stoch.detach()
        else:
            privileged_stoch = privileged.sample(privileged_post, uniform[:, t])
            raw_stoch = privileged_stoch
            if source == 'independent' and raw_uniform is not None:
                raw_stoch = raw.sample(raw_post, raw_uniform[:, t])
        raw_state = State(raw_deter, raw_stoch)
        privileged_state = State(privileged_deter, privileged_stoch)
        for name, value in zip(
            found,
            (raw_deter, raw_stoch, raw_post, privileged_deter, privileged_stoch, privileged_post),
            strict=True,
        ):
            found[name].append(value)
    s = {name: torch.stack(values, 1) for name, values in found.items()}
    return PairedRollout(State(s['rd'], s['rs']), s['rp'], State(s['pd'], s['ps']), s['pp'])


def guidance_losses(
    pair: PairedRollout,
    raw_grid: Tensor,
    privileged_grid: Tensor,
    raw_vector: Tensor,
    privileged_vector: Tensor,
    config: TrainConfig,
) -> dict[str, Tensor]:
    """The three alignment terms, each (B, T), unweighted.

    grids: (B, T, E, G, G). vectors: (B, T, W), aligned as if they were one more cell. Encoder: squared error summed
    over cells, mean over features. Stochastic: KL(privileged || raw). Deterministic: mean squared error.
    """
    privileged_grid, privileged_vector = privileged_grid.detach(), privileged_vector.detach()
    if config.align_space:
        encoder = (raw_grid - privileged_grid).square().mean(2).sum((-2, -1))
    else:
        encoder = (raw_grid.mean((-2, -1)) - privileged_grid.mean((-2, -1))).square().mean(-1)
    encoder = encoder + (raw_vector - privileged_vector).square().mean(-1)
    if not config.align_time:
        last = torch.zeros_like(encoder)
        last[:, -1] = float(encoder.shape[1])
        encoder = encoder * last
    return {
        'align_encoder': encoder,
        'align_stoch': categorical_kl(pair.privileged_post.detach(), pair.raw_post),
        'align_deter': (pair.raw.deter - pair.privileged.deter.detach()).square().mean(-1),
    }
