"""Imagined rollouts and the actor-critic update, for one stream or for two in lock-step.

Timeline of a rollout of H steps; tensors are (H+1, N, ...) or (H, N, ...):

    state    s0      s1      ...  sH        s0: posterior states of real sequences
    action   a0      a1      ...            a_i ~ actor(s_i)
    reward           r1      ...  rH        of arriving at s_{i+1}
    cont             c1      ...  cH
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from dataclasses import dataclass

import torch
from torch import Tensor

from raw2drive_ros.training.config import TrainConfig
from raw2drive_ros.training.optimiser import Optimiser
from raw2drive_ros.training.parallel import ALONE, Ranks
from raw2drive_ros.world_model.actor_critic import Actor, Policy, lambda_returns
from raw2drive_ros.world_model.distributions import sample_one_hot
from raw2drive_ros.world_model.heads import ContinueHead, TwoHotHead
from raw2drive_ros.world_model.one_hot_indices import Feature, stack
from raw2drive_ros.world_model.rssm import Rssm, State


@dataclass(slots=True)
class Rollout:
    """features: (H+1, N, F) of the stream that acts. teacher: the same of the privileged stream, or None.
    actions: (H, N, A) one-hot. rewards, conts: (H, N)."""

    features: Feature
    teacher: Feature | None
    actions: Tensor
    rewards: Tensor
    conts: Tensor


Noise = Callable[[int, int], Tensor]


def start_noise(starts: int, ranks: Ranks, generator: torch.Generator) -> Noise:
    """noise(rows, width) -> (rows, width) uniforms in [0, 1).

    At least `starts` rows are drawn, however few are needed, so that the generators of all processes stay equal.
    """
    return lambda rows, width: ranks.rand(max(starts, rows), width, generator=generator)[:rows]


@torch.no_grad()
def imagine(
    rssm: Rssm,
    actor: Actor,
    start: State,
    reward: TwoHotHead,
    cont: ContinueHead,
    horizon: int,
    noise: Noise,
    guide: tuple[Rssm, Tensor] | None = None,
    *,
    shared_sample: bool = True,
    own_heads: bool = False,
) -> Rollout:
    """Roll the actor out in its own world model.

    start: states (N, ...). noise: see `start_noise`.
    guide: the privileged RSSM and its (N, D) deterministic state. It then runs in lock-step on the same
    actions and the same stochastic sample (paper, "Head Guidance"), and `reward` and `cont` read the
    privileged features; without a guide, or with `own_heads`, they read those of the actor's own world model.
    """
    state, maps = rssm.sparse(start), rssm.plain_maps()
    teacher = guide_maps = None
    features: list[Feature] = [state.feature]
    teachers: list[Feature] = []
    actions: list[Tensor] = []
    if guide is not None:
        teacher, guide_maps = dataclasses.replace(state, deter=guide[1]), guide[0].plain_maps()
        teachers.append(teacher.feature)
    groups = rssm.config.stoch
    for _ in range(horizon):
        uniform = noise(len(state.deter), groups + 1)
        action = sample_one_hot(actor(state.feature), uniform[:, -1])
        state = rssm.imagine(rssm.step_deter(state, action, maps), uniform[:, :-1])
        if guide is not None and teacher is not None:
            teacher_deter = guide[0].step_deter(teacher, action, guide_maps)
            if shared_sample:
                teacher = dataclasses.replace(state, deter=teacher_deter)
            else:
                teacher = guide[0].imagine(teacher_deter, noise(len(state.deter), groups))
            teachers.append(teacher.feature)
        features.append(state.feature)
        actions.append(action)
    stacked = stack(features)
    guided = stack(teachers) if teachers else None
    judged = stacked if guided is None or own_heads else guided
    return Rollout(stacked, guided, torch.stack(actions), reward(judged[1:]), cont(judged[1:]))


def policy_losses(
    policy: Policy, rollout: Rollout, config: TrainConfig, ranks: Ranks = ALONE
) -> tuple[Tensor, Tensor, dict[str, float]]:
    """(actor loss, critic loss, metrics) of one rollout; gradients reach the policy only."""
    features = rollout.features
    logits, judged = policy.critic.judge(features[:-1])
    with torch.no_grad():
        values = torch.cat([judged, policy.critic(features[-1:])])
        discounts = config.gamma * rollout.conts
        returns = lambda_returns(rollout.rewards, discounts, values, config.lambda_)
        spread = policy.scale.spread(returns)
        ranks.mean_([spread])
        scale = policy.scale.follow(spread)
        advantage = (returns - values[:-1]) / scale
        alive = torch.cat([torch.ones_like(discounts[:1]), discounts[:-1]])
        weight = torch.cumprod(alive, 0)
    log_probs = policy.actor(features[:-1])
    taken = (log_probs * rollout.actions).sum(-1)
    entropy = -(log_probs.exp() * log_probs).sum(-1)
    # The paper prints "+ eta H" inside a loss; the entropy is to be maximised, hence the minus here.
    actor_loss = -(weight * (advantage * taken + config.entropy * entropy)).mean()
    critic_loss = (weight * policy.critic.loss(logits, features[:-1], returns, config.slow_weight)).mean()
    metrics = {
        'policy/return': float(returns.mean()),
        'policy/value': float(values.mean()),
        'policy/reward': float(rollout.rewards.mean()),
        'policy/continue': float(rollout.conts.mean()),
        'policy/entropy': float(entropy.detach().mean()),
        'policy/scale': float(scale),
        'policy/advantage_std': float(advantage.std()),
        'loss/actor': float(actor_loss.detach()),
        'loss/critic': float(critic_loss.detach()),
    }
    return actor_loss, critic_loss, metrics


def distillation_loss(teacher: Tensor, student: Tensor) -> Tensor:
    """KL(teacher || student) of (..., A) log-probabilities, mean over everything but A."""
    return (teacher.exp() * (teacher - student)).sum(-1).mean()


def choose_starts(
    states: State, extra: tuple[Tensor, ...], cont: Tensor, count: int, ranks: Ranks, generator: torch.Generator
) -> tuple[State, tuple[Tensor, ...]]:
    """Up to `count` random states, (N, ...) and detached, of the (B, T, ...) that do not end an episode.

    cont: (B, T). extra: tensors (B, T, ...), of which the same rows are taken.
    """
    flat = State(states.deter.detach().flatten(0, 1), states.stoch.detach().flatten(0, 1))
    living = cont.flatten() > 0.5
    order = ranks.rand(len(living), generator=generator).masked_fill(~living, 2.0).argsort()
    pick = order[: min(count, int(living.sum()))]
    chosen = State(flat.deter[pick], flat.stoch[pick])
    return chosen, tuple(e.detach().flatten(0, 1)[pick] for e in extra)


def update_policy(policy: Policy, optimiser: Optimiser, loss: Tensor, config: TrainConfig, factor: float) -> float:
    """One optimiser step and one slow-critic step; returns the gradient norm."""
    norm = optimiser.step(loss, factor)
    policy.critic.follow(config.slow_rate)
    return norm
