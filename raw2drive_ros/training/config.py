"""Training configuration: one frozen object per run, saved in its folder; every ablation of the paper is a field."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Literal

import torch
from pydantic import Field, ValidationError, model_validator
from torch import Tensor

from raw2drive_ros.contracts.errors import CheckpointError, ConfigError
from raw2drive_ros.settings import Strict, load_preset, problems
from raw2drive_ros.world_model.config import ModelConfig
from raw2drive_ros.world_model.run_files import read_run
from raw2drive_ros.world_model.streams import Share

HEADS = {'reward', 'continue'}


class TrainConfig(Strict):
    """Hyperparameters of both stages. Loss weights follow the paper where it gives them."""

    seed: int = 0
    threads: int = Field(2, ge=1)
    batch: int = 16
    length: int = 32
    raw_batch: int = 8
    raw_length: int = 16
    starts: int = Field(256, description='imagined rollouts per step')
    horizon: int = 15
    gamma: float = 0.985
    lambda_: float = 0.95
    entropy: float = 3e-4
    slow_rate: float = 0.02
    slow_weight: float = 1.0
    model_lr: float = 4e-4
    policy_lr: float = 1.5e-4
    weight_decay: float = 0.0
    warmup: int = 200
    decay_share: float = Field(0.3, ge=0.0, le=1.0, description='last share of the run in which learning rates fall')
    decay_end: float = Field(0.02, ge=0.0, le=1.0, description='share of a learning rate that is left at the end')
    model_clip: float = 100.0
    policy_clip: float = 100.0
    policy_every: int = Field(1, description='world-model steps per round of policy updates')
    policy_updates: int = Field(1, description='policy updates per round, each from fresh imagination')
    policy_after: int = Field(0, description='steps of world-model training before the policy starts')
    reset_policy_at: int = Field(0, description='give the policy fresh weights at this step; 0 = never')
    imitate: float = Field(
        0.0, ge=0.0, description='weight of imitating the expert in its bags (stage 1; not in the paper)'
    )
    terminal_share: float = Field(0.3, description='share of sequences that hold a terminal step')
    mask_weights: dict[str, float] = Field(
        {}, description='weight of a mask class in the reconstruction loss; 1 where a class is not named'
    )
    decode_share: float = Field(1.0, gt=0.0, le=1.0, description='share of the states whose masks are decoded a step')
    free_nats: float = 1.0
    weight_pred: float = 1.0
    weight_reward: float = 10.0
    weight_advice: float = Field(
        0.0, ge=0.0, description="of a world-model head that predicts the expert's action (stage 1; not in the paper)"
    )
    weight_dyn: float = 1.0
    weight_rep: float = 0.1
    # Stage 2: rollout guidance (paper, section 3.3). A weight of 0 is an ablation.
    weight_encoder: float = 10.0
    weight_stoch: float = 10.0
    weight_deter: float = 5.0
    align_space: bool = Field(default=True, description='false: align the mean over grid cells only')
    align_time: bool = Field(default=True, description='false: align the last step of a sequence only')
    sample_source: Literal['raw', 'privileged', 'independent'] = 'raw'
    share_rssm: Share = Field('init', description='how the raw RSSM begins: as a copy, as the frozen one itself, fresh')
    share_decoder: Share = Field('init', description='the same for the decoder')
    raw_heads: tuple[Literal['reward', 'continue'], ...] = ()
    head_guidance: bool = True
    policy_init: Literal['privileged', 'fresh', 'frozen'] = 'privileged'
    distill: float = 1.0
    distill_end: float = 0.1
    log_every: int = 50
    picture_every: int = 1000
    checkpoint_every: int = 500

    @model_validator(mode='before')
    @classmethod
    def _share_of_both(cls, given: Any) -> Any:
        """Runs of version 0.2 have one field, `share`, for both the RSSM and the decoder."""
        return with_both_shares(given) if isinstance(given, dict) else given

    @model_validator(mode='after')
    def _imagination_has_heads(self) -> TrainConfig:
        if not self.head_guidance and set(self.raw_heads) != HEADS:
            raise ValueError(
                'head_guidance=false needs raw_heads=[reward,continue]: imagined steps need both predictions'
            )
        return self


class RunConfig(Strict):
    """The configuration of a run: preset, sizes of the networks, hyperparameters."""

    preset: str
    model: ModelConfig
    train: TrainConfig

    @model_validator(mode='after')
    def _known_mask_classes(self) -> RunConfig:
        unknown = sorted(set(self.train.mask_weights) - set(self.model.mask_classes))
        if unknown:
            known = ', '.join(self.model.mask_classes)
            raise ValueError(f'mask_weights: unknown class {", ".join(unknown)}; known: {known}')
        return self

    def channel_weights(self) -> Tensor:
        """(C*P*P,) weights of the mask channels, in the order of `MaskCodec`."""
        weights = [self.train.mask_weights.get(name, 1.0) for name in self.model.mask_classes]
        return torch.tensor(weights).repeat_interleave(self.model.patch**2)


def with_both_shares(given: dict[str, Any]) -> dict[str, Any]:
    """`share` as the two fields that it stands for; where one of them is given too, that one counts."""
    if 'share' not in given:
        return given
    both = dict.fromkeys(('share_rssm', 'share_decoder'), given['share'])
    return both | {name: value for name, value in given.items() if name != 'share'}


def read_run_config(run: Path) -> RunConfig:
    """The configuration of an existing run. Raises CheckpointError.

    Version 0.2 ignored `head_guidance: false` without both raw heads; such a run is read as what it did.
    """
    body = read_run(run)['config']
    train = body.get('train')
    if isinstance(train, dict) and len(train.get('raw_heads') or ()) < len(HEADS):
        body = body | {'train': train | {'head_guidance': True}}
    try:
        return RunConfig(**body)
    except ValidationError as error:
        raise CheckpointError(f'{run}: its configuration is not that of a run: {problems(error)}') from error
    except TypeError as error:
        raise CheckpointError(f'{run}: its configuration is not that of a run: {error}') from error


def make_config(preset: str, overrides: dict[str, Any] | None = None) -> RunConfig:
    """A preset with `train` fields replaced. Raises ConfigError that names the field."""
    raw = load_preset(preset)
    return _checked(preset, raw['model'], raw.get('train', {}) | with_both_shares(overrides or {}))


def overridden(config: RunConfig, overrides: dict[str, Any]) -> RunConfig:
    """The same configuration with `train` fields replaced; the preset is not read again. Raises ConfigError."""
    return _checked(config.preset, config.model.model_dump(), config.train.model_dump() | with_both_shares(overrides))


def _checked(preset: str, model: dict[str, Any], train: dict[str, Any]) -> RunConfig:
    try:
        return RunConfig(preset=preset, model=ModelConfig(**model), train=TrainConfig(**train))
    except ValidationError as error:
        kinds: dict[str, type[Strict]] = {'TrainConfig': TrainConfig, 'ModelConfig': ModelConfig}
        kind = kinds.get(error.title)
        raise ConfigError(f'preset {preset}: {problems(error, kind)}') from error
