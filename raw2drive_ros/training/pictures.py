"""Pictures to check a loss curve against: true masks, their reconstruction and open-loop imagination, in rows."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import torch

from raw2drive_ros.tables.bev_colours import colour_masks
from raw2drive_ros.training.privileged import PrivilegedTrainer
from raw2drive_ros.training.raw import RawTrainer
from raw2drive_ros.training.replay import Batch
from raw2drive_ros.world_model.agent import imagine_open_loop
from raw2drive_ros.world_model.mask_codec import MaskCodec
from raw2drive_ros.world_model.rssm import State

CONTEXT = 5
DREAM_TICKS = 10


@torch.no_grad()
def open_loop(
    trainer: PrivilegedTrainer | RawTrainer, batch: Batch, count: int = 1
) -> tuple[torch.Tensor, torch.Tensor]:
    """(reconstruction, open loop) mask probabilities (count, T, C*P*P, G, G) of a batch's first sequences.

    Open loop: posterior for `CONTEXT` steps, then the prior alone on the recorded actions.
    """
    rng = trainer.generator.get_state()
    states = trainer.filtered(batch)
    trainer.generator.set_state(rng)
    rssm, decoder = trainer.model.rssm, trainer.model.decoder
    length = batch.action.shape[1]
    seen = min(CONTEXT, length)
    features = [states.feature[:count, t] for t in range(seen)]
    start = State(states.deter[:count, seen - 1], states.stoch[:count, seen - 1])
    # Constant instead of random: the same batch gives the same picture.
    uniforms = [torch.full((len(start.deter), rssm.config.stoch), 0.5)] * (length - seen)
    actions, is_first = batch.action[:count, seen:], batch.is_first[:count, seen:]
    features += [state.feature for state in imagine_open_loop(rssm, start, actions, uniforms, is_first)]
    shown = states.feature[:count]
    posterior = torch.sigmoid(decoder(shown.flatten(0, 1))).unflatten(0, shown.shape[:2])
    dreamed = torch.sigmoid(decoder(torch.stack(features, 1).flatten(0, 1))).unflatten(0, shown.shape[:2])
    return posterior, dreamed


def overlap_by_class(trainer: PrivilegedTrainer | RawTrainer, batch: Batch) -> dict[str, float]:
    """Intersection over union of each mask class, over the pixels of the whole batch.

    `iou/<class>` of the posterior, `iou_dream/<class>` of open-loop imagination `DREAM_TICKS` after the last frame
    that was seen. Classes that do not occur in the batch are left out.
    """
    posterior, dreamed = open_loop(trainer, batch, len(batch.action))
    names = list(trainer.config.model.mask_classes)
    found: dict[str, float] = {}
    moment = CONTEXT - 1 + DREAM_TICKS
    shown = {'iou': (posterior, batch.masks)}
    if moment < dreamed.shape[1]:
        shown['iou_dream'] = (dreamed[:, moment], batch.masks[:, moment])
    for kind, (guess, truth) in shown.items():
        here, there = (x.unflatten(-3, (len(names), -1)).movedim(-4, 0).flatten(1) > 0.5 for x in (guess, truth))
        both, either = (here & there).sum(1), (here | there).sum(1)
        found |= {f'{kind}/{name}': float(both[i] / either[i]) for i, name in enumerate(names) if there[i].any()}
    return found


def save_pictures(folder: Path, trainer: PrivilegedTrainer | RawTrainer, batch: Batch, codec: MaskCodec) -> Path:
    """A filmstrip of truth, reconstruction and imagination over time, as `folder/<step>.png`."""
    folder.mkdir(parents=True, exist_ok=True)
    posterior, dreamed = open_loop(trainer, batch)
    names = list(trainer.config.model.mask_classes)
    rows = []
    for deep in (batch.masks[0], posterior[0], dreamed[0]):
        frames = codec.to_image_order(deep.numpy())
        step = max(1, len(frames) // 8)
        row = [colour_masks(f, names) for f in frames[::step]]
        rows.append(np.hstack([np.pad(f, ((1, 1), (1, 1), (0, 0)), constant_values=128) for f in row]))
    path = folder / f'{trainer.steps:08d}.png'
    picture = cv2.resize(np.vstack(rows), None, fx=2, fy=2, interpolation=cv2.INTER_NEAREST)
    cv2.imwrite(str(path), picture[..., ::-1])
    return path
