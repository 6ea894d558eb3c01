"""What a privileged model reads of a frame, by its configuration: which masks, and which fields of which vectors."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from raw2drive_ros.contracts import topics
from raw2drive_ros.contracts.errors import ContractError
from raw2drive_ros.contracts.privileged import PrivilegedFrame
from raw2drive_ros.tables.vector_layout import EGO_FIELDS, SIGNAL_FIELDS
from raw2drive_ros.world_model.config import ModelConfig


def extra_topics(config: ModelConfig) -> tuple[str, ...]:
    """The topics that a model of this configuration reads besides masks and ego vector, which every bag has."""
    signals = any(name in SIGNAL_FIELDS for name in config.ego_fields)
    return (topics.BEV_VISIBLE,) * (config.masks == 'visible') + (topics.SIGNALS,) * signals


def masks_of(frame: PrivilegedFrame, config: ModelConfig) -> NDArray[np.bool_]:
    """(C, H, W) bool: all masks, or those of what was seen. Raises ContractError where the frame lacks them."""
    if config.masks == 'all':
        return frame.bev
    if frame.bev_visible is None:
        raise ContractError(f'the model reads the masks of what was seen: there is no {topics.BEV_VISIBLE}')
    return frame.bev_visible


def vector_of(frame: PrivilegedFrame, config: ModelConfig) -> NDArray[np.float32]:
    """(len(config.ego_fields),) float32. Raises ContractError that names the fields which the frame lacks."""
    values = dict(zip(EGO_FIELDS, frame.ego, strict=False))
    if frame.signals is not None:
        values |= dict(zip(SIGNAL_FIELDS, frame.signals, strict=True))
    if missing := [name for name in config.ego_fields if name not in values]:
        raise ContractError(
            f'the model reads {", ".join(missing)}: not in {topics.EGO} and {topics.SIGNALS} of an older simulator'
        )
    return np.array([values[name] for name in config.ego_fields], np.float32)
