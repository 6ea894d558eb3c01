"""Stage 1: the privileged world model and policy (paper, Algorithm 1, first half)."""

from __future__ import annotations

import math

import torch
from torch import Tensor

from raw2drive_ros.contracts.actions import ACTION_COUNT
from raw2drive_ros.training.config import RunConfig
from raw2drive_ros.training.imagination import choose_starts, imagine, policy_losses, start_noise, update_policy
from raw2drive_ros.training.losses import decoded_rows, dynamics_losses, reconstruction_losses, weighted_sum
from raw2drive_ros.training.optimiser import Optimiser
from raw2drive_ros.training.parallel import ALONE, Ranks
from raw2drive_ros.training.replay import Batch
from raw2drive_ros.world_model.actor_critic import Policy
from raw2drive_ros.world_model.rssm import State
from raw2drive_ros.world_model.streams import PrivilegedWorldModel
from raw2drive_ros.world_model.teacher import Teacher


def demonstrations(states: State, batch: Batch) -> tuple[Tensor, Tensor]:
    """(N, F) features of the posterior states at which the expert was asked, and the (N, A) actions it advised."""
    asked = batch.advice.sum(-1) > 0
    return states.feature.detach()[asked], batch.advice[asked]


class PrivilegedTrainer:
    """Trains world model and policy, each with its own optimiser; `step(batch)` is one gradient step of each."""

    stage = 'privileged'

    def __init__(self, config: RunConfig, ranks: Ranks = ALONE) -> None:
        train = config.train
        torch.manual_seed(train.seed)
        self.config, self.ranks = config, ranks
        self.channel_weights = config.channel_weights()
        advised = train.weight_advice > 0
        self.model = PrivilegedWorldModel(config.model, config.model.ego_size, ACTION_COUNT, advised=advised)
        self.policy = Policy(config.model, ACTION_COUNT)
        self.generator = torch.Generator().manual_seed(train.seed)
        self.steps = 0
        self._make_optimisers()

    def _make_optimisers(self) -> None:
        t = self.config.train
        self.model_optimiser = Optimiser(
            self.model.parameters(), t.model_lr, t.weight_decay, t.model_clip, t.warmup, self.ranks
        )
        self._make_policy_optimiser()

    def _make_policy_optimiser(self) -> None:
        t = self.config.train
        self.policy_optimiser = Optimiser(
            self.policy.parameters(), t.policy_lr, t.weight_decay, t.policy_clip, t.warmup, self.ranks
        )

    def reset_policy(self) -> None:
        """Fresh actor, critic, slow critic, return scale and moments; the world model stays."""
        self.policy = Policy(self.config.model, ACTION_COUNT)
        self._make_policy_optimiser()

    def observe(self, batch: Batch) -> tuple[State, Tensor, Tensor]:
        """Posterior states (B, T, ...) of a batch, their log-probabilities (B, T, S, K), and e_t (B*T, E, G, G)."""
        b, t = batch.action.shape[:2]
        grid, vector = self.model.encode(batch.masks.flatten(0, 1), batch.ego.flatten(0, 1))
        embed = self.model.embed(grid, vector).view(b, t, -1)
        uniform = self.ranks.rand(b, t, self.config.model.stoch, generator=self.generator)
        states, post = self.model.rssm.observe(embed, batch.action, batch.is_first, uniform)
        return states, post, grid

    def filtered(self, batch: Batch) -> State:
        """The posterior states (B, T, ...) of a batch."""
        return self.observe(batch)[0]

    def model_losses(self, batch: Batch) -> tuple[dict[str, Tensor], State]:
        """Every loss term by name, each (B, T), `masks` (M,) of the M states decoded; and the posterior states."""
        t = self.config.train
        states, post, _ = self.observe(batch)
        dyn, rep = dynamics_losses(post, self.model.rssm.prior(states.deter), t.free_nats)
        feature = states.feature
        rows = decoded_rows(batch.action[..., 0].numel(), t.decode_share, self.ranks, self.generator)
        losses = reconstruction_losses(self.model.decoder, feature, batch, rows, self.channel_weights)
        losses |= {
            'reward': self.model.reward.loss(feature, batch.reward),
            'continue': self.model.cont.loss(feature, batch.cont),
            'dyn': dyn,
            'rep': rep,
        }
        if self.model.advice is not None:
            asked = batch.advice.sum(-1)
            # Mean over the states for which the expert was asked.
            share = asked.mean()
            self.ranks.mean_([share])
            losses['advice'] = -(self.model.advice(feature) * batch.advice).sum(-1) / share.clamp(min=1e-6)
        return losses, states

    def weights(self) -> dict[str, float]:
        """The weight of every loss term by name."""
        t = self.config.train
        found = {
            'masks': t.weight_pred,
            'ego': t.weight_pred,
            'reward': t.weight_reward,
            'continue': 1.0,
            'dyn': t.weight_dyn,
            'rep': t.weight_rep,
        }
        return found | ({'advice': t.weight_advice} if self.model.advice is not None else {})

    def step(self, batch: Batch, factor: float = 1.0) -> dict[str, float]:
        """One gradient step of each network. factor: multiplies the learning rates. Returns metrics by name."""
        t = self.config.train
        losses, states = self.model_losses(batch)
        total = weighted_sum(losses, self.weights(), *batch.action.shape[:2])
        metrics = {f'loss/{name}': float(value.detach().mean()) for name, value in losses.items()}
        metrics['grad/model'] = self.model_optimiser.step(total, factor)
        self.steps += 1
        if self.steps == t.reset_policy_at:
            self.reset_policy()
        if self.steps <= t.policy_after:
            return metrics
        shown = demonstrations(states, batch) if t.imitate else None
        if self.steps % t.policy_every == 0:
            for _ in range(t.policy_updates):
                start, _ = choose_starts(states, (), batch.cont, t.starts, self.ranks, self.generator)
                metrics |= self.policy_step(start, factor, shown)
        elif shown is not None and len(shown[0]):
            # Imagination is expensive, imitation is not: it takes place at every step.
            loss, metrics_shown = self.imitation(*shown)
            metrics |= metrics_shown
            metrics['grad/policy'] = self.policy_optimiser.step(t.imitate * loss, factor)
        return metrics

    def imitation(self, features: Tensor, advice: Tensor) -> tuple[Tensor, dict[str, float]]:
        """Cross-entropy of the expert's advice (N, A) at states (N, F)."""
        log_probs = (self.policy.actor(features) * advice).sum(-1)
        loss = -log_probs.mean()
        agreement = float((log_probs.detach() > math.log(0.5)).float().mean())
        return loss, {'loss/imitation': float(loss.detach()), 'policy/agreement': agreement}

    def policy_step(
        self, start: State, factor: float = 1.0, shown: tuple[Tensor, Tensor] | None = None
    ) -> dict[str, float]:
        """One actor-critic update from imagined rollouts. shown: features and actions to imitate in the same step."""
        t = self.config.train
        rollout = imagine(
            self.model.rssm,
            self.policy.actor,
            start,
            self.model.reward,
            self.model.cont,
            t.horizon,
            start_noise(t.starts, self.ranks, self.generator),
        )
        actor, critic, metrics = policy_losses(self.policy, rollout, t, self.ranks)
        total = actor + critic
        if shown is not None and len(shown[0]):
            imitation, metrics_shown = self.imitation(*shown)
            metrics |= metrics_shown
            total = total + t.imitate * imitation
        metrics['grad/policy'] = update_policy(self.policy, self.policy_optimiser, total, t, factor)
        return metrics

    def teacher(self) -> Teacher:
        """The networks without optimisers; the same tensors, not copies."""
        return Teacher(self.config.model, self.model, self.policy, self.config.train.gamma, self.steps)

    def modules(self) -> dict[str, torch.nn.Module]:
        return {'model': self.model, 'policy': self.policy}

    def optimisers(self) -> dict[str, Optimiser]:
        return {'model': self.model_optimiser, 'policy': self.policy_optimiser}
