"""How a scenario declares its road: a chain of straights, curves and junctions, laid end to end."""

from __future__ import annotations

import math
from dataclasses import dataclass

LANE_WIDTH_M = 3.5
ARM_LENGTH_M = 60.0
CORNER_RADIUS_M = 7.0


@dataclass(frozen=True, slots=True)
class Straight:
    """A straight piece. ramp: with an acceleration lane on the right, fed by an on-ramp. exit: with a deceleration
    lane on the right that leads to an off-ramp."""

    length_m: float
    ramp: bool = False
    exit: bool = False


@dataclass(frozen=True, slots=True)
class Curve:
    """An arc; positive angles turn left."""

    radius_m: float
    angle_rad: float


@dataclass(frozen=True, slots=True)
class Junction:
    """A junction that the chain leaves by `turn`.

    arms: all arms but the one that the chain enters by. control: none, light, stop or yield.
    """

    turn: str = 'ahead'
    arms: tuple[str, ...] = ('left', 'right', 'ahead')
    control: str = 'none'

    def __post_init__(self) -> None:
        known = {'left', 'right', 'ahead'}
        if self.turn not in self.arms or not set(self.arms) <= known:
            raise ValueError(f'Junction: turn {self.turn!r} must be one of arms {self.arms}, all in {known}')
        if self.control not in ('none', 'light', 'stop', 'yield'):
            raise ValueError(f'Junction: unknown control {self.control!r}')


def turn_length_m(turn: str, lanes: int = 1, lane: int = 0) -> float:
    """Length (m) of lane `lane` through a junction of roads with `lanes` lanes each way."""
    half, offset = lanes * LANE_WIDTH_M + CORNER_RADIUS_M, (lane + 0.5) * LANE_WIDTH_M
    if turn == 'ahead':
        return 2.0 * half
    return (half + offset if turn == 'left' else half - offset) * math.pi / 2


Piece = Straight | Curve | Junction


@dataclass(frozen=True, slots=True)
class RoadLayout:
    """Cross-section and pieces. Lane 0 is the lane next to the centre line; numbers increase to the right.

    zebras_m: arc lengths of zebra crossings along the forward chain.
    """

    pieces: tuple[Piece, ...]
    forward_lanes: int = 1
    backward_lanes: int = 1
    speed_limit_mps: float = 10.0
    shoulder_m: float = 0.5
    zebras_m: tuple[float, ...] = ()
