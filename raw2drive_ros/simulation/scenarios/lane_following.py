"""Empty roads with curves and junction turns: practice routes, where training begins."""

from __future__ import annotations

import math

from raw2drive_ros.simulation.draws import Rng
from raw2drive_ros.simulation.layout import Curve, Junction, Piece, RoadLayout, Straight
from raw2drive_ros.simulation.scenario import Scene, scenario


def _winding_pieces(rng: Rng, sections: int) -> tuple[Piece, ...]:
    pieces: list[Piece] = [Straight(float(rng.uniform(25, 45)))]
    for i in range(sections):
        if i % 2 == (0 if sections > 2 else int(rng.integers(0, 2))):
            radius = float(rng.uniform(18, 60))
            angle = math.radians(float(rng.uniform(30, 90))) * float(rng.choice((-1, 1)))
            pieces += [Curve(radius, angle), Straight(float(rng.uniform(15, 35)))]
        else:
            turn = str(rng.choice(('left', 'right', 'ahead')))
            pieces += [Junction(turn, _arms(rng, turn)), Straight(float(rng.uniform(20, 40)))]
    return tuple(pieces)


def _arms(rng: Rng, turn: str) -> tuple[str, ...]:
    """The arms of a junction: all three, or one that the route does not take left out."""
    others = [arm for arm in ('left', 'right', 'ahead') if arm != turn]
    drop = str(rng.choice([*others, 'none']))
    return tuple(arm for arm in ('left', 'right', 'ahead') if arm != drop)


@scenario('LaneFollowing')
def lane_following(rng: Rng) -> Scene:
    """Curves and junction turns on an empty two-way road."""
    pieces = _winding_pieces(rng, sections=4)
    return Scene(RoadLayout(pieces, 1, 1, speed_limit_mps=float(rng.uniform(7, 11))))


@scenario('JunctionTurns')
def junction_turns(rng: Rng) -> Scene:
    """Three junctions in a row, with a turn at most of them, on an empty two-way road."""
    pieces: list[Piece] = [Straight(float(rng.uniform(20, 35)))]
    for _ in range(3):
        turn = str(rng.choice(('left', 'left', 'right', 'right', 'ahead')))
        pieces += [Junction(turn, _arms(rng, turn)), Straight(float(rng.uniform(20, 35)))]
    return Scene(RoadLayout(tuple(pieces), 1, 1, speed_limit_mps=float(rng.uniform(7, 11))))
