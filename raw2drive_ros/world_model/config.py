"""Sizes of the networks: the `model` part of `params/presets/*.yaml`."""

from __future__ import annotations

from typing import Literal

from pydantic import Field, field_validator, model_validator

from raw2drive_ros.settings import Strict
from raw2drive_ros.tables.bev_channels import CHANNELS
from raw2drive_ros.tables.vector_layout import BASIC_EGO_FIELDS, PRIVILEGED_FIELDS

# Far above any model of this project. A configuration may come with a bundle of unknown origin, and networks are built
# before their weights are read.
_MOST = {'mask_size': 512, 'lift_grid': 256, 'head_layers': 32, 'blocks': 256, 'classes': 1024, 'cell_hidden': 1024}
_MOST_OF_OTHERS = 16_384
_MOST_PIXELS = 4096
_MOST_HEIGHTS = 32


class ModelConfig(Strict):
    """Sizes of one model, and what it reads of a privileged frame. mask_classes: name -> BEV channels that are merged
    into it."""

    mask_classes: dict[str, list[str]]
    # Bundles of before there were more fields do not name them.
    ego_fields: tuple[str, ...] = Field(
        BASIC_EGO_FIELDS, description='privileged vector input, which both decoders reconstruct: ego and signal fields'
    )
    masks: Literal['all', 'visible'] = Field(
        'all', description='visible: dynamic masks of what the cameras have shown within the last 2 s'
    )
    mask_size: int = Field(64, description='masks are downsampled from 128 to this side')
    patch: int = Field(8, description='space-to-depth factor: the grid of e_t has mask_size / patch cells')
    grid_features: int = 32
    encoder_width: int = 96
    depthwise: bool = Field(default=False, description='3x3 convolutions of BEV encoder and decoder feature by feature')
    vector_features: int = 64
    deter: int = 512
    hidden: int = 256
    stoch: int = 32
    classes: int = 16
    latent: Literal['flat', 'grid'] = Field(
        'flat', description='grid: every cell of e_t has categoricals of its own; `stoch` is a multiple of grid ** 2'
    )
    cell_hidden: int = Field(16, description='width of the posterior per cell (latent grid)')
    spread: int = Field(192, description='hidden width on the way from the deterministic state to cells (latent grid)')
    small_units: int = Field(0, description='width of the continue and ego heads; 0 = units')
    blocks: int = 8
    units: int = 256
    head_layers: int = 2
    bins: int = 255
    unimix: float = 0.01
    image_size: tuple[int, int] = (96, 160)
    camera_width: int = 48
    lift_grid: int = Field(32, description='side of the BEV grid that image features are lifted to')
    lift_heights_m: tuple[float, ...] = (0.0, 1.0, 3.4)

    @field_validator('mask_classes')
    @classmethod
    def _known_channels(cls, value: dict[str, list[str]]) -> dict[str, list[str]]:
        unknown = sorted({name for names in value.values() for name in names} - set(CHANNELS))
        if unknown:
            raise ValueError(f'unknown BEV channels: {", ".join(unknown)}')
        return value

    @field_validator('ego_fields')
    @classmethod
    def _known_fields(cls, value: tuple[str, ...]) -> tuple[str, ...]:
        if unknown := [name for name in value if name not in PRIVILEGED_FIELDS]:
            raise ValueError(f'unknown ego_fields: {", ".join(unknown)}; known: {", ".join(PRIVILEGED_FIELDS)}')
        if not value or len(set(value)) < len(value):
            raise ValueError('ego_fields: at least one, and none twice')
        return value

    @model_validator(mode='after')
    def _plausible(self) -> ModelConfig:
        for name, value in self:
            if isinstance(value, int) and not 0 <= value <= _MOST.get(name, _MOST_OF_OTHERS):
                raise ValueError(f'{name} {value} is not between 0 and {_MOST.get(name, _MOST_OF_OTHERS)}')
        if max(self.image_size) > _MOST_PIXELS or len(self.lift_heights_m) > _MOST_HEIGHTS:
            raise ValueError(f'image_size is above {_MOST_PIXELS} or lift_heights_m has more than {_MOST_HEIGHTS}')
        return self

    @model_validator(mode='after')
    def _cells_share_the_groups(self) -> ModelConfig:
        if self.latent == 'grid' and self.stoch % self.grid**2:
            raise ValueError(f'stoch {self.stoch} is not a multiple of the {self.grid**2} cells of a grid latent')
        return self

    @property
    def grid(self) -> int:
        return self.mask_size // self.patch

    @property
    def ego_size(self) -> int:
        return len(self.ego_fields)

    @property
    def stoch_size(self) -> int:
        return self.stoch * self.classes

    @property
    def feature_size(self) -> int:
        return self.deter + self.stoch_size
