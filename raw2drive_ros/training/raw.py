"""Stage 2: the raw world model under rollout guidance, the raw policy under head guidance (Algorithm 1)."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor

from raw2drive_ros.actions import ACTION_COUNT
from raw2drive_ros.contract import CameraCalibration
from raw2drive_ros.training.config import RunConfig
from raw2drive_ros.training.guidance import PairedRollout, guidance_losses, observe_pair
from raw2drive_ros.training.imagination import (
    choose_starts,
    distillation_loss,
    imagine,
    policy_losses,
    start_noise,
    update_policy,
)
from raw2drive_ros.training.optimiser import Optimiser
from raw2drive_ros.training.parallel import ALONE, Ranks
from raw2drive_ros.training.privileged import EGO_SIZE, PrivilegedTrainer, decoded, dynamics_losses, picked
from raw2drive_ros.training.replay import Batch
from raw2drive_ros.vector_layout import VECTOR_SIZE
from raw2drive_ros.world_model.actor_critic import Policy
from raw2drive_ros.world_model.distributions import mask_loss, symlog
from raw2drive_ros.world_model.streams import RawWorldModel


class RawTrainer:
    """The privileged teacher is frozen here: it is read, never changed."""

    stage = 'raw'

    def __init__(
        self,
        config: RunConfig,
        teacher: PrivilegedTrainer,
        rig: Sequence[CameraCalibration],
        total_steps: int,
        ranks: Ranks = ALONE,
    ) -> None:
        t = config.train
        torch.manual_seed(t.seed)
        self.config, self.total_steps, self.ranks = config, total_steps, ranks
        self.channel_weights = config.channel_weights()
        self.teacher = teacher.model.requires_grad_(False).eval()
        self.teacher_policy = teacher.policy.requires_grad_(False).eval()
        self.model = RawWorldModel(config.model, rig, VECTOR_SIZE, EGO_SIZE, ACTION_COUNT, tuple(t.raw_heads))
        self.model.initialise_from(self.teacher, share=t.share)
        self.policy = Policy(config.model, ACTION_COUNT)
        if t.policy_init != 'fresh':
            self.policy.load_state_dict(self.teacher_policy.state_dict())
        self.generator = torch.Generator().manual_seed(t.seed)
        self.steps = 0
        self.model_optimiser = Optimiser(
            self.model.parameters(), t.model_lr, t.weight_decay, t.model_clip, t.warmup, ranks
        )
        self.policy_optimiser = Optimiser(
            self.policy.parameters(), t.policy_lr, t.weight_decay, t.policy_clip, t.warmup, ranks
        )

    def model_losses(self, batch: Batch) -> tuple[dict[str, Tensor], PairedRollout]:
        """Every loss term by name, each (B, T), `masks` (K,) of the K states decoded; and both streams' states."""
        assert batch.images is not None
        b, t = batch.action.shape[:2]
        with torch.no_grad():
            grid, vector = self.teacher.encode(batch.masks.flatten(0, 1), batch.ego.flatten(0, 1))
            embed = self.teacher.embed(grid, vector).view(b, t, -1)
        raw_grid, raw_vector = self.model.encode(batch.images.flatten(0, 1), batch.vector.flatten(0, 1))
        raw_embed = self.model.embed(raw_grid, raw_vector).view(b, t, -1)
        uniform = self.ranks.rand(b, t, self.config.model.stoch, generator=self.generator)
        pair = observe_pair(
            self.model.rssm,
            self.teacher.rssm,
            raw_embed,
            embed,
            batch.action,
            batch.is_first,
            uniform,
            self.config.train.sample_source,
        )
        prior = self.model.rssm.prior(pair.raw.deter)
        dyn, rep = dynamics_losses(pair.raw_post, prior, self.config.train.free_nats)
        flat = pair.raw.feature.flatten(0, 1)
        shown = decoded(b * t, self.config.train.decode_share, self.ranks, self.generator)
        truth = picked(batch.masks.flatten(0, 1), shown)
        masks = mask_loss(self.model.decoder(flat[shown]), truth, self.channel_weights)
        ego_error = self.model.decoder.ego(flat) - symlog(batch.ego.flatten(0, 1))
        losses = {
            'masks': masks,
            'ego': ego_error.square().sum(-1).view(b, t),
            'dyn': dyn,
            'rep': rep,
        }
        losses |= guidance_losses(
            pair,
            raw_grid.view(b, t, *raw_grid.shape[1:]),
            grid.view(b, t, *grid.shape[1:]),
            raw_vector.view(b, t, -1),
            vector.view(b, t, -1),
            self.config.train,
        )
        if self.model.reward is not None:
            losses['reward'] = self.model.reward.loss(pair.raw.feature, batch.reward)
        if self.model.cont is not None:
            losses['continue'] = self.model.cont.loss(pair.raw.feature, batch.cont)
        return losses, pair

    def weigh(self, losses: dict[str, Tensor]) -> Tensor:
        t = self.config.train
        weights = {
            'masks': t.weight_pred,
            'ego': t.weight_pred,
            'dyn': t.weight_dyn,
            'rep': t.weight_rep,
            'align_encoder': t.weight_encoder,
            'align_stoch': t.weight_stoch,
            'align_deter': t.weight_deter,
        }
        if self.model.reward is not None:
            weights['reward'] = t.weight_reward
        if self.model.cont is not None:
            weights['continue'] = 1.0
        if set(weights) != set(losses):
            raise KeyError(f'losses {sorted(losses)} do not match weights {sorted(weights)}')
        return torch.stack([weights[name] * losses[name].mean() for name in weights]).sum()

    def step(self, batch: Batch, factor: float = 1.0) -> dict[str, float]:
        """One gradient step of each network; factor: of the learning rates."""
        t = self.config.train
        losses, pair = self.model_losses(batch)
        metrics = {f'loss/{name}': float(value.detach().mean()) for name, value in losses.items()}
        metrics['grad/model'] = self.model_optimiser.step(self.weigh(losses), factor)
        self.steps += 1
        if t.policy_init != 'frozen' and self.steps > t.policy_after and self.steps % t.policy_every == 0:
            for _ in range(t.policy_updates):
                metrics |= self.policy_step(pair, batch, factor)
        return metrics

    def distill_weight(self) -> float:
        """Linear from `distill` to `distill_end` over the run."""
        t = self.config.train
        part = min(1.0, self.steps / max(1, self.total_steps))
        return t.distill + (t.distill_end - t.distill) * part

    def policy_step(self, pair: PairedRollout, batch: Batch, factor: float = 1.0) -> dict[str, float]:
        """Actor-critic in the raw model's imagination, judged by the privileged heads in lock-step."""
        t = self.config.train
        start, (guide_deter,) = choose_starts(
            pair.raw, (pair.privileged.deter,), batch.cont, t.starts, self.ranks, self.generator
        )
        own = not t.head_guidance and self.model.reward is not None and self.model.cont is not None
        rollout = imagine(
            self.model.rssm,
            self.policy.actor,
            start,
            (self.model.reward if own and self.model.reward is not None else self.teacher.reward),
            (self.model.cont if own and self.model.cont is not None else self.teacher.cont),
            t.horizon,
            start_noise(t.starts, self.ranks, self.generator),
            (self.teacher.rssm, guide_deter),
            shared_sample=t.sample_source != 'independent',
            own_heads=own,
        )
        actor, critic, metrics = policy_losses(self.policy, rollout, t, self.ranks)
        assert rollout.teacher is not None
        with torch.no_grad():
            wanted = self.teacher_policy.actor(rollout.teacher)
        distill = distillation_loss(wanted, self.policy.actor(rollout.features))
        weight = self.distill_weight()
        metrics |= {'loss/distill': float(distill.detach()), 'policy/distill_weight': weight}
        total = actor + critic + weight * distill
        metrics['grad/policy'] = update_policy(self.policy, self.policy_optimiser, total, t, factor)
        return metrics

    def modules(self) -> dict[str, torch.nn.Module]:
        return {'model': self.model, 'policy': self.policy}

    def optimisers(self) -> dict[str, Optimiser]:
        return {'model': self.model_optimiser, 'policy': self.policy_optimiser}
