"""What several scenario types are made of: roads, streams, rows of parked cars, traffic that wants nothing.

Every function takes the `Draw` of the scene and names what it draws, so that the event and its twin get the same.
"""

from __future__ import annotations

import math

from raw2drive_ros.simulation.draws import Draw
from raw2drive_ros.simulation.layout import Curve, Junction, Piece, RoadLayout, Straight, turn_length_m
from raw2drive_ros.simulation.scenario import BackgroundSpec, FlowSpec, Place, StandingSpec

# Distance at which the ego comes near a place where it may have to wait, and how long it then waits at least: longer
# than the slack of a time limit, so that nobody can wait blindly in both drives of a pair.
NEAR_M, WAIT_S = 35.0, (14.0, 24.0)
PARKED_GAP_M = 6.8


def layout(
    draw: Draw,
    pieces: tuple[Piece, ...],
    lanes: tuple[int, int] = (1, 1),
    limit_mps: tuple[float, float] = (9.0, 13.0),
    shoulder_m: tuple[float, float] = (0.5, 1.5),
    zebras_m: tuple[float, ...] = (),
) -> RoadLayout:
    """A road of these pieces with `lanes` (forward, backward), its width, limit and shoulder drawn."""
    return RoadLayout(
        pieces,
        lanes[0],
        lanes[1],
        round(draw.uniform('limit_mps', *limit_mps), 1),
        draw.uniform('shoulder_m', *shoulder_m),
        zebras_m,
        draw.uniform('lane_width_m', 3.2, 3.8),
    )


def bend(draw: Draw, name: str, largest_rad: float = 0.7) -> Curve:
    """A gentle curve to either side."""
    radius = draw.uniform(f'{name}_radius_m', 60.0, 160.0)
    return Curve(radius, draw.side(f'{name}_side') * draw.uniform(f'{name}_rad', 0.12, largest_rad))


def length_m(pieces: tuple[Piece, ...]) -> float:
    """Length of straights and curves along their middle."""
    return sum(p.length_m if isinstance(p, Straight) else p.radius_m * abs(p.angle_rad) for p in pieces)  # type: ignore[union-attr]


def road_length_m(pieces: tuple[Piece, ...], road: RoadLayout, lane: int) -> float:
    """Arc length on a lane of the chain where the first `pieces` of the road end."""
    aside = -(lane + 0.5) * road.lane_width_m
    found = 0.0
    for piece in pieces:
        if isinstance(piece, Straight):
            found += piece.length_m
        elif isinstance(piece, Curve):
            found += piece.radius_m * abs(piece.angle_rad) - piece.angle_rad * aside
        else:
            found += turn_length_m(piece.turn, road.forward_lanes, lane)
    return found


def approach(draw: Draw, total_m: float, name: str = 'approach', straight_m: float = 60.0) -> tuple[Piece, ...]:
    """Road of about `total_m`, straight or with a bend, and straight for the last `straight_m`; the kind is key."""
    kind = draw.choice(f'{name}_kind', ('straight', 'bend', 'late bend'), key=True)
    curve = bend(draw, f'{name}_bend')
    first = draw.uniform(f'{name}_first', 0.25, 0.5) if kind == 'bend' else 0.9
    left = total_m - straight_m - length_m((curve,))
    if kind == 'straight' or left < 30.0:
        return (Straight(total_m),)
    if left * (1.0 - first) < 5.0:
        return Straight(left), curve, Straight(straight_m)
    return Straight(left * first), curve, Straight(left * (1.0 - first) + straight_m)


def background(draw: Draw, parked: bool = True, lanes: tuple[str, ...] | None = None) -> BackgroundSpec:
    """Traffic on all lanes, parked cars, people and cyclists, as drawn."""
    spec = BackgroundSpec(
        draw.choice('density', ('light', 'medium', 'dense')),
        draw.uniform('parked_share', 0.1, 0.5) if parked else 0.0,
        draw.integer('bystanders', 0, 3),
        draw.integer('cyclists', 0, 1),
    )
    return spec if lanes is None else BackgroundSpec(spec.density, spec.parked, spec.bystanders, spec.cyclists, lanes)


def stream(
    draw: Draw,
    place: Place,
    speed_mps: float,
    need_s: float,
    name: str = 'stream',
    headway_s: tuple[float, float] = (1.4, 1.75),
    passes: bool | None = None,
    kind: str = 'car',
    yields: bool = False,
) -> FlowSpec:
    """An endless stream in which gaps of `need_s` and a little more come late and from time to time.

    passes: whether it has passed when the ego comes, as in twins; None: in twins, and only there.
    """
    wait_s = draw.uniform(f'{name}_first_gap_s', *WAIT_S)
    ahead_m = draw.uniform(f'{name}_passes_m', 25.0, 45.0)
    gone = not draw.event if passes is None else passes
    return FlowSpec(
        place,
        speed_mps,
        headway_s,
        (need_s, need_s + 1.5),
        (8.0, 14.0),
        wait_s,
        NEAR_M,
        ahead_m if gone else None,
        kind,
        yields=yields,
    )


def parked_row(
    draw: Draw, name: str, from_m: float, until_m: float, lateral_m: float, without_m: tuple[float, float] | None = None
) -> tuple[StandingSpec, ...]:
    """A row of parked cars and vans along the route, but for the stretch `without_m`."""
    rng = draw.stream(name)
    found, s_m = [], from_m + float(rng.uniform(0.0, 3.0))
    while s_m < until_m:
        kind = 'parked_van' if rng.random() < 0.2 else 'parked'
        if without_m is None or not without_m[0] - 3.0 < s_m < without_m[1] + 3.0:
            found.append(StandingSpec(kind, s_m, lateral_m))
        s_m += PARKED_GAP_M + float(rng.exponential(1.0))
    return tuple(found)


def crossing_need_s(road: RoadLayout, turn: str, speed_mps: float = 4.5) -> float:
    """Time that the ego takes, from standing at its line, until it is clear of a stream across its way."""
    return 1.5 + (turn_length_m(turn, road.forward_lanes) + 6.0) / speed_mps + 0.8


def skewed(draw: Draw, turn: str, arms: tuple[str, ...], control: str = 'none', priority: str = '') -> Junction:
    """A junction whose arms meet at drawn angles; square, T and skewed ones are key."""
    shape = draw.choice('junction_shape', ('square', 'skewed', 'wide'), key=True)
    angles = tuple((arm, draw.uniform(f'angle_{arm}', -0.35, 0.35)) for arm in arms)
    corner = draw.uniform('corner_m', 6.0, 8.0) if shape != 'wide' else draw.uniform('wide_corner_m', 9.0, 12.0)
    return Junction(turn, arms, control, priority, angles if shape == 'skewed' else (), corner)


def across_m(junction: Junction, road: RoadLayout) -> float:
    """About the length of the ego's way across a junction."""
    turn = turn_length_m(junction.turn, road.forward_lanes)
    return turn + (junction.corner_m - 7.0) * math.pi / 2
