"""Draws whole roads: bends, junctions of all shapes and roundabouts, with width, lanes, bays and turn lanes.

A road is an approach, what its form names, and a way out. Approach and way out are strings of straights, arcs,
compound curves and S-bends. `draw_road` draws each part by a name of its own: the event and its twin get
the same road, and so do scenes with one parameter more.
"""

from __future__ import annotations

from collections.abc import Sequence

from raw2drive_ros.simulation.draws import Draw
from raw2drive_ros.simulation.junction_builder import lanes_through
from raw2drive_ros.simulation.layout import Curve, Junction, Piece, RoadLayout, Straight

FORMS = ('bends', 'crossing', 'skewed', 'tee', 'side road', 'wye', 'roundabout', 'two junctions', 'lane ends')
SHAPES = ('straight', 'arc', 'compound', 'S')
RADIUS_M, TIGHT_M = (55.0, 160.0), 45.0
# Straight road at either end of a bend, before junctions (turn lanes and bays need it) and after them.
SHORTEST_M, BEFORE_JUNCTION_M, AFTER_JUNCTION_M = 12.0, 38.0, 25.0
DROP_M = (165.0, 100.0, 130.0)
SKEW_RAD, CORNER_M, ISLAND_M = 0.55, (6.0, 11.0), (7.0, 13.0)
# What arms a junction has, by the form of the road; the chain leaves by any of the last ones.
ARMS = {
    'crossing': ('left', 'right', 'ahead'),
    'skewed': ('left', 'right', 'ahead'),
    'tee': ('left', 'right'),
    'wye': ('left', 'right'),
    'roundabout': ('left', 'right', 'ahead'),
}


def draw_road(
    draw: Draw,
    forms: Sequence[str] = FORMS,
    length_m: tuple[float, float] = (200.0, 360.0),
    lanes: Sequence[int] = (1, 1, 2, 3),
    limit_mps: tuple[float, float] = (9.0, 14.0),
) -> RoadLayout:
    """A road of one of `forms`, of about `length_m`. Form, turn, shape of the approach and number of lanes are key.

    Some draws overlap themselves: `build_road` raises LayoutError for them, and `World` draws again.
    """
    form = draw.choice('road_form', tuple(forms), key=True)
    wanted = draw.choice('road_lanes', tuple(lanes), key=True)
    count = min(wanted, 1 if form in ('roundabout', 'two junctions') else 3)
    length = draw.uniform('road_m', *length_m)
    part = draw.uniform('road_part', 0.4, 0.65)
    pieces = _pieces(draw, form, length, part, count)
    oneway = form in ('bends', 'lane ends') and count > 1 and draw.chance('road_oneway', 0.25)
    return RoadLayout(
        pieces,
        count,
        0 if oneway else count,
        round(draw.uniform('road_limit_mps', *limit_mps), 1),
        draw.uniform('road_shoulder_m', 0.4, 1.6),
        lane_width_m=draw.uniform('road_width_m', 3.05, 3.85),
        parking=_parking(draw, form, oneway=oneway),
    )


def chain_lanes(layout: RoadLayout) -> tuple[int, ...]:
    """The lanes in which a car can go along the whole chain without changing lanes."""
    found = set(range(layout.forward_lanes))
    for piece in layout.pieces:
        if isinstance(piece, Junction):
            found &= set(lanes_through(piece, layout.forward_lanes)['back', piece.turn])
    return tuple(sorted(found))


def _parking(draw: Draw, form: str, *, oneway: bool) -> str:
    side = draw.choice('road_parking', ('', '', 'right', 'left', 'both'))
    if form == 'lane ends' or (oneway and side in ('left', 'both')):
        return ''
    return side


def _pieces(draw: Draw, form: str, length: float, part: float, count: int) -> tuple[Piece, ...]:
    if form == 'bends':
        return (*_way(draw, 'way', length * part, shapes=SHAPES[1:]), *_way(draw, 'way_on', length * (1.0 - part)))
    if form == 'lane ends':
        before, ending, after = DROP_M
        return (
            Straight(before + draw.uniform('drop_at_m', 0.0, 40.0)),
            Straight(ending, drop=True),
            *_way(draw, 'way_on', after),
        )
    approach = _way(draw, 'way', length * part, end_m=BEFORE_JUNCTION_M)
    out = _way(draw, 'way_on', length * (1.0 - part), begin_m=AFTER_JUNCTION_M)
    if form != 'two junctions':
        return (*approach, _junction(draw, 'junction', form, count), *out)
    first = _junction(draw, 'junction', draw.choice('first_form', ('crossing', 'side road', 'tee')), count)
    second = _junction(draw, 'second', draw.choice('second_form', ('crossing', 'side road', 'roundabout')), count)
    between = Straight(draw.uniform('between_m', 70.0, 110.0))
    return (*approach, first, between, second, *out)


def _way(
    draw: Draw,
    name: str,
    length: float,
    begin_m: float = SHORTEST_M,
    end_m: float = SHORTEST_M,
    shapes: Sequence[str] = SHAPES,
) -> list[Piece]:
    """Straights and curves of about `length`, straight for `begin_m` and `end_m` at its ends."""
    shape = draw.choice(f'{name}_shape', shapes, key=name == 'way')
    side = draw.side(f'{name}_side')
    angles = [draw.uniform(f'{name}_rad_{i}', 0.15, 0.75) for i in range(2)]
    radii = [draw.uniform(f'{name}_radius_{i}_m', *RADIUS_M) for i in range(2)]
    curves: list[Piece] = []
    if shape == 'arc':
        curves = [Curve(max(radii[0] * 0.8, TIGHT_M), side * 1.2 * angles[0])]
    elif shape == 'compound':
        curves = [Curve(radius, side * 0.8 * angle) for radius, angle in zip(radii, angles, strict=True)]
    elif shape == 'S':
        curves = [Curve(radii[0], side * angles[0]), Straight(SHORTEST_M), Curve(radii[1], -side * angles[1])]
    left = length - begin_m - end_m - sum(_length_m(piece) for piece in curves)
    if not curves or left < 0.0:
        return [Straight(max(length, begin_m + end_m))]
    share = draw.uniform(f'{name}_share', 0.15, 0.85)
    return [Straight(begin_m + share * left), *curves, Straight(end_m + (1.0 - share) * left)]


def _length_m(piece: Piece) -> float:
    if isinstance(piece, Straight):
        return piece.length_m
    assert isinstance(piece, Curve)
    return piece.radius_m * abs(piece.angle_rad)


def _junction(draw: Draw, name: str, form: str, count: int) -> Junction:
    """A junction of a form, its turn, control, angles, kerbs, lines and turn lanes drawn."""
    side = draw.choice(f'{name}_side_road', ('left', 'right'))
    arms = ARMS.get(form, (side, 'ahead'))
    turn = draw.choice(f'{name}_turn', arms, key=name == 'junction')
    island = draw.uniform(f'{name}_island_m', *ISLAND_M) if form == 'roundabout' else 0.0
    control = draw.choice(f'{name}_control', ('none', 'light', 'stop', 'yield', 'yield'))
    if form == 'roundabout':
        control = 'yield'
    elif count > 1 and control == 'none':
        control = 'light'
    zebra = draw.choice(f'{name}_zebra', ('', '', '', 'here', 'all'))
    zebras = {'': (), 'here': ('back',), 'all': ('back', *arms)}[zebra]
    return Junction(
        turn,
        arms,
        control,
        _priority(draw, name, form, control, turn),
        _angles(draw, name, form, arms),
        draw.uniform(f'{name}_corner_m', *CORNER_M),
        island,
        _turn_lanes(draw, name, count),
        draw.uniform(f'{name}_setback_m', 0.6, 2.0),
        zebras,
    )


def _priority(draw: Draw, name: str, form: str, control: str, turn: str) -> str:
    """Which road goes first where signs say so. On side roads the chain is the main road as long as it goes ahead."""
    if control not in ('stop', 'yield') or form == 'roundabout':
        return ''
    if form == 'side road':
        return 'chain' if turn == 'ahead' or draw.chance(f'{name}_bends_first', 0.5) else ''
    if form in ('tee', 'wye'):
        return 'cross'
    return draw.choice(f'{name}_priority', ('chain', 'cross'))


def _angles(draw: Draw, name: str, form: str, arms: tuple[str, ...]) -> tuple[tuple[str, float], ...]:
    """Deviations of the arms: large where the form says so, small ones elsewhere, or none."""
    drawn = [draw.uniform(f'{name}_angle_{arm}', -1.0, 1.0) for arm in ('left', 'right', 'ahead')]
    by_arm = dict(zip(('left', 'right', 'ahead'), drawn, strict=True))
    if form == 'wye':
        # The arms fork: both lean forwards.
        return tuple((arm, (-1.0 if arm == 'left' else 1.0) * (0.3 + 0.25 * abs(by_arm[arm]))) for arm in arms)
    if form == 'skewed':
        # The road across stays about straight.
        lean = SKEW_RAD * by_arm['left']
        return (('left', lean), ('right', lean + 0.08 * by_arm['right']), ('ahead', 0.15 * by_arm['ahead']))
    if draw.chance(f'{name}_square', 0.4):
        return ()
    return tuple((arm, 0.22 * by_arm[arm]) for arm in arms)


def _turn_lanes(draw: Draw, name: str, count: int) -> tuple[tuple[str, tuple[int, ...]], ...]:
    """For roads of several lanes: who turns from which lane."""
    last = count - 1
    kinds = {
        'outer': (('left', (0,)), ('ahead', tuple(range(count))), ('right', (last,))),
        'left alone': (('left', (0,)), ('ahead', tuple(range(1, count))), ('right', (last,))),
        'right alone': (('left', (0,)), ('ahead', tuple(range(last))), ('right', (last,))),
    }
    kind = draw.choice(f'{name}_turn_lanes', tuple(kinds))
    return kinds[kind] if count > 1 else ()
