"""Locates the files of `params/` and reads YAML into strict models; whatever is wrong becomes one clear ConfigError."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any, TypeVar

import yaml
from pydantic import BaseModel, ConfigDict, ValidationError

from raw2drive_ros.bounds import read_yaml
from raw2drive_ros.contracts.errors import ConfigError
from raw2drive_ros.contracts.near_names import did_you_mean, unknown_name


class Strict(BaseModel):
    """A frozen model that rejects unknown keys."""

    model_config = ConfigDict(frozen=True, extra='forbid')


def params_folder() -> Path:
    """`params/` of the source tree, or of the installed package's share folder."""
    source = Path(__file__).resolve().parents[1] / 'params'
    if source.is_dir():
        return source
    return Path(sys.prefix) / 'share' / 'raw2drive_ros' / 'params'


def load_yaml(path: Path) -> dict[str, Any]:
    """A YAML mapping. Raises ConfigError with the path and the reason."""
    try:
        loaded = read_yaml(path)
    except OSError as error:
        raise ConfigError(f'cannot read {path}: {error.strerror}') from error
    except (yaml.YAMLError, ValueError, TypeError, RecursionError) as error:
        # Bytes that are not text, impossible dates, unhashable keys, brackets nested or aliases multiplied too far.
        raise ConfigError(f'{path} is not valid YAML: {" ".join(str(error).split())}') from error
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
        raise ConfigError(f'{path}: {problems(error, kind)}') from error


def problems(error: ValidationError, kind: type[BaseModel] | None = None) -> str:
    """All validation errors on one line, unknown keys first: a misspelt key is often why another one is missing.

    kind: the model that was read; with it, an unknown key comes with the keys that it may have been meant to be.
    """
    found = [(each['type'], '.'.join(str(part) for part in each['loc']), each['msg']) for each in error.errors()]
    unknown = [where for sort, where, _ in found if sort == 'extra_forbidden']
    missing = [where for sort, where, _ in found if sort == 'missing']
    near = did_you_mean(unknown[0].rpartition('.')[2], _keys_beside(unknown[0], kind)) if unknown else ''
    said = [f'{", ".join(unknown)}: no such key{near}'] if unknown else []
    others = [
        (where, text.removeprefix('Value error, '))
        for sort, where, text in found
        if sort not in ('extra_forbidden', 'missing')
    ]
    said += [f'{where}: {text}' if where else text for where, text in others]
    if missing:
        said.append(f'missing: {", ".join(missing)}')
    return '; '.join(said)


def _keys_beside(where: str, kind: type[BaseModel] | None) -> list[str]:
    """The keys that may stand where `where`, as in `motion.max_speed`, stands in a file that is read as `kind`."""
    for part in where.split('.')[:-1]:
        inner = kind.model_fields[part].annotation if kind is not None and part in kind.model_fields else None
        kind = inner if isinstance(inner, type) and issubclass(inner, BaseModel) else None
    return list(kind.model_fields) if kind is not None else []


def load_preset(name: str) -> dict[str, Any]:
    """The mapping of `params/presets/<name>.yaml`."""
    if name not in preset_names():
        raise ConfigError(unknown_name('preset', name, preset_names()))
    return load_yaml(params_folder() / 'presets' / f'{name}.yaml')


def preset_names() -> list[str]:
    """Names of the shipped presets."""
    return sorted(path.stem for path in (params_folder() / 'presets').glob('*.yaml'))


def default_bundle() -> Path:
    """The policy bundle that comes with the package."""
    return params_folder() / 'bundles' / 'laptop'


def default_teacher() -> Path:
    """The privileged teacher that comes with the package."""
    return params_folder() / 'bundles' / 'teacher'
