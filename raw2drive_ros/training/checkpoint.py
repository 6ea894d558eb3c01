"""Checkpoints that resume exactly: weights, optimiser moments, random generators. safetensors and JSON, no pickles."""

from __future__ import annotations

import json
import shutil
import sys
import time
from collections import Counter
from pathlib import Path
from typing import Any

import torch
from safetensors.torch import save_file
from torch import Tensor

from raw2drive_ros.artifact import part_of, whole_folder
from raw2drive_ros.training.privileged import PrivilegedTrainer
from raw2drive_ros.training.raw import RawTrainer
from raw2drive_ros.training.replay import Replay
from raw2drive_ros.world_model.run_files import STATE, TENSORS, load_modules, read_checkpoint, write_sums

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
    # Tied weights share memory, which safetensors refuses to store; copies do not.
    return {key: value.detach().clone().contiguous() for key, value in found.items()}


def save_checkpoint(folder: Path, trainer: Trainer, replay: Replay, extra: dict[str, Any]) -> Path:
    """Write `folder/<step>` atomically, durably and with hashes; delete all but the newest `KEEP`, and the partial ones
    of killed writers. Later ones than this, which were damaged, keep their content under another name."""
    target = folder / f'{trainer.steps:08d}'
    state = {
        'stage': trainer.stage,
        'steps': trainer.steps,
        'replay_rng': replay.rng.bit_generator.state,
        'bags': [bag.identity for bag in replay.bags],
    } | extra
    with whole_folder(target, durable=True) as partial:
        save_file(_tensors(trainer), partial / TENSORS)
        (partial / STATE).write_text(json.dumps(state))
        write_sums(partial)
    numbered = sorted(p for p in folder.iterdir() if p.name.isdigit())
    for path in numbered:
        # Training goes on from the newest sound one, so these are not.
        if path.name > target.name:
            path.rename(path.with_name(f'{path.name}.damaged-{time.time_ns()}'))
    old = [path for path in numbered if path.name <= target.name][:-KEEP]
    for path in [*old, *folder.glob('*.partial'), *folder.glob('.*.old')]:
        shutil.rmtree(path, ignore_errors=True)
    return target


def load_weights(checkpoint: Path, trainer: Trainer) -> None:
    """Load the weights and the number of steps only. Raises CheckpointError."""
    tensors, state = read_checkpoint(checkpoint)
    load_modules(checkpoint, tensors, trainer.modules())
    trainer.steps = int(state['steps'])


def load_checkpoint(checkpoint: Path, trainer: Trainer, replay: Replay) -> dict[str, Any]:
    """Load everything, so that training continues as if it had never stopped; returns the stored state. Other bags than
    before are named on stderr.

    Raises CheckpointError.
    """
    tensors, state = read_checkpoint(checkpoint)
    load_modules(checkpoint, tensors, trainer.modules())
    trainer.steps = int(state['steps'])
    for name, optimiser in trainer.optimisers().items():
        optimiser.load_tensors(part_of(tensors, f'optimiser.{name}'))
    torch.set_rng_state(tensors['rng/torch'])
    trainer.generator.set_state(tensors['rng/trainer'])
    replay.rng.bit_generator.state = state['replay_rng']
    if trainer.ranks.leads and (line := other_bags(state.get('bags', []), replay)):
        print(f'{checkpoint}: {line}', file=sys.stderr)
    return state


def other_bags(before: list[str], replay: Replay) -> str:
    """How the bags of a resumed run differ from those before, or ''."""
    old, new = Counter(before), Counter(bag.identity for bag in replay.bags)
    if old == new:
        same = before == [bag.identity for bag in replay.bags]
        return '' if same else 'resumes with the same bags in another order: other sequences are drawn than before'
    return (
        f'resumes with other bags than before: {(new - old).total()} new, {(old - new).total()} gone; '
        'other sequences are drawn than before'
    )
