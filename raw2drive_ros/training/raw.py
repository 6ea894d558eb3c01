"""Stage 2: the raw world model under rollout guidance, the raw policy under head guidance (Algorithm 1)."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor

from raw2drive_ros.contracts.actions import ACTION_COUNT
from raw2drive_ros.contracts.public import CameraCalibration
from raw2drive_ros.tables.vector_layout import VECTOR_SIZE
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
from raw2drive_ros.training.losses import decoded_rows, dynamics_losses, reconstruction_losses, weighted_sum
from raw2drive_ros.training.optimiser import Optimiser
from raw2drive_ros.training.parallel import ALONE, Ranks
from raw2drive_ros.training.replay import Batch
from raw2drive_ros.world_model.actor_critic import Policy
from raw2drive_ros.world_model.rssm import State
from raw2drive_ros.world_model.streams import RawWorldModel
from raw2drive_ros.world_model.teacher import Teacher


class RawTrainer:
    """Trains the raw world model and policy with the help of the privileged teacher, which is frozen."""

    stage = 'raw'

    def __init__(
        self,
        config: RunConfig,
        teacher: Teacher,
        rig: Sequence[CameraCalibration],
        total_steps: int,
        ranks: Ranks = ALONE,
    ) -> None:
        t = config.train
        torch.manual_seed(t.seed)
        self.config, self.total_steps, self.ranks = config, total_steps, ranks
        self.channel_weights = config.channel_weights()
        self.teacher = teacher.model.requires_grad_(requires_grad=False).eval()
        self.teacher_policy = teacher.policy.requires_grad_(requires_grad=False).eval()
        self.model = RawWorldModel(
            config.model, rig, VECTOR_SIZE, config.model.ego_size, ACTION_COUNT, tuple(t.raw_heads)
        )
        self.model.initialise_from(self.teacher, rssm=t.share_rssm, decoder=t.share_decoder)
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

    def observe(self, batch: Batch) -> tuple[PairedRollout, tuple[Tensor, Tensor], tuple[Tensor, Tensor]]:
        """Posterior states of a batch in both streams; then e_t (B*T, E, G, G) and vector features (B*T, W), of the raw
        and of the privileged encoder. Raises ValueError for a batch without images."""
        if batch.images is None:
            raise ValueError('stage 2 needs batches with images')
        b, t = batch.action.shape[:2]
        with torch.no_grad():
            truth = self.teacher.encode(batch.masks.flatten(0, 1), batch.ego.flatten(0, 1))
            embed = self.teacher.embed(*truth).view(b, t, -1)
        seen = self.model.encode(batch.images.flatten(0, 1), batch.vector.flatten(0, 1))
        raw_embed = self.model.embed(*seen).view(b, t, -1)
        source = self.config.train.sample_source
        # Both streams use the first set; with `independent` the raw stream uses the second one.
        uniforms = [
            self.ranks.rand(b, t, self.config.model.stoch, generator=self.generator)
            for _ in range(2 if source == 'independent' else 1)
        ]
        pair = observe_pair(
            self.model.rssm,
            self.teacher.rssm,
            raw_embed,
            embed,
            batch.action,
            batch.is_first,
            uniforms[0],
            source,
            raw_uniform=uniforms[-1],
        )
        return pair, seen, truth

    def filtered(self, batch: Batch) -> State:
        """The raw stream's posterior states (B, T, ...) of a batch."""
        return self.observe(batch)[0].raw

    def model_losses(self, batch: Batch) -> tuple[dict[str, Tensor], PairedRollout]:
        """Every loss term by name, each (B, T), `masks` (M,) of the M states decoded; and both streams' states."""
        b, t = batch.action.shape[:2]
        pair, (raw_grid, raw_vector), (grid, vector) = self.observe(batch)
        dyn, rep = dynamics_losses(pair.raw_post, self.model.rssm.prior(pair.raw.deter), self.config.train.free_nats)
        rows = decoded_rows(b * t, self.config.train.decode_share, self.ranks, self.generator)
        losses = reconstruction_losses(self.model.decoder, pair.raw.feature, batch, rows, self.channel_weights)
        losses |= {'dyn': dyn, 'rep': rep}
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

    def weights(self) -> dict[str, float]:
        """The weight of every loss term by name."""
        t = self.config.train
        found = {
            'masks': t.weight_pred,
            'ego': t.weight_pred,
            'dyn': t.weight_dyn,
            'rep': t.weight_rep,
            'align_encoder': t.weight_encoder,
            'align_stoch': t.weight_stoch,
            'align_deter': t.weight_deter,
        }
        if self.model.reward is not None:
            found['reward'] = t.weight_reward
        if self.model.cont is not None:
            found['continue'] = 1.0
        return found

    def step(self, batch: Batch, factor: float = 1.0) -> dict[str, float]:
        """One gradient step of each network. factor: multiplies the learning rates. Returns metrics by name."""
        t = self.config.train
        losses, pair = self.model_losses(batch)
        metrics = {f'loss/{name}': float(value.detach().mean()) for name, value in losses.items()}
        total = weighted_sum(losses, self.weights(), *batch.action.shape[:2])
        metrics['grad/model'] = self.model_optimiser.step(total, factor)
        self.steps += 1
        if t.policy_init != 'frozen' and self.steps > t.policy_after and self.steps % t.policy_every == 0:
            for _ in range(t.policy_updates):
                metrics |= self.policy_step(pair, batch, factor)
        return metrics

    def distill_weight(self) -> float:
        """The weight of distillation at this step: linear from `distill` to `distill_end` over the run."""
        t = self.config.train
        part = min(1.0, self.steps / max(1, self.total_steps))
        return t.distill + (t.distill_end - t.distill) * part

    def policy_step(self, pair: PairedRollout, batch: Batch, factor: float = 1.0) -> dict[str, float]:
        """Actor-critic in the raw model's imagination, with reward and continue of the privileged one in lock-step."""
        t = self.config.train
        start, (guide_deter,) = choose_starts(
            pair.raw, (pair.privileged.deter,), batch.cont, t.starts, self.ranks, self.generator
        )
        # Without head guidance the raw model's own heads are read; `TrainConfig` makes sure that it has both.
        judge = self.teacher if t.head_guidance else self.model
        assert judge.reward is not None and judge.cont is not None
        rollout = imagine(
            self.model.rssm,
            self.policy.actor,
            start,
            judge.reward,
            judge.cont,
            t.horizon,
            start_noise(t.starts, self.ranks, self.generator),
            (self.teacher.rssm, guide_deter),
            shared_sample=t.sample_source != 'independent',
            own_heads=not t.head_guidance,
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
