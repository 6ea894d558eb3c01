"""What `raw2drive train` would train with, field by field, and the fields that `--set` takes."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from raw2drive_ros.training.recipe import Recipe


def print_config(run: Path | None, preset: str | None, overrides: dict[str, Any], recipe: Recipe | None) -> None:
    """Every field with its value and where that comes from: default, preset, recipe, --set, or the run itself.

    Raises what `training.run.configuration` raises.
    """
    from raw2drive_ros.training.run import configuration

    settings = overrides if recipe is None else recipe.settings(0, overrides)
    config = configuration(run, preset if recipe is None else recipe.preset, settings)
    sources = _sources(run, config.preset, overrides, recipe)
    print(f'run {run}, of preset {config.preset}' if sources['run'] else f'a new run of preset {config.preset}')
    otherwise = 'the run' if sources['run'] else 'default'
    for part, values in (('model', config.model), ('train', config.train)):
        for name, value in values.model_dump().items():
            # Values last: some are long.
            print(f'{part}.{name:18} {sources[part].get(name, otherwise):18} {value}')
    for number, later in enumerate(recipe.rounds[1:] if recipe is not None else (), 2):
        if later.set:
            print(f'from round {number} on: {", ".join(f"{name}={value}" for name, value in later.set.items())}')


def _sources(run: Path | None, preset: str, overrides: dict[str, Any], recipe: Recipe | None) -> dict[str, Any]:
    """'model', 'train': field -> where its value comes from, of those that are neither defaults nor the run's own.
    'run': whether the folder is that of an existing run."""
    from raw2drive_ros.settings import load_preset
    from raw2drive_ros.training.config import with_both_shares
    from raw2drive_ros.world_model.run_files import CHECKPOINTS, newest_checkpoint

    existing = run is not None and newest_checkpoint(run / CHECKPOINTS) is not None
    found: dict[str, Any] = {'run': existing, 'model': {}, 'train': {}}
    if not existing:
        body = load_preset(preset)
        found['model'] |= dict.fromkeys(body['model'], f'preset {preset}')
        found['train'] |= dict.fromkeys(with_both_shares(body.get('train', {})), f'preset {preset}')
    if recipe is not None:
        found['train'] |= dict.fromkeys(with_both_shares(recipe.settings(0, {})), 'the recipe')
    found['train'] |= dict.fromkeys(with_both_shares(overrides), '--set')
    return found


def print_fields() -> None:
    """The fields of `--set` with type, default and meaning."""
    from rich.markup import escape
    from rich.table import Table

    from raw2drive_ros.cli.table import add_column, wide_console
    from raw2drive_ros.training.config import TrainConfig
    from raw2drive_ros.training.run import DEFAULT_PRESET

    table = Table(title=f'--set FIELD=VALUE (presets set others; default preset: {DEFAULT_PRESET})')
    for title in ('field', 'type', 'default', 'meaning'):
        add_column(table, title)
    for name, field in TrainConfig.model_fields.items():
        kind = field.annotation.__name__ if isinstance(field.annotation, type) else str(field.annotation)
        plain = kind.replace('typing.', '')
        table.add_row(name, escape(plain), escape(str(field.default)), escape(field.description or ''))
    wide_console().print(table)
