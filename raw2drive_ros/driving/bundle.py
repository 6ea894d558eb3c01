"""Policy bundles: a folder of data, never code, that a planner can check before it trusts it.

bundle.json   format, identity, model config, camera rig, action table and preprocessing hashes, metadata
weights.safetensors   float16 weights of the raw world model and the actor
MODEL_CARD.md
"""

from __future__ import annotations

import hashlib
import json
import shutil
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from safetensors import SafetensorError
from safetensors.torch import load_file, save_file
from torch import Tensor

from raw2drive_ros import __version__
from raw2drive_ros.actions import ACTION_COUNT, table_hash
from raw2drive_ros.contract import CameraCalibration
from raw2drive_ros.driving.preprocessing import REACHED_AHEAD_M
from raw2drive_ros.errors import BundleError, ContractError
from raw2drive_ros.vector_layout import CHECKPOINT_SCALE_M, VECTOR_FIELDS
from raw2drive_ros.world_model.actor_critic import Actor
from raw2drive_ros.world_model.config import ModelConfig
from raw2drive_ros.world_model.streams import RawWorldModel

FORMAT = 1
EGO_SIZE = 5
MAX_WEIGHT_BYTES = 2_000_000_000


@dataclass(slots=True)
class Bundle:
    """A loaded bundle. identity: hash of config and weights, published with every diagnostic."""

    path: Path
    identity: str
    config: ModelConfig
    rig: tuple[CameraCalibration, ...]
    model: RawWorldModel
    actor: Actor
    metadata: dict[str, Any]


def preprocessing_hash() -> str:
    """Changes when the raw vector would mean something else."""
    return _hash(json.dumps([VECTOR_FIELDS, CHECKPOINT_SCALE_M, REACHED_AHEAD_M, 'rgb/255-0.5']).encode())


def _hash(data: bytes) -> str:
    return hashlib.sha256(data).hexdigest()[:16]


def _rig_to_json(rig: tuple[CameraCalibration, ...]) -> list[dict[str, Any]]:
    return [
        {
            'name': c.name,
            'width': c.width,
            'height': c.height,
            'intrinsics': c.intrinsics.tolist(),
            'base_from_camera': c.base_from_camera.tolist(),
        }
        for c in rig
    ]


def _rig_from_json(stored: list[dict[str, Any]]) -> tuple[CameraCalibration, ...]:
    return tuple(
        CameraCalibration(
            str(c['name']),
            int(c['width']),
            int(c['height']),
            np.array(c['intrinsics'], np.float64),
            np.array(c['base_from_camera'], np.float64),
        ).validate()
        for c in stored
    )


def save_bundle(
    path: Path,
    config: ModelConfig,
    rig: tuple[CameraCalibration, ...],
    model: RawWorldModel,
    actor: Actor,
    metadata: dict[str, Any],
) -> str:
    """Write a bundle atomically and return its identity. metadata: bags, steps, metrics, command lines."""
    partial = path.with_name(path.name + '.partial')
    shutil.rmtree(partial, ignore_errors=True)
    partial.mkdir(parents=True)
    tensors: dict[str, Tensor] = {f'model/{k}': v for k, v in model.state_dict().items()}
    tensors |= {f'actor/{k}': v for k, v in actor.state_dict().items()}
    save_file(
        {k: v.detach().clone().half().contiguous() for k, v in tensors.items()},
        partial / 'weights.safetensors',
    )
    # safetensors makes files that only their owner can read; a bundle is there to be shared.
    (partial / 'weights.safetensors').chmod(0o644)
    weights = _hash((partial / 'weights.safetensors').read_bytes())
    body = {
        'format': FORMAT,
        'raw2drive_version': __version__,
        'weights_sha256_16': weights,
        'action_table': table_hash(),
        'preprocessing': preprocessing_hash(),
        'heads': [name for name in ('reward', 'continue') if _has_head(model, name)],
        'config': config.model_dump(mode='json'),
        'rig': _rig_to_json(rig),
        'facts': metadata,
    }
    identity = _hash(json.dumps(body | {'facts': None}, sort_keys=True).encode())
    body['identity'] = identity
    (partial / 'bundle.json').write_text(json.dumps(body, indent=2) + '\n')
    (partial / 'MODEL_CARD.md').write_text(_model_card(identity, config, metadata))
    shutil.rmtree(path, ignore_errors=True)
    partial.replace(path)
    return identity


def _has_head(model: RawWorldModel, name: str) -> bool:
    return (model.reward if name == 'reward' else model.cont) is not None


def load_bundle(path: Path) -> Bundle:
    """Check every hash, then build the networks. Raises BundleError."""
    if not (path / 'bundle.json').is_file():
        raise BundleError(
            f'{path}: no policy bundle there (bundle.json is missing); '
            'train one with `raw2drive train raw`, or pass --bundle'
        )
    try:
        body = json.loads((path / 'bundle.json').read_text())
        if body['format'] != FORMAT:
            raise BundleError(f'{path}: bundle format {body["format"]}, this version reads {FORMAT}')
        for name, ours in (('action_table', table_hash()), ('preprocessing', preprocessing_hash())):
            if body[name] != ours:
                raise BundleError(f'{path}: {name} hash {body[name]} differs from this version: {ours}')
        file = path / 'weights.safetensors'
        if file.stat().st_size > MAX_WEIGHT_BYTES:
            raise BundleError(f'{path}: weights of {file.stat().st_size} bytes are implausible')
        if _hash(file.read_bytes()) != body['weights_sha256_16']:
            raise BundleError(f'{path}: weights do not match their hash; the file is damaged or replaced')
        identity = _hash(
            json.dumps({k: v for k, v in body.items() if k != 'identity'} | {'facts': None}, sort_keys=True).encode()
        )
        if identity != body['identity']:
            raise BundleError(f'{path}: bundle.json does not match its identity {body["identity"]}')
        config = ModelConfig(**body['config'])
        rig = _rig_from_json(body['rig'])
        model = RawWorldModel(config, rig, len(VECTOR_FIELDS), EGO_SIZE, ACTION_COUNT, tuple(body['heads']))
        actor = Actor(config, ACTION_COUNT)
        tensors = {k: v.float() for k, v in load_file(file).items()}
        model.load_state_dict({k[6:]: v for k, v in tensors.items() if k.startswith('model/')})
        actor.load_state_dict({k[6:]: v for k, v in tensors.items() if k.startswith('actor/')})
    except BundleError:
        raise
    except (OSError, ValueError, KeyError, TypeError, RuntimeError, ContractError, SafetensorError) as error:
        raise BundleError(f'{path}: damaged bundle: {str(error).splitlines()[0]}') from error
    return Bundle(
        path,
        identity,
        config,
        rig,
        model.requires_grad_(False).eval(),
        actor.requires_grad_(False).eval(),
        body['facts'],
    )


def check_rig(bundle: Bundle, rig: tuple[CameraCalibration, ...], tolerance: float = 1e-6) -> None:
    """Raises BundleError that names every difference between a vehicle's cameras and the bundle's."""
    wanted = {c.name: c for c in bundle.rig}
    found = {c.name: c for c in rig}
    problems = [f'camera {name} is missing' for name in wanted if name not in found]
    problems += [f'camera {name} is unknown to the bundle' for name in found if name not in wanted]
    for name in wanted.keys() & found.keys():
        ours, theirs = wanted[name], found[name]
        if (ours.width, ours.height) != (theirs.width, theirs.height):
            problems.append(
                f'camera {name} is {theirs.height}x{theirs.width}, the bundle needs {ours.height}x{ours.width}'
            )
        elif not np.allclose(ours.intrinsics, theirs.intrinsics, atol=tolerance):
            problems.append(f'camera {name} has other intrinsics')
        elif not np.allclose(ours.base_from_camera, theirs.base_from_camera, atol=tolerance):
            problems.append(f'camera {name} is mounted elsewhere')
    if problems:
        raise BundleError(f'{bundle.path}: cameras do not match: ' + '; '.join(sorted(problems)))


def _model_card(identity: str, config: ModelConfig, metadata: dict[str, Any]) -> str:
    lines = [
        f'# Raw2Drive raw policy `{identity}`',
        '',
        'Drives from six cameras, IMU, odometry and a sparse route; discrete actions at 10 Hz.',
        '',
        f'- image size: {config.image_size[0]} x {config.image_size[1]}, RSSM {config.deter} + '
        f'{config.stoch} x {config.classes}',
        *(f'- {key}: {value}' for key, value in metadata.items()),
        '',
        'Made in and for the highway-env simulation of this repository; not for real roads.',
        '',
    ]
    return '\n'.join(lines)
