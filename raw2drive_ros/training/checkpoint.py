"""Checkpoints that resume exactly: weights, moments, every random generator. safetensors and JSON, no pickles."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import Any

import torch
from safetensors.torch import load_file, save_file
from torch import Tensor

from raw2drive_ros.errors import CheckpointError
from raw2drive_ros.training.privileged import PrivilegedTrainer
from raw2drive_ros.training.raw import RawTrainer
from raw2drive_ros.training.replay import Replay

Trainer = PrivilegedTrainer | RawTrainer
KEEP = 2


def _tensors(trainer: Trainer) -> dict[str, Tensor]:
    found: dict[str, Tensor] = {}
    for name, module in trainer.modules().items():
        for key, value in module.state_dict().items():
            found[f'{name}/{key}'] = value
    for name, optimiser in trainer.optimisers().items():
        for key, value in optimiser.tensors().items():
            found[f'optimiser.{name}/{key}'] = value
    found['rng/torch'] = torch.get_rng_state()
    found['rng/trainer'] = trainer.generator.get_state()
    # Tied weights share memory, which safetensors refuses; a copy is as good.
    return {key: value.detach().clone().contiguous() for key, value in found.items()}


def save_checkpoint(folder: Path, trainer: Trainer, replay: Replay, extra: dict[str, Any]) -> Path:
    """Write `folder/<step>` atomically and drop all but the newest `KEEP`."""
    target = folder / f'{trainer.steps:08d}'
    partial = folder / f'{target.name}.partial'
    shutil.rmtree(partial, ignore_errors=True)
    partial.mkdir(parents=True)
    save_file(_tensors(trainer), partial / 'tensors.safetensors')
    state = {
        'stage': trainer.stage,
        'steps': trainer.steps,
        'replay_rng': replay.rng.bit_generator.state,
        'bags': [bag.identity for bag in replay.bags],
    } | extra
    (partial / 'state.json').write_text(json.dumps(state))
    shutil.rmtree(target, ignore_errors=True)
    partial.replace(target)
    for old in sorted(p for p in folder.iterdir() if p.name.isdigit())[:-KEEP]:
        shutil.rmtree(old)
    return target


def newest_checkpoint(folder: Path) -> Path | None:
    """The newest whole checkpoint, or None."""
    if not folder.is_dir():
        return None
    whole = [p for p in folder.iterdir() if p.name.isdigit() and (p / 'state.json').is_file()]
    return max(whole, default=None)


def load_weights(checkpoint: Path, trainer: Trainer) -> dict[str, Any]:
    """Weights only, e.g. of the teacher. Returns the stored state."""
    tensors, state = _read(checkpoint)
    for name, module in trainer.modules().items():
        part = {k.removeprefix(f'{name}/'): v for k, v in tensors.items() if k.startswith(f'{name}/')}
        try:
            module.load_state_dict(part)
        except RuntimeError as error:
            reason = str(error).splitlines()[0]
            raise CheckpointError(f'{checkpoint}: does not fit this configuration: {reason}') from error
    trainer.steps = int(state['steps'])
    return state


def load_checkpoint(checkpoint: Path, trainer: Trainer, replay: Replay) -> dict[str, Any]:
    """Everything, so that training goes on as if it had never stopped."""
    state = load_weights(checkpoint, trainer)
    tensors, _ = _read(checkpoint)
    for name, optimiser in trainer.optimisers().items():
        prefix = f'optimiser.{name}/'
        optimiser.load_tensors({k.removeprefix(prefix): v for k, v in tensors.items() if k.startswith(prefix)})
    torch.set_rng_state(tensors['rng/torch'])
    trainer.generator.set_state(tensors['rng/trainer'])
    replay.rng.bit_generator.state = state['replay_rng']
    return state


def _read(checkpoint: Path) -> tuple[dict[str, Tensor], dict[str, Any]]:
    try:
        return load_file(checkpoint / 'tensors.safetensors'), json.loads((checkpoint / 'state.json').read_text())
    except Exception as error:
        raise CheckpointError(f'{checkpoint}: cannot be read: {error}') from error
