"""Reading the folder of a training run: configuration, checkpoints, the best checkpoint.

`training.run` and `training.checkpoint` write it. Reading it needs no optimiser and no trainer.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from safetensors.torch import load_file
from torch import Tensor, nn

from raw2drive_ros.artifact import part_of
from raw2drive_ros.contracts.errors import CheckpointError

CONFIG = 'config.json'
CHECKPOINTS = 'checkpoints'
# Where a recipe keeps the checkpoint that drove best on its validation suite.
BEST = 'best'
TENSORS, STATE = 'tensors.safetensors', 'state.json'


def read_run(run: Path) -> dict[str, Any]:
    """`config.json` of a run: `config`, `stage`, `bags` and so on. Raises CheckpointError."""
    try:
        body = json.loads((run / CONFIG).read_text())
        if not isinstance(body, dict) or not isinstance(body['config'], dict):
            raise TypeError('not a table')
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise CheckpointError(f'{run}: not a training run ({CONFIG}: {error})') from error
    return body


def run_of(path: Path) -> Path:
    """The run that `path`, a run or a checkpoint of one, belongs to; `path` itself where there is none."""
    return next((p for p in (path, *path.parents) if (p / CONFIG).is_file()), path)


def newest_checkpoint(folder: Path) -> Path | None:
    """The newest complete checkpoint, or None."""
    if not folder.is_dir():
        return None
    whole = [p for p in folder.iterdir() if p.name.isdigit() and (p / STATE).is_file()]
    return max(whole, default=None)


def checkpoint_of(path: Path) -> Path:
    """`path` itself where it is a checkpoint, else the best or newest one of the run `path`. Raises CheckpointError."""
    for folder in (path, path / BEST):
        if (folder / TENSORS).is_file():
            return folder
    read_run(path)
    checkpoint = newest_checkpoint(path / CHECKPOINTS)
    if checkpoint is None:
        raise CheckpointError(f'{path}: has no checkpoint yet; run `raw2drive train privileged` first')
    return checkpoint


def read_checkpoint(checkpoint: Path) -> tuple[dict[str, Tensor], dict[str, Any]]:
    """(tensors, state) of a checkpoint. Raises CheckpointError."""
    try:
        return load_file(checkpoint / TENSORS), json.loads((checkpoint / STATE).read_text())
    except Exception as error:
        raise CheckpointError(f'{checkpoint}: cannot be read: {error}') from error


def load_modules(source: Path, tensors: Mapping[str, Tensor], modules: Mapping[str, nn.Module]) -> None:
    """Load the tensors `NAME/...` into the module of that name. Raises CheckpointError."""
    for name, module in modules.items():
        try:
            module.load_state_dict(part_of(tensors, name))
        except RuntimeError as error:
            reason = str(error).splitlines()[0]
            raise CheckpointError(f'{source}: does not fit this configuration: {reason}') from error
