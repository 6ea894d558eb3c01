"""Exports training runs as bundles: the raw policy for planners, the privileged networks as a teacher."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from raw2drive_ros.contracts.errors import CheckpointError
from raw2drive_ros.driving.bundle import save_bundle
from raw2drive_ros.settings import problems
from raw2drive_ros.training.checkpoint import load_weights
from raw2drive_ros.training.config import RunConfig, read_run_config
from raw2drive_ros.training.dataset import rig_of
from raw2drive_ros.training.raw import RawTrainer
from raw2drive_ros.world_model.run_files import BEST, CHECKPOINTS, checkpoint_of, newest_checkpoint, read_run, run_of
from raw2drive_ros.world_model.teacher import METADATA, is_bundle, load_teacher, read_manifest, save_teacher


def export_bundle(run: Path, target: Path) -> str:
    """Write the newest checkpoint of a raw run as a bundle; returns its identity. Raises CheckpointError."""
    config, body = read_run_config(run), read_run(run)
    checkpoint = newest_checkpoint(run / CHECKPOINTS)
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


def export_teacher(source: Path, target: Path) -> str:
    """Write the privileged networks of a run, a checkpoint or a bundle as a teacher bundle; returns its identity.

    Raises CheckpointError.
    """
    teacher = load_teacher(source)
    config = _config_of(source)
    # The bundle leaves the advice head out.
    train = config.train.model_copy(update={'weight_advice': 0.0})
    body = config.model_copy(update={'train': train}).model_dump(mode='json')
    return save_teacher(target, teacher, body, training_metadata(source))


def training_metadata(source: Path) -> dict[str, Any]:
    """What a model card states about a run, a checkpoint or a teacher bundle: bags, number of ticks, validation.

    Raises CheckpointError.
    """
    if is_bundle(source):
        return dict(read_manifest(source)[METADATA])
    run = run_of(source)
    bags = read_run(run)['bags']
    metadata: dict[str, Any] = {
        'training_ticks': sum(bag['ticks'] for bag in bags),
        'training_bags': [bag['id'] for bag in bags],
    }
    score = run / BEST / 'score.json'
    # Of that checkpoint and of no other.
    if score.is_file() and checkpoint_of(source) == run / BEST:
        metadata['validation'] = json.loads(score.read_text())
    return metadata


def _config_of(source: Path) -> RunConfig:
    if not is_bundle(source):
        return read_run_config(run_of(source))
    try:
        return RunConfig(**read_manifest(source)['config'])
    except ValidationError as error:
        raise CheckpointError(f'{source}: damaged teacher bundle: {problems(error)}') from error
