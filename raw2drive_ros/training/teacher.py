"""The privileged networks as others use them: of a run, of one of its checkpoints, or of a teacher bundle.

A teacher bundle is a folder of data:

teacher.json   format, identity, configuration, action table hash, metadata
weights.safetensors   float16 weights of the world model, the actor and the critic
MODEL_CARD.md
"""

from __future__ import annotations

import hashlib
import json
import shutil
from pathlib import Path
from typing import Any

from safetensors import SafetensorError
from safetensors.torch import load_file, save_file

from raw2drive_ros import __version__
from raw2drive_ros.actions import table_hash
from raw2drive_ros.errors import CheckpointError
from raw2drive_ros.training.checkpoint import load_weights, newest_checkpoint
from raw2drive_ros.training.config import RunConfig
from raw2drive_ros.training.privileged import PrivilegedTrainer

FORMAT = 1
# Where a recipe keeps the checkpoint that drove best on its validation suite.
BEST = 'best'
# The slow critic steadies learning and the advice head teaches the states: neither is needed to drive or to guide.
LEFT_OUT = ('policy/critic.slow.', 'model/advice.')


def read_run_config(run: Path) -> RunConfig:
    """The configuration of an existing run. Raises CheckpointError."""
    try:
        return RunConfig(**json.loads((run / 'config.json').read_text())['config'])
    except (OSError, ValueError, KeyError) as error:
        raise CheckpointError(f'{run}: not a training run (config.json: {error})') from error


def checkpoint_of(path: Path) -> Path:
    """`path` itself where it is a checkpoint, else the best or newest one of the run `path`. Raises CheckpointError."""
    if (path / 'tensors.safetensors').is_file():
        return path
    if (path / BEST / 'tensors.safetensors').is_file():
        return path / BEST
    read_run_config(path)
    checkpoint = newest_checkpoint(path / 'checkpoints')
    if checkpoint is None:
        raise CheckpointError(f'{path}: has no checkpoint yet; run `raw2drive train privileged` first')
    return checkpoint


def load_teacher(path: Path) -> PrivilegedTrainer:
    """The privileged networks of a teacher bundle, a stage-1 run (its best or newest checkpoint) or one checkpoint.

    Raises CheckpointError.
    """
    if (path / 'teacher.json').is_file():
        return _load_bundle(path)
    checkpoint = checkpoint_of(path)
    run = next((p for p in checkpoint.parents if (p / 'config.json').is_file()), path)
    teacher = PrivilegedTrainer(read_run_config(run))
    load_weights(checkpoint, teacher)
    return teacher


def teacher_identity(path: Path) -> str:
    """Tells teachers apart by their weights. Raises CheckpointError."""
    if (path / 'teacher.json').is_file():
        return str(_read(path)['identity'])
    return _hash((checkpoint_of(path) / 'tensors.safetensors').read_bytes())


def save_teacher(target: Path, source: Path, metadata: dict[str, Any]) -> str:
    """Write the teacher of a run or checkpoint as a bundle; returns its identity. Raises CheckpointError."""
    teacher = load_teacher(source)
    config = teacher.config
    kept = {
        f'{name}/{key}': value.detach().half().contiguous()
        for name, module in teacher.modules().items()
        for key, value in module.state_dict().items()
        if not f'{name}/{key}'.startswith(LEFT_OUT)
    }
    train = config.train.model_copy(update={'weight_advice': 0.0})
    partial = target.with_name(target.name + '.partial')
    shutil.rmtree(partial, ignore_errors=True)
    partial.mkdir(parents=True)
    save_file(kept, partial / 'weights.safetensors')
    (partial / 'weights.safetensors').chmod(0o644)
    body = {
        'format': FORMAT,
        'raw2drive_version': __version__,
        'identity': _hash((partial / 'weights.safetensors').read_bytes()),
        'action_table': table_hash(),
        'steps': teacher.steps,
        'config': config.model_copy(update={'train': train}).model_dump(mode='json'),
        'facts': metadata,
    }
    (partial / 'teacher.json').write_text(json.dumps(body, indent=2) + '\n')
    (partial / 'MODEL_CARD.md').write_text(_model_card(body))
    shutil.rmtree(target, ignore_errors=True)
    partial.replace(target)
    return str(body['identity'])


def run_metadata(run: Path) -> dict[str, Any]:
    """What a model card says of a run: its bags, its length, its validation. Raises CheckpointError."""
    read_run_config(run)
    bags = json.loads((run / 'config.json').read_text())['bags']
    metadata: dict[str, Any] = {
        'training_ticks': sum(bag['ticks'] for bag in bags),
        'training_bags': [bag['id'] for bag in bags],
    }
    if (run / BEST / 'score.json').is_file():
        metadata['validation'] = json.loads((run / BEST / 'score.json').read_text())
    return metadata


def _read(path: Path) -> dict[str, Any]:
    try:
        body: dict[str, Any] = json.loads((path / 'teacher.json').read_text())
        if body['format'] != FORMAT:
            raise CheckpointError(f'{path}: teacher format {body["format"]}, this version reads {FORMAT}')
        if body['action_table'] != table_hash():
            raise CheckpointError(f'{path}: was trained on another action table than this version has')
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise CheckpointError(f'{path}: damaged teacher bundle: {error}') from error
    return body


def _load_bundle(path: Path) -> PrivilegedTrainer:
    body = _read(path)
    file = path / 'weights.safetensors'
    try:
        if _hash(file.read_bytes()) != body['identity']:
            raise CheckpointError(f'{path}: weights do not match their hash; the file is damaged or replaced')
        teacher = PrivilegedTrainer(RunConfig(**body['config']))
        tensors = {key: value.float() for key, value in load_file(file).items()}
        for key in [key for key in tensors if key.startswith('policy/critic.fast.')]:
            tensors[key.replace('.fast.', '.slow.')] = tensors[key]
        for name, module in teacher.modules().items():
            module.load_state_dict({k.removeprefix(f'{name}/'): v for k, v in tensors.items() if k.startswith(name)})
        teacher.steps = int(body['steps'])
    except (OSError, ValueError, KeyError, RuntimeError, SafetensorError) as error:
        if isinstance(error, CheckpointError):
            raise
        raise CheckpointError(f'{path}: damaged teacher bundle: {str(error).splitlines()[0]}') from error
    return teacher


def _hash(data: bytes) -> str:
    return hashlib.sha256(data).hexdigest()[:16]


def _short(value: Any) -> Any:
    """What people read of a fact; lists of identities are in teacher.json."""
    return len(value) if isinstance(value, list) else value


def _model_card(body: dict[str, Any]) -> str:
    model = body['config']['model']
    lines = [
        f'# Raw2Drive privileged teacher `{body["identity"]}`',
        '',
        'Drives from BEV masks and the ego vector of the simulation (privileged: no real vehicle has them); discrete '
        'actions at 10 Hz. Teaches the raw stream.',
        '',
        f'- RSSM {model["deter"]} + {model["stoch"]} x {model["classes"]}, masks {model["mask_size"]} x '
        f'{model["mask_size"]} of {len(model["mask_classes"])} classes, {body["steps"]} gradient steps',
        *(f'- {key}: {_short(value)}' for key, value in body['facts'].items()),
        '',
        'Made in and for the highway-env simulation of this repository; not for real roads.',
        '',
    ]
    return '\n'.join(lines)
