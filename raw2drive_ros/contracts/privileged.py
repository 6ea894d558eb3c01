"""Privileged data: what only the simulator knows and only training may see.

The planner's process blocks this module (`raw2drive_ros.driving.isolation`), so nothing that runs
in the car can come to depend on it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from raw2drive_ros.contracts.actions import ACTION_COUNT
from raw2drive_ros.contracts.errors import ContractError
from raw2drive_ros.contracts.topics import CAMERAS
from raw2drive_ros.tables.actor_classes import ACTOR_CLASSES, LIGHT_CLASSES, SIGN_CLASSES
from raw2drive_ros.tables.bev_channels import CHANNEL_COUNT, SIZE_PX
from raw2drive_ros.tables.vector_layout import (
    BASIC_EGO_FIELDS,
    EGO_FIELDS,
    EGO_SIZE,
    LIGHT_FIELDS,
    SIGNAL_FIELDS,
    SIGNAL_RANGE_M,
    SIGNAL_SIZE,
)

BEV_SHAPE = (CHANNEL_COUNT, SIZE_PX, SIZE_PX)
# Of a step, and of each of its terms. In this simulation none exceeds 1 + the speed of a collision in m/s.
LARGEST_REWARD = 1000.0
# Lowest and highest value of each field; steering and pedals are shares, which may exceed their range by rounding.
ROUNDING = 1e-3
MAX_SPEED_MPS = 150.0
EGO_RANGES = {
    'speed_mps': (-MAX_SPEED_MPS, MAX_SPEED_MPS),
    'steer': (-1.0 - ROUNDING, 1.0 + ROUNDING),
    'throttle': (-ROUNDING, 1.0 + ROUNDING),
    'brake': (-ROUNDING, 1.0 + ROUNDING),
    'yaw_rate_radps': (-50.0, 50.0),
    'lateral_offset_m': (-1000.0, 1000.0),
    'heading_error_rad': (-math.pi - ROUNDING, math.pi + ROUNDING),
}
# A line governs until the front bumper is this far behind it.
PASSED_M = 1.0
SIGNAL_FLAGS = (*LIGHT_FIELDS, 'stop_sign', 'stop_sign_obeyed', 'yield_sign')
_DISTANCE = (-PASSED_M - ROUNDING, SIGNAL_RANGE_M + ROUNDING)
SIGNAL_RANGES = {
    'light_distance_m': _DISTANCE,
    'stop_sign_distance_m': _DISTANCE,
    'yield_sign_distance_m': _DISTANCE,
    'speed_limit_mps': (0.0, MAX_SPEED_MPS),
} | dict.fromkeys(SIGNAL_FLAGS, (0.0, 1.0))
# Rows of one tick: more than any simulation here has within `ACTOR_RANGE_M`.
MAX_ACTORS = 1024
MAX_REASON_CHARACTERS = 200
PIXEL_FIELDS = tuple(f'pixels_{camera}' for camera in CAMERAS)
# One row of `/privileged/actors`; every member starts at a multiple of its size, and there is no padding.
ACTOR_DTYPE = np.dtype(
    [
        *((name, '<f4') for name in ('x', 'y', 'z', 'yaw_rad', 'length_m', 'width_m', 'height_m', 'vx_mps', 'vy_mps')),
        ('since_seen_s', '<f4'),
        ('number', '<u4'),
        *((name, '<u4') for name in PIXEL_FIELDS),
        ('class', '<u2'),
        ('braking', 'u1'),
        ('indicator', 'i1'),
    ]
)
ACTOR_RANGES = {
    'x': (-1000.0, 1000.0),
    'y': (-1000.0, 1000.0),
    'z': (-1000.0, 1000.0),
    'yaw_rad': (-math.pi - ROUNDING, math.pi + ROUNDING),
    'length_m': (0.0, 100.0),
    'width_m': (0.0, 100.0),
    'height_m': (0.0, 100.0),
    'vx_mps': (-MAX_SPEED_MPS, MAX_SPEED_MPS),
    'vy_mps': (-MAX_SPEED_MPS, MAX_SPEED_MPS),
    # Infinite for what was never seen.
    'since_seen_s': (0.0, math.inf),
    'class': (0, len(ACTOR_CLASSES) - 1),
    'braking': (0, 1),
    'indicator': (-1, 1),
}
_LIGHTS = tuple(ACTOR_CLASSES.index(name) for name in LIGHT_CLASSES)
_SIGNS = tuple(ACTOR_CLASSES.index(name) for name in SIGN_CLASSES)
# (N,) rows of `ACTOR_DTYPE`.
ActorRows = NDArray[np.void]


def check_bev(bev: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """The same masks, (C, H, W) bool of `BEV_SHAPE`. Raises ContractError for others."""
    if bev.dtype != np.bool_ or bev.shape != BEV_SHAPE:
        raise ContractError(f'BEV masks: {bev.dtype} {bev.shape}, not bool {BEV_SHAPE}')
    return bev


def check_ego(ego: NDArray[np.float32]) -> NDArray[np.float32]:
    """The same vector, (7,), or (5,) of an old bag, within `EGO_RANGES`. Raises ContractError for others."""
    if ego.shape not in ((EGO_SIZE,), (len(BASIC_EGO_FIELDS),)):
        raise ContractError(f'ego vector: shape {ego.shape}, not ({EGO_SIZE},)')
    for name, value in zip(EGO_FIELDS, ego.tolist(), strict=False):
        low, high = EGO_RANGES[name]
        if not low <= value <= high:
            raise ContractError(f'ego vector: {name} is {value:g}, outside [{low:g}, {high:g}]')
    return ego


def check_signals(signals: NDArray[np.float32]) -> NDArray[np.float32]:
    """The same vector, (11,) in the order of `SIGNAL_FIELDS`. Raises ContractError for impossible values."""
    if signals.shape != (SIGNAL_SIZE,):
        raise ContractError(f'signals: shape {signals.shape}, not ({SIGNAL_SIZE},)')
    values = dict(zip(SIGNAL_FIELDS, signals.tolist(), strict=True))
    for name, value in values.items():
        low, high = SIGNAL_RANGES[name]
        if not low <= value <= high:
            raise ContractError(f'signals: {name} is {value:g}, outside [{low:g}, {high:g}]')
        if name in SIGNAL_FLAGS and value not in (0.0, 1.0):
            raise ContractError(f'signals: {name} is {value:g}, not 0 or 1')
    if (lit := sum(values[name] for name in LIGHT_FIELDS)) != 1.0:
        raise ContractError(f'signals: {lit:g} of {", ".join(LIGHT_FIELDS)} are 1, not one')
    return signals


def check_actors(rows: ActorRows) -> ActorRows:
    """The same rows. Raises ContractError for more than `MAX_ACTORS`, for values outside `ACTOR_RANGES` and where two
    actors, two lights or two signs have one number."""
    if rows.dtype != ACTOR_DTYPE or rows.ndim != 1:
        raise ContractError(f'actors: {rows.dtype} {rows.shape} are no rows of ACTOR_DTYPE')
    if len(rows) > MAX_ACTORS:
        raise ContractError(f'actors: {len(rows)} of them, more than {MAX_ACTORS}')
    for name, (low, high) in ACTOR_RANGES.items():
        column = rows[name]
        wrong = ~((column >= low) & (column <= high))
        if wrong.any():
            row = int(np.flatnonzero(wrong)[0])
            raise ContractError(f'actors: {name} of row {row} is {column[row]:g}, outside [{low:g}, {high:g}]')
    groups = np.isin(rows['class'], _LIGHTS) * 1 + np.isin(rows['class'], _SIGNS) * 2
    keys = groups.astype(np.uint64) << np.uint64(32) | rows['number'].astype(np.uint64)
    if len(np.unique(keys)) < len(rows):
        raise ContractError('actors: two rows have one number')
    return rows


def check_reason(reason: str) -> str:
    """The same text. Raises ContractError for one that is long or holds control characters."""
    if len(reason) > MAX_REASON_CHARACTERS or not reason.isprintable():
        raise ContractError(f'advice: a reason of {len(reason)} characters, or with control characters')
    return reason


def check_advice(action: float) -> int:
    """The expert's action. Raises ContractError for what is no index in the action table."""
    if action not in range(ACTION_COUNT):
        raise ContractError(f'advice: action {action:g} is not in the table of {ACTION_COUNT}')
    return int(action)


@dataclass(frozen=True, slots=True)
class Advice:
    """What the expert would do at the frame of that stamp. reason: the rule that it follows and the actor that it
    minds, for people; '' where it says none."""

    stamp_ns: int
    action: int
    reason: str = ''

    def validate(self) -> Advice:
        check_advice(self.action)
        check_reason(self.reason)
        return self


@dataclass(frozen=True, slots=True)
class PrivilegedFrame:
    """Ground truth of one decision tick.

    bev: (C, H, W) bool, BEV masks, row 0 is far ahead, column 0 is left; channels: `tables.bev_channels`.
    ego: (7,) float32 in the order of `tables.vector_layout.EGO_FIELDS`; (5,) in old bags.

    The rest is None where no visibility was computed, in old bags, and where a reader did not ask for it.
    bev_visible: like bev, with dynamic masks that hold only what was seen within the last 2 s. actors: (N,) rows of
    `ACTOR_DTYPE` in `base_link`. signals: (11,) float32 in the order of `SIGNAL_FIELDS`.
    """

    stamp_ns: int
    bev: NDArray[np.bool_]
    ego: NDArray[np.float32]
    bev_visible: NDArray[np.bool_] | None = None
    actors: ActorRows | None = None
    signals: NDArray[np.float32] | None = None

    def validate(self) -> PrivilegedFrame:
        check_bev(self.bev)
        check_ego(self.ego)
        if self.bev_visible is not None:
            check_bev(self.bev_visible)
        if self.actors is not None:
            check_actors(self.actors)
        if self.signals is not None:
            check_signals(self.signals)
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
