"""Policy bundles: folders of data, never code, which the planner verifies before it uses them.

bundle.json   format, identity, model config, camera rig, action table and preprocessing hashes, metadata
weights.safetensors   float16 weights of the raw world model and the actor
MODEL_CARD.md
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from safetensors import SafetensorError

from raw2drive_ros import __version__
from raw2drive_ros.artifact import (
    CARD,
    WEIGHTS,
    check_manifest,
    load_weights,
    model_card,
    part_of,
    save_weights,
    short_hash,
    whole_folder,
)
from raw2drive_ros.bounds import MAX_WEIGHT_BYTES, read_json
from raw2drive_ros.contracts.actions import ACTION_COUNT, table_hash
from raw2drive_ros.contracts.errors import BundleError, ContractError
from raw2drive_ros.contracts.public import CameraCalibration
from raw2drive_ros.driving.preprocessing import REACHED_AHEAD_M
from raw2drive_ros.tables.vector_layout import CHECKPOINT_SCALE_M, VECTOR_FIELDS, VECTOR_SIZE
from raw2drive_ros.world_model.actor_critic import Actor
from raw2drive_ros.world_model.config import ModelConfig
from raw2drive_ros.world_model.parameter_budget import parameter_budget
from raw2drive_ros.world_model.streams import RawWorldModel

FORMAT = 1
MANIFEST = 'bundle.json'
# Key of the metadata in a manifest of format 1.
METADATA = 'facts'


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
    """Changes whenever the meaning of the raw vector does."""
    return short_hash(json.dumps([VECTOR_FIELDS, CHECKPOINT_SCALE_M, REACHED_AHEAD_M, 'rgb/255-0.5']).encode())


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
    tensors = {f'model/{key}': value for key, value in model.state_dict().items()}
    tensors |= {f'actor/{key}': value for key, value in actor.state_dict().items()}
    with whole_folder(path) as folder:
        body = {
            'format': FORMAT,
            'raw2drive_version': __version__,
            'weights_sha256_16': save_weights(folder, tensors),
            'action_table': table_hash(),
            'preprocessing': preprocessing_hash(),
            'heads': [name for name in ('reward', 'continue') if _has_head(model, name)],
            'config': config.model_dump(mode='json'),
            'rig': _rig_to_json(rig),
            METADATA: metadata,
        }
        body['identity'] = _identity(body)
        (folder / MANIFEST).write_text(json.dumps(body, indent=2) + '\n')
        (folder / CARD).write_text(_card(body, config))
    return str(body['identity'])


def _identity(body: dict[str, Any]) -> str:
    """Hash of everything but the metadata: bundles that drive identically have the same one."""
    same = {key: value for key, value in body.items() if key != 'identity'} | {METADATA: None}
    return short_hash(json.dumps(same, sort_keys=True).encode())


def _has_head(model: RawWorldModel, name: str) -> bool:
    return (model.reward if name == 'reward' else model.cont) is not None


def load_bundle(path: Path) -> Bundle:
    """Check every hash, that the weights are finite, and build the networks. Raises BundleError."""
    if not (path / MANIFEST).is_file():
        raise BundleError(
            f'{path}: no policy bundle there ({MANIFEST} is missing); '
            'train one with `raw2drive train raw`, or pass --bundle'
        )
    hashes = {'action_table': table_hash(), 'preprocessing': preprocessing_hash()}
    try:
        body = read_json(path / MANIFEST)
        check_manifest(path, body, 'bundle', FORMAT, hashes, BundleError)
        tensors = load_weights(path, body['weights_sha256_16'], BundleError)
        if _identity(body) != body['identity']:
            raise BundleError(f'{path}: {MANIFEST} does not match its identity {body["identity"]}')
        config = ModelConfig(**body['config'])
        rig = _rig_from_json(body['rig'])
        with parameter_budget(path / WEIGHTS, MAX_WEIGHT_BYTES):
            model = RawWorldModel(config, rig, VECTOR_SIZE, config.ego_size, ACTION_COUNT, tuple(body['heads']))
            actor = Actor(config, ACTION_COUNT)
        model.load_state_dict(part_of(tensors, 'model'))
        actor.load_state_dict(part_of(tensors, 'actor'))
    except BundleError:
        raise
    except (OSError, ValueError, KeyError, TypeError, RuntimeError, ContractError, SafetensorError) as error:
        raise BundleError(f'{path}: damaged bundle: {(str(error) or type(error).__name__).splitlines()[0]}') from error
    return Bundle(
        path,
        body['identity'],
        config,
        rig,
        model.requires_grad_(requires_grad=False).eval(),
        actor.requires_grad_(requires_grad=False).eval(),
        body[METADATA],
    )


def check_rig(bundle: Bundle, rig: tuple[CameraCalibration, ...], tolerance: float = 1e-6) -> None:
    """Raises BundleError that names every difference between a vehicle's cameras `rig` and those of the bundle."""
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


def _card(body: dict[str, Any], config: ModelConfig) -> str:
    return model_card(
        f'Raw2Drive raw policy `{body["identity"]}`',
        'Drives from six cameras, IMU, odometry and a sparse route; discrete actions at 10 Hz.',
        [
            f'image size: {config.image_size[0]} x {config.image_size[1]}, RSSM {config.deter} + '
            f'{config.stoch} x {config.classes}'
        ],
        body[METADATA],
    )
