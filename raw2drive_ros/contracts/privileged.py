"""Privileged data: what only the simulator knows and only training may see.

The planner's process blocks this module (`raw2drive_ros.driving.isolation`), so nothing that runs
in the car can come to depend on it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from raw2drive_ros.contracts.errors import ContractError
from raw2drive_ros.tables.vector_layout import EGO_SIZE


@dataclass(frozen=True, slots=True)
class PrivilegedFrame:
    """Ground truth of one decision tick.

    bev: (C, H, W) bool, BEV masks, row 0 is far ahead, column 0 is left; channels: `tables.bev_channels`.
    ego: (5,) float32 in the order of `tables.vector_layout.EGO_FIELDS`.
    """

    stamp_ns: int
    bev: NDArray[np.bool_]
    ego: NDArray[np.float32]

    def validate(self) -> PrivilegedFrame:
        if self.bev.ndim != 3 or self.bev.dtype != np.bool_:
            raise ContractError(f'PrivilegedFrame.bev: {self.bev.dtype} {self.bev.shape}')
        if self.ego.shape != (EGO_SIZE,) or not np.isfinite(self.ego).all():
            raise ContractError(f'PrivilegedFrame.ego: {self.ego}')
        return self


@dataclass(frozen=True, slots=True)
class Transition:
    """The step that led to the frame with the same stamp.

    action: index of the executed action in the action table, the nearest one for continuous commands,
    -1 at the first frame. reward: the training signal; reward_terms: its named parts. is_terminal: the
    episode failed, with no future reward. is_last: the episode ends here, failed or not.
    """

    stamp_ns: int
    action: int
    reward: float
    reward_terms: dict[str, float]
    is_first: bool
    is_terminal: bool
    is_last: bool
