"""Sizes of the networks, read from `params/presets/*.yaml`; unknown keys are errors."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Literal, TypeVar

import yaml
from pydantic import BaseModel, ConfigDict, Field, ValidationError, field_validator, model_validator

from raw2drive_ros.bev_channels import CHANNELS


class ConfigError(ValueError):
    """A configuration file is missing or wrong; the message says which and what."""


class Strict(BaseModel):
    """Frozen, and every key must be known."""

    model_config = ConfigDict(frozen=True, extra='forbid')


class ModelConfig(Strict):
    """One model size. mask_classes: name -> BEV channels that are merged into it."""

    mask_classes: dict[str, list[str]]
    mask_size: int = Field(64, description='masks are downsampled from 128 to this side')
    patch: int = Field(8, description='space-to-depth factor: the grid of e_t has mask_size / patch cells')
    grid_features: int = 32
    encoder_width: int = 96
    depthwise: bool = Field(False, description='3x3 convolutions of BEV encoder and decoder feature by feature')
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

    @model_validator(mode='after')
    def _cells_share_the_groups(self) -> ModelConfig:
        if self.latent == 'grid' and self.stoch % self.grid**2:
            raise ValueError(f'stoch {self.stoch} is not a multiple of the {self.grid**2} cells of a grid latent')
        return self

    @property
    def grid(self) -> int:
        return self.mask_size // self.patch

    @property
    def stoch_size(self) -> int:
        return self.stoch * self.classes

    @property
    def feature_size(self) -> int:
        return self.deter + self.stoch_size


def preset_folder() -> Path:
    """`params/` of the source tree, or of the installed package's share folder."""
    source = Path(__file__).resolve().parents[2] / 'params'
    if source.is_dir():
        return source
    import sys

    return Path(sys.prefix) / 'share' / 'raw2drive_ros' / 'params'


def load_yaml(path: Path) -> dict[str, Any]:
    """A YAML mapping. Raises ConfigError with the path and the reason."""
    try:
        loaded = yaml.safe_load(path.read_text(encoding='utf-8'))
    except OSError as error:
        raise ConfigError(f'cannot read {path}: {error.strerror}') from error
    except (yaml.YAMLError, ValueError, TypeError, RecursionError) as error:
        # Not text at all, dates that are none, keys that cannot be keys, brackets without end.
        raise ConfigError(f'{path} is not valid YAML: {error}') from error
    if not isinstance(loaded, dict):
        raise ConfigError(f'{path}: expected a mapping')
    return loaded


Model = TypeVar('Model', bound=BaseModel)


def load_strict(kind: type[Model], path: Path) -> Model:
    """A YAML file as `kind`. Raises ConfigError that names the file and the field."""
    try:
        return kind(**load_yaml(path))
    except (ValidationError, TypeError) as error:
        if isinstance(error, TypeError):
            raise ConfigError(f'{path}: keys must be words') from error
        raise ConfigError(f'{path}: {_problems(error)}') from error


def _problems(error: ValidationError) -> str:
    """All in one line, keys that nobody knows first: a mistyped one is the cause of a missing one."""
    found = [(each['type'], '.'.join(str(part) for part in each['loc']), each['msg']) for each in error.errors()]
    unknown = [where for kind, where, _ in found if kind == 'extra_forbidden']
    missing = [where for kind, where, _ in found if kind == 'missing']
    said = [f'{", ".join(unknown)}: no such key'] if unknown else []
    said += [f'{where}: {text}' for kind, where, text in found if kind not in ('extra_forbidden', 'missing')]
    if missing:
        said.append(f'missing: {", ".join(missing)}')
    return '; '.join(said)


def load_preset(name: str) -> dict[str, Any]:
    """The mapping of `params/presets/<name>.yaml`."""
    folder = preset_folder() / 'presets'
    path = folder / f'{name}.yaml'
    if not path.is_file():
        known = ', '.join(sorted(p.stem for p in folder.glob('*.yaml')))
        raise ConfigError(f'unknown preset {name!r}; known: {known}')
    return load_yaml(path)
