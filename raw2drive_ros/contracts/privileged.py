"""Privileged data: what only the simulator knows and only training may see.

The planner's process blocks this module (`raw2drive_ros.driving.isolation`), so nothing that runs
in the car can come to depend on it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from raw2drive_ros.contracts.actions import ACTION_COUNT
from raw2drive_ros.contracts.errors import ContractError
from raw2drive_ros.tables.bev_channels import CHANNEL_COUNT, SIZE_PX
from raw2drive_ros.tables.vector_layout import EGO_FIELDS, EGO_SIZE

BEV_SHAPE = (CHANNEL_COUNT, SIZE_PX, SIZE_PX)
# Of a step, and of each of its terms. In this simulation none exceeds 1 + the speed of a collision in m/s.
LARGEST_REWARD = 1000.0
# Lowest and highest value of each field; steering and pedals are shares, which may exceed their range by rounding.
ROUNDING = 1e-3
EGO_RANGES = {
    'speed_mps': (-150.0, 150.0),
    'steer': (-1.0 - ROUNDING, 1.0 + ROUNDING),
    'throttle': (-ROUNDING, 1.0 + ROUNDING),
    'brake': (-ROUNDING, 1.0 + ROUNDING),
    'yaw_rate_radps': (-50.0, 50.0),
}


def check_bev(bev: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """The same masks, (C, H, W) bool of `BEV_SHAPE`. Raises ContractError for others."""
    if bev.dtype != np.bool_ or bev.shape != BEV_SHAPE:
        raise ContractError(f'BEV masks: {bev.dtype} {bev.shape}, not bool {BEV_SHAPE}')
    return bev


def check_ego(ego: NDArray[np.float32]) -> NDArray[np.float32]:
    """The same vector, (5,), every value finite and within `EGO_RANGES`. Raises ContractError otherwise."""
    if ego.shape != (EGO_SIZE,):
        raise ContractError(f'ego vector: shape {ego.shape}, not ({EGO_SIZE},)')
    for name, value in zip(EGO_FIELDS, ego.tolist(), strict=True):
        low, high = EGO_RANGES[name]
        if not low <= value <= high:
            raise ContractError(f'ego vector: {name} is {value:g}, outside [{low:g}, {high:g}]')
    return ego


def check_advice(action: float) -> int:
    """The expert's action. Raises ContractError for what is no index in the action table."""
    if action not in range(ACTION_COUNT):
        raise ContractError(f'advice: action {action:g} is not in the table of {ACTION_COUNT}')
    return int(action)


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
        check_bev(self.bev)
        check_ego(self.ego)
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

    def validate(self) -> Transition:
        if self.action not in range(-1, ACTION_COUNT):
            raise ContractError(f'Transition.action {self.action} is not -1 and not in the table of {ACTION_COUNT}')
        for name, value in (('reward', self.reward), *self.reward_terms.items()):
            if not abs(value) <= LARGEST_REWARD:
                raise ContractError(f'Transition: {name} is {value:g}, outside +-{LARGEST_REWARD:g}')
        return self
