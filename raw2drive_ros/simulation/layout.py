"""How a scenario declares its road: a chain of straights, curves and junctions, laid end to end."""

from __future__ import annotations

import math
from dataclasses import dataclass

LANE_WIDTH_M = 3.5
# Longest arm of a junction, and road before and beyond the chain: cars come and go out of sight.
ARM_M, LEAD_M = 110.0, 100.0
# Arc length 0 of `RoadMap.crossing_path` is so far before the junction, on the arms beside the chain.
ARM_LENGTH_M = 60.0
CORNER_RADIUS_M = 7.0
MAX_SKEW_RAD = 0.65
DROP_BEFORE_M = 150.0
# Distance of stop lines from where the lanes across a junction begin; with a zebra crossing in between.
SETBACK_M, ZEBRA_SETBACK_M = 0.6, 4.6
PARKING_M = 2.4
TURNS = ('left', 'ahead', 'right')
PARKING_SIDES = ('', 'right', 'left', 'both')


@dataclass(frozen=True, slots=True)
class Straight:
    """A straight piece. ramp: with an acceleration lane on the right, fed by an on-ramp. exit: with a deceleration
    lane on the right that leads to an off-ramp. drop: with an added lane on the right that ends, and that comes beside
    the road from `DROP_BEFORE_M` before the piece; what precedes it has to be straight for so long."""

    length_m: float
    ramp: bool = False
    exit: bool = False
    drop: bool = False


@dataclass(frozen=True, slots=True)
class Curve:
    """An arc; positive angles turn left."""

    radius_m: float
    angle_rad: float


@dataclass(frozen=True, slots=True)
class Junction:
    """A junction that the chain leaves by `turn`.

    arms: all arms but the one that the chain enters by. control: none, light, stop or yield. priority: which road has
    the right of way where no light says so: chain, cross, or '' (the crossing one where there are signs, else nobody).
    angles: (arm, deviation in rad) of arms that do not meet at a right angle, left positive. corner_m: radius of the
    kerbs. island_m: radius of the island of a roundabout, 0 without one; whoever is on the ring goes first.
    turn_lanes: (turn, lanes) by which each approach may turn, as its drivers see it; turns that are not named are free
    to all lanes. Where a lane could go nowhere, or nobody could come into one, the nearest turn is added. setback_m:
    distance of the stop lines from the junction; more where there is a zebra crossing. zebras: arms with one.
    """

    turn: str = 'ahead'
    arms: tuple[str, ...] = ('left', 'right', 'ahead')
    control: str = 'none'
    priority: str = ''
    angles: tuple[tuple[str, float], ...] = ()
    corner_m: float = CORNER_RADIUS_M
    island_m: float = 0.0
    turn_lanes: tuple[tuple[str, tuple[int, ...]], ...] = ()
    setback_m: float = SETBACK_M
    zebras: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        known = {'left', 'right', 'ahead'}
        if self.turn not in self.arms or not set(self.arms) <= known:
            raise ValueError(f'Junction: turn {self.turn!r} must be one of arms {self.arms}, all in {known}')
        if self.control not in ('none', 'light', 'stop', 'yield'):
            raise ValueError(f'Junction: unknown control {self.control!r}')
        if self.priority not in ('', 'chain', 'cross'):
            raise ValueError(f'Junction: unknown priority {self.priority!r}')
        if any(arm not in self.arms or abs(angle) > MAX_SKEW_RAD for arm, angle in self.angles):
            raise ValueError(f'Junction: angles {self.angles}: arms of {self.arms}, at most {MAX_SKEW_RAD} rad')
        if any(turn not in TURNS or not lanes or min(lanes) < 0 for turn, lanes in self.turn_lanes):
            raise ValueError(f'Junction: turn_lanes {self.turn_lanes}: lanes from 0 on for some of {TURNS}')
        if not set(self.zebras) <= {'back', *self.arms}:
            raise ValueError(f'Junction: zebras {self.zebras} must be among its arms')

    def line_before_m(self, arm: str) -> float:
        """Distance of an approach's stop line from where its lanes across the junction begin."""
        return max(self.setback_m, ZEBRA_SETBACK_M) if arm in self.zebras else self.setback_m

    def may_turn(self, turn: str, lane: int) -> bool:
        """Whether the turn lanes let lane `lane` of an approach turn so."""
        return lane in dict(self.turn_lanes).get(turn, (lane,))

    def main_arms(self) -> tuple[str, ...]:
        """Arms of the road with the right of way; () where all are equal, and on roundabouts."""
        if self.island_m:
            return ()
        if self.priority == 'chain':
            return 'back', self.turn
        if self.priority == 'cross' or self.control in ('stop', 'yield'):
            return 'left', 'right'
        return ()

    def deviation_rad(self, arm: str) -> float:
        """By how much an arm deviates from a right angle, or from straight ahead."""
        return dict(self.angles).get(arm, 0.0)


def turn_length_m(turn: str, lanes: int = 1, lane: int = 0, width_m: float = LANE_WIDTH_M) -> float:
    """Length (m) of lane `lane` through a square junction of roads with `lanes` lanes each way; of any other see
    `junction_builder.piece_stations_m`."""
    half, offset = lanes * width_m + CORNER_RADIUS_M, (lane + 0.5) * width_m
    if turn == 'ahead':
        return 2.0 * half
    return (half + offset if turn == 'left' else half - offset) * math.pi / 2


Piece = Straight | Curve | Junction


@dataclass(frozen=True, slots=True)
class RoadLayout:
    """Cross-section and pieces. Lane 0 is the lane next to the centre line; numbers increase to the right.

    zebras_m: arc lengths of zebra crossings along the forward chain. parking: side of the chain's straights and curves
    with a strip of parking bays, `PARKING_M` wide: right, left, both or ''.
    """

    pieces: tuple[Piece, ...]
    forward_lanes: int = 1
    backward_lanes: int = 1
    speed_limit_mps: float = 10.0
    shoulder_m: float = 0.5
    zebras_m: tuple[float, ...] = ()
    lane_width_m: float = LANE_WIDTH_M
    parking: str = ''

    def __post_init__(self) -> None:
        if self.parking not in PARKING_SIDES:
            raise ValueError(f'RoadLayout: parking {self.parking!r} must be one of {PARKING_SIDES}')

    def parking_width_m(self, side: str) -> float:
        """Width of the parking strip on side `right` or `left` of the chain, 0 without one."""
        return PARKING_M if self.parking in (side, 'both') else 0.0
