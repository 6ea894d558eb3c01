"""Locates the files of `params/` and reads YAML into strict models; whatever is wrong becomes one clear ConfigError."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any, TypeVar

import yaml
from pydantic import BaseModel, ConfigDict, ValidationError

from raw2drive_ros.bounds import read_yaml
from raw2drive_ros.contracts.errors import ConfigError


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
        raise ConfigError(f'{path}: {problems(error)}') from error


def problems(error: ValidationError) -> str:
    """All validation errors on one line, unknown keys first: a misspelt key is often why another one is missing."""
    found = [(each['type'], '.'.join(str(part) for part in each['loc']), each['msg']) for each in error.errors()]
    unknown = [where for kind, where, _ in found if kind == 'extra_forbidden']
    missing = [where for kind, where, _ in found if kind == 'missing']
    said = [f'{", ".join(unknown)}: no such key'] if unknown else []
    others = [
        (where, text.removeprefix('Value error, '))
        for kind, where, text in found
        if kind not in ('extra_forbidden', 'missing')
    ]
    said += [f'{where}: {text}' if where else text for where, text in others]
    if missing:
        said.append(f'missing: {", ".join(missing)}')
    return '; '.join(said)


def load_preset(name: str) -> dict[str, Any]:
    """The mapping of `params/presets/<name>.yaml`."""
    folder = params_folder() / 'presets'
    path = folder / f'{name}.yaml'
    if not path.is_file():
        known = ', '.join(sorted(p.stem for p in folder.glob('*.yaml')))
        raise ConfigError(f'unknown preset {name!r}; known: {known}')
    return load_yaml(path)


def default_bundle() -> Path:
    """The policy bundle that comes with the package."""
    return params_folder() / 'bundles' / 'laptop'


def default_teacher() -> Path:
    """The privileged teacher that comes with the package."""
    return params_folder() / 'bundles' / 'teacher'
