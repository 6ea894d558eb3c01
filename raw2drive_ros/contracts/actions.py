"""The paper's 39 discrete actions, and the only place where their steering sign is converted to REP-103.

Order and values follow the paper's table (appendix, "Discrete Actions") with one correction: the row
of index 0 is printed with brake and steer exchanged; without the correction no action would brake.
The paper steers right with positive values; `ACTIONS` steers left with positive values.
"""

from __future__ import annotations

import hashlib

import numpy as np
from numpy.typing import NDArray

from raw2drive_ros.contracts.public import Control

# (throttle, brake, steer in the PAPER's sign, reverse)
_FORWARD_FAST = tuple((0.7, 0.0, s, False) for s in (-0.5, -0.3, -0.2, -0.1, 0.0, 0.1, 0.2, 0.3, 0.5))
_FORWARD_SLOW = tuple((0.3, 0.0, s, False) for s in (-0.7, -0.5, -0.3, -0.2, -0.1, 0.0, 0.1, 0.2, 0.3, 0.5, 0.7))
_COAST_LEFT = tuple((0.0, 0.0, s, False) for s in (-1.0, -0.6, -0.3, -0.1))
_COAST_RIGHT = tuple((0.0, 0.0, s, False) for s in (0.1, 0.3, 0.6, 1.0))
_REVERSE = tuple((0.5, 0.0, s, True) for s in (-0.5, -0.3, -0.2, -0.1, 0.0, 0.1, 0.2, 0.3, 0.5))
PAPER_TABLE = (
    (0.0, 1.0, 0.0, False),
    *_FORWARD_FAST,
    *_FORWARD_SLOW,
    *_COAST_LEFT,
    (1.0, 0.0, 0.0, False),
    *_COAST_RIGHT,
    *_REVERSE,
)

ACTIONS = tuple(
    Control(throttle, brake, -steer if steer else 0.0, reverse) for throttle, brake, steer, reverse in PAPER_TABLE
)
ACTION_COUNT = len(ACTIONS)
BRAKE_ACTION = 0

_FEATURES = np.array([(a.throttle - a.brake, a.steer, float(a.reverse)) for a in ACTIONS])
# A wrong direction is worse than any wrong pedal; steering matters more than throttle for where the car goes.
_SCALE = np.array([1.0, 2.0, 10.0])


def nearest_action(control: Control) -> int:
    """Index of the table's action closest to a continuous control."""
    wanted = np.array([control.throttle - control.brake, control.steer, float(control.reverse)])
    return int(np.argmin(np.square((_FEATURES - wanted) * _SCALE).sum(axis=1)))


def table_array() -> NDArray[np.float32]:
    """(39, 4) throttle, brake, steer (left positive), reverse."""
    return np.array([(a.throttle, a.brake, a.steer, a.reverse) for a in ACTIONS], np.float32)


def table_hash() -> str:
    """Identity of the table, kept in every policy bundle."""
    return hashlib.sha256(table_array().tobytes()).hexdigest()[:16]
