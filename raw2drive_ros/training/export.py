"""From a stage-2 run to a policy bundle."""

from __future__ import annotations

import json
from pathlib import Path

from raw2drive_ros.driving.bundle import save_bundle
from raw2drive_ros.errors import CheckpointError
from raw2drive_ros.training.checkpoint import load_weights, newest_checkpoint
from raw2drive_ros.training.dataset import rig_of
from raw2drive_ros.training.raw import RawTrainer
from raw2drive_ros.training.teacher import load_teacher, read_run_config


def export_bundle(run: Path, target: Path) -> str:
    """Write the newest checkpoint of a raw run as a bundle; returns its identity. Raises CheckpointError."""
    config = read_run_config(run)
    body = json.loads((run / 'config.json').read_text())
    checkpoint = newest_checkpoint(run / 'checkpoints')
    if body['stage'] != 'raw' or checkpoint is None:
        raise CheckpointError(f'{run}: not a raw run with a checkpoint')
    rig = rig_of(Path(body['bags'][0]['path']))
    trainer = RawTrainer(config, load_teacher(Path(body['teacher'])), rig, 1)
    load_weights(checkpoint, trainer)
    metadata = {
        'stage_2_steps': trainer.steps,
        'training_ticks': sum(b['ticks'] for b in body['bags']),
        'training_bags': [b['id'] for b in body['bags']],
        'preset': config.preset,
        'train': config.train.model_dump(mode='json'),
    }
    return save_bundle(target, config.model, rig, trainer.model, trainer.policy.actor, metadata)
