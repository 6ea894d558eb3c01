"""Reading the folder of a training run: configuration, checkpoints, the best checkpoint.

`training.run` and `training.checkpoint` write it. Reading it needs no optimiser and no trainer.
"""

from __future__ import annotations

import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from safetensors.torch import load_file
from torch import Tensor, nn

from raw2drive_ros.artifact import hash_of_file, not_finite, part_of
from raw2drive_ros.bounds import MAX_CHECKPOINT_BYTES, read_json, read_regular, tensor_shapes
from raw2drive_ros.contracts.errors import CheckpointError
from raw2drive_ros.contracts.texts import shown

CONFIG = 'config.json'
CHECKPOINTS = 'checkpoints'
# Where a recipe keeps the checkpoint that drove best on its validation suite.
BEST = 'best'
TENSORS, STATE = 'tensors.safetensors', 'state.json'
# The hashes of both, in the format of sha256sum.
SUMS = 'SHA256SUMS'
MAX_SUMS_BYTES = 4096
_said: set[str] = set()


def read_run(run: Path) -> dict[str, Any]:
    """`config.json` of a run: `config`, `stage`, `bags` and so on. Raises CheckpointError."""
    try:
        body = read_json(run / CONFIG)
        if not isinstance(body, dict) or not isinstance(body['config'], dict):
            raise TypeError('not a table')
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise CheckpointError(f'{run}: not a training run ({CONFIG}: {error})') from error
    return body


def run_of(path: Path) -> Path:
    """The run that `path`, a run or a checkpoint of one, belongs to; `path` itself where there is none."""
    return next((p for p in (path, *path.parents) if (p / CONFIG).is_file()), path)


def write_sums(checkpoint: Path) -> None:
    """Write the hashes of a checkpoint's files, by which damage to them is noticed later."""
    lines = [f'{hash_of_file(checkpoint / name)}  {name}\n' for name in (TENSORS, STATE)]
    (checkpoint / SUMS).write_text(''.join(lines))


def damage_of(checkpoint: Path) -> str:
    """Why a checkpoint cannot be used, or ''. Those of earlier versions have no hashes; their lengths are checked."""
    try:
        tensor_shapes(checkpoint / TENSORS, MAX_CHECKPOINT_BYTES)
        if not (checkpoint / SUMS).exists():
            read_json(checkpoint / STATE)
            return ''
        wanted = read_regular(checkpoint / SUMS, MAX_SUMS_BYTES).decode()
        for name in (TENSORS, STATE):
            if f'{hash_of_file(checkpoint / name)}  {name}\n' not in wanted:
                return f'{name} does not match its hash in {SUMS}'
    except (OSError, ValueError) as error:
        said = error.strerror if isinstance(error, OSError) else error
        return f'it cannot be read: {said}'
    return ''


def newest_checkpoint(folder: Path) -> Path | None:
    """The newest sound checkpoint, or None where there is none at all. A damaged one is named on stderr, once.

    Raises CheckpointError where all of them are damaged.
    """
    if not folder.is_dir():
        return None
    damaged: list[str] = []
    for checkpoint in sorted((p for p in folder.iterdir() if p.name.isdigit() and (p / STATE).exists()), reverse=True):
        why = damage_of(checkpoint)
        if not why:
            _say_damaged(damaged, checkpoint)
            return checkpoint
        damaged.append(f'{checkpoint} is damaged: {why}')
    if damaged:
        raise CheckpointError(f'{"; ".join(damaged)}; no sound checkpoint is left; remove {folder} to begin again')
    return None


def _say_damaged(damaged: list[str], used: Path) -> None:
    for line in damaged:
        if line not in _said:
            _said.add(line)
            print(shown(f'{line}; using the one before, {used.name}'), file=sys.stderr)


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
    """(tensors, state) of a checkpoint, verified by their hashes. Raises CheckpointError."""
    why = damage_of(checkpoint)
    if why:
        raise CheckpointError(f'{checkpoint}: {why}')
    try:
        return load_file(checkpoint / TENSORS), read_json(checkpoint / STATE)
    except Exception as error:
        raise CheckpointError(f'{checkpoint}: cannot be read: {error}') from error


def load_modules(source: Path, tensors: Mapping[str, Tensor], modules: Mapping[str, nn.Module]) -> None:
    """Load the tensors `NAME/...` into the module of that name. Raises CheckpointError, also for weights that are not
    finite."""
    for name, module in modules.items():
        part = part_of(tensors, name)
        if bad := not_finite(part):
            raise CheckpointError(f'{source}: {name}/{bad} holds weights that are not finite')
        try:
            module.load_state_dict(part)
        except RuntimeError as error:
            reason = str(error).splitlines()[0]
            raise CheckpointError(f'{source}: does not fit this configuration: {reason}') from error
