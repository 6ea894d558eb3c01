"""The trained privileged networks, loaded from a run, from one of its checkpoints or from a teacher bundle.

A teacher bundle is a folder of data:

teacher.json          format, identity, configuration, hash of the action table, metadata
weights.safetensors   float16 weights of the world model, the actor and the critic
MODEL_CARD.md
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from safetensors import SafetensorError
from torch import nn

from raw2drive_ros import __version__
from raw2drive_ros.artifact import (
    CARD,
    WEIGHTS,
    check_manifest,
    hash_of_file,
    load_weights,
    model_card,
    save_weights,
    whole_folder,
)
from raw2drive_ros.bounds import MAX_CHECKPOINT_BYTES, read_json
from raw2drive_ros.contracts.actions import ACTION_COUNT, table_hash
from raw2drive_ros.contracts.errors import CheckpointError
from raw2drive_ros.world_model.actor_critic import Policy
from raw2drive_ros.world_model.config import ModelConfig
from raw2drive_ros.world_model.parameter_budget import parameter_budget
from raw2drive_ros.world_model.run_files import TENSORS, checkpoint_of, load_modules, read_checkpoint, read_run, run_of
from raw2drive_ros.world_model.streams import PrivilegedWorldModel

FORMAT = 1
MANIFEST = 'teacher.json'
# The key that format 1 has for the metadata.
METADATA = 'facts'
# The slow critic and the advice head serve training alone: neither is needed to drive or to guide the raw stream.
LEFT_OUT = ('policy/critic.slow.', 'model/advice.')


@dataclass(slots=True)
class Teacher:
    """World model and policy of stage 1, without optimisers. gamma: discount per step, steps: gradient steps taken."""

    config: ModelConfig
    model: PrivilegedWorldModel
    policy: Policy
    gamma: float
    steps: int = 0

    def modules(self) -> dict[str, nn.Module]:
        return {'model': self.model, 'policy': self.policy}


def is_bundle(path: Path) -> bool:
    """Is `path` a teacher bundle, and not a run or a checkpoint?"""
    return (path / MANIFEST).is_file()


def load_teacher(path: Path) -> Teacher:
    """The privileged networks of a teacher bundle, a stage-1 run (its best or newest checkpoint) or one checkpoint.

    Raises CheckpointError.
    """
    if is_bundle(path):
        return _load_bundle(path)
    checkpoint = checkpoint_of(path)
    tensors, state = read_checkpoint(checkpoint)
    teacher = _untrained(read_run(run_of(checkpoint))['config'], checkpoint, TENSORS)
    load_modules(checkpoint, tensors, teacher.modules())
    teacher.steps = int(state['steps'])
    return teacher


def teacher_identity(path: Path) -> str:
    """A short hash of a teacher's weights. Raises CheckpointError."""
    if is_bundle(path):
        return str(read_manifest(path)['identity'])
    return hash_of_file(checkpoint_of(path) / TENSORS)[:16]


def save_teacher(target: Path, teacher: Teacher, config: dict[str, Any], metadata: dict[str, Any]) -> str:
    """Write a bundle; returns its identity. config: of the run, as in its `config.json`."""
    tensors = {
        f'{name}/{key}': value
        for name, module in teacher.modules().items()
        for key, value in module.state_dict().items()
        if not f'{name}/{key}'.startswith(LEFT_OUT)
    }
    with whole_folder(target) as folder:
        body = {
            'format': FORMAT,
            'raw2drive_version': __version__,
            'identity': save_weights(folder, tensors),
            'action_table': table_hash(),
            'steps': teacher.steps,
            'config': config,
            METADATA: metadata,
        }
        (folder / MANIFEST).write_text(json.dumps(body, indent=2) + '\n')
        (folder / CARD).write_text(_card(body, teacher.config))
    return str(body['identity'])


def read_manifest(path: Path) -> dict[str, Any]:
    """`teacher.json` of a bundle. Raises CheckpointError."""
    try:
        body: dict[str, Any] = read_json(path / MANIFEST)
        if not isinstance(body.get('config'), dict) or not isinstance(body.get(METADATA), dict):
            raise TypeError('config and facts have to be tables')
        check_manifest(path, body, 'teacher', FORMAT, {'action_table': table_hash()}, CheckpointError)
    except CheckpointError:
        raise
    except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
        raise CheckpointError(f'{path}: damaged teacher bundle: {error}') from error
    return body


def _untrained(config: dict[str, Any], source: Path, weights: str) -> Teacher:
    """Fresh networks of the sizes in `config`, `model` and `train` of a run, as far as the file `weights` in `source`
    can fill them. Raises CheckpointError."""
    try:
        model, train = ModelConfig(**config['model']), config['train']
        advised = float(train.get('weight_advice', 0.0)) > 0.0
        gamma = float(train['gamma'])
        with parameter_budget(source / weights, MAX_CHECKPOINT_BYTES):
            networks = PrivilegedWorldModel(model, model.ego_size, ACTION_COUNT, advised=advised)
            return Teacher(model, networks, Policy(model, ACTION_COUNT), gamma)
    except (ValueError, KeyError, TypeError, AttributeError, ArithmeticError, RuntimeError, IndexError) as error:
        # Whatever impossible sizes lead to when networks are built.
        reason = str(error).splitlines()[0] if str(error) else type(error).__name__
        raise CheckpointError(f'{source}: not the configuration of a stage-1 run: {reason}') from error


def _load_bundle(path: Path) -> Teacher:
    body = read_manifest(path)
    try:
        tensors = load_weights(path, body['identity'], CheckpointError)
        teacher = _untrained(body['config'], path, WEIGHTS)
        for key in [key for key in tensors if key.startswith('policy/critic.fast.')]:
            tensors[key.replace('.fast.', '.slow.')] = tensors[key]
        load_modules(path / WEIGHTS, tensors, teacher.modules())
        teacher.steps = int(body['steps'])
    except CheckpointError:
        raise
    except (OSError, ValueError, KeyError, TypeError, AttributeError, SafetensorError) as error:
        raise CheckpointError(f'{path}: damaged teacher bundle: {str(error).splitlines()[0]}') from error
    return teacher


def _card(body: dict[str, Any], config: ModelConfig) -> str:
    return model_card(
        f'Raw2Drive privileged teacher `{body["identity"]}`',
        'Drives from BEV masks and the ego vector of the simulation (privileged: no real vehicle has them); discrete '
        'actions at 10 Hz. Teaches the raw stream.',
        [
            f'RSSM {config.deter} + {config.stoch} x {config.classes}, masks {config.mask_size} x {config.mask_size} '
            f'of {len(config.mask_classes)} classes, {body["steps"]} gradient steps'
        ],
        body[METADATA],
    )
