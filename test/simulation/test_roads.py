"""Roads: lanes join, kerbs hold them, roads go on beyond the route, and scenery stands clear of all of it."""

import math

import numpy as np
import pytest

from raw2drive_ros.contracts.errors import LayoutError
from raw2drive_ros.simulation.courses import CourseBook
from raw2drive_ros.simulation.draws import TRAIN_SEED_START, Draw
from raw2drive_ros.simulation.junction_builder import lanes_through
from raw2drive_ros.simulation.layout import LEAD_M, Curve, Junction, RoadLayout, Straight
from raw2drive_ros.simulation.path import Path
from raw2drive_ros.simulation.posts import lamp_pole, sign_pole
from raw2drive_ros.simulation.road_builder import build_road, piece_stations_m
from raw2drive_ros.simulation.road_grammar import FORMS, chain_lanes, draw_road
from raw2drive_ros.simulation.road_surface import BACKWARD, FORWARD, JUNCTION, OFF, PARKING, SHOULDER, SIDEWALK
from raw2drive_ros.simulation.roads import advance
from raw2drive_ros.simulation.scenery import KINDS, place_scenery

SKEW = (('left', 0.5), ('right', 0.5))
TURN_LANES = (('left', (0,)), ('ahead', (0, 1)), ('right', (1,)))
APART = (('left', (0,)), ('right', (1,)))
LAYOUTS = {
    'T with a stop sign': RoadLayout((Straight(70), Junction('left', ('left', 'right'), 'stop'), Straight(60))),
    'skewed, two lanes': RoadLayout((Straight(70), Junction(angles=SKEW), Straight(60)), 2, 2, lane_width_m=3.2),
    'Y': RoadLayout(
        (
            Straight(70),
            Junction('left', ('left', 'right'), 'yield', angles=(('left', -0.5), ('right', 0.5))),
            Straight(60),
        )
    ),
    'roundabout': RoadLayout((Straight(70), Junction('ahead', control='yield', island_m=9.0), Straight(60))),
    'roundabout, left': RoadLayout(
        (Straight(70), Junction('left', control='yield', island_m=7.0, angles=(('ahead', 0.3),)), Straight(60)),
        lane_width_m=3.8,
    ),
    'light after a curve': RoadLayout(
        (Straight(70), Curve(60, 0.7), Straight(30), Junction('right', control='light', corner_m=10.0), Straight(60)),
        2,
        2,
    ),
    'on-ramp': RoadLayout((Straight(130), Straight(110, ramp=True), Curve(150, 0.4), Straight(80)), 2, 0),
    'lane that ends': RoadLayout((Straight(130), Straight(110, drop=True), Straight(80)), 2, 2),
    'two junctions': RoadLayout(
        (
            Straight(60),
            Junction('right', ('right', 'ahead'), 'yield', 'chain'),
            Straight(60),
            Junction('left', control='light', angles=(('ahead', 0.4),)),
            Straight(60),
        )
    ),
    'turn lanes and zebras': RoadLayout(
        (
            Straight(90),
            Junction('left', control='light', turn_lanes=TURN_LANES, zebras=('back', 'left', 'right', 'ahead')),
            Straight(70),
        ),
        2,
        2,
        parking='right',
    ),
    'turn lanes at a T': RoadLayout(
        (Straight(90), Junction('right', ('left', 'right'), 'stop', turn_lanes=APART, setback_m=1.5), Straight(70)),
        2,
        2,
        shoulder_m=2.0,
    ),
    'three lanes with an exit': RoadLayout((Straight(100), Straight(100, exit=True), Straight(100)), 3, 0),
}


@pytest.fixture(params=LAYOUTS, scope='module')
def road(request):
    return build_road(LAYOUTS[request.param])


def test_lanes_lead_into_each_other_without_a_step(road) -> None:
    book = CourseBook(road)
    for ref, following in book.after.items():
        end = book.lanes[ref].pose(book.lanes[ref].length)
        for other in following:
            begin = book.lanes[other].pose(0.0)
            assert math.hypot(begin[0] - end[0], begin[1] - end[1]) < 0.55, (ref, other)
            assert abs(math.remainder(begin[2] - end[2], 2.0 * math.pi)) < 0.12, (ref, other)


def test_every_way_begins_and_ends_at_the_edge_of_the_map(road) -> None:
    book = CourseBook(road)
    assert len(book.sources()) >= road.layout.forward_lanes + road.layout.backward_lanes
    for ref in book.sources():
        course = book.course(book.downstream(ref))
        assert book.is_sink(course.lanes[-1])
        # Within what the ego's steering allows, with room to spare.
        assert course.path.curvature(course.path.start_s_m, course.path.length_m) < 1.0 / 4.9


def test_lanes_are_paved_and_keep_to_their_kerbs(road) -> None:
    book = CourseBook(road)
    for ref, lane in book.lanes.items():
        for side in (-0.9, 0.0, 0.9):
            # Without the very edge of the map.
            kinds = road.surface.kind_at(lane.centre_line(1.0, side)[1:-1])
            assert not np.isin(kinds, (OFF, SIDEWALK)).any(), (ref, side)


def test_the_surface_tells_directions_apart(road) -> None:
    ahead, x_m = road.forward_path(0), 20.0
    assert road.surface.kind_at(np.array([ahead.pose(x_m)[:2]]))[0] == FORWARD
    if road.layout.backward_lanes:
        beside = ahead.pose(x_m, road.layout.lane_width_m)[:2]
        assert road.surface.kind_at(np.array([beside]))[0] == BACKWARD
    edge = -(road.layout.forward_lanes - 0.5) * road.layout.lane_width_m
    if any(isinstance(piece, Straight) and (piece.drop or piece.ramp) for piece in road.layout.pieces):
        return
    bays = road.layout.parking_width_m('right')
    beside = [0.25, bays + 0.25, bays + road.layout.shoulder_m + 1.0, bays + 6.0]
    beyond = road.surface.kind_at(np.array([ahead.pose(x_m, edge - aside)[:2] for aside in beside]))
    assert beyond.tolist() == [PARKING if bays else SHOULDER, SHOULDER, SIDEWALK, OFF]
    for site in road.junctions:
        if not site.spec.island_m:
            assert road.surface.kind_at(np.array([site.centre_m]))[0] == JUNCTION


def test_the_road_goes_on_before_and_beyond_the_route(road) -> None:
    ahead = road.forward_path(0)
    assert ahead.start_s_m == -LEAD_M
    assert ahead.pose(0.0)[:2] == pytest.approx((0.0, -road.layout.lane_width_m / 2), abs=1e-6)
    assert ahead.length_m - ahead.end_s_m == pytest.approx(LEAD_M, abs=0.6)
    assert ahead.project(*ahead.pose(-30.0)[:2])[0] == pytest.approx(-30.0, abs=0.01)


def test_scenery_is_clear_of_the_road_and_of_another_split_in_another_one(road) -> None:
    items = place_scenery(road, road.surface, Draw('Accident', 3))
    assert items == place_scenery(road, road.surface, Draw('Accident', 3, event=False))
    assert 40 <= len(items) <= 90
    for item in items:
        assert (road.surface.kind_at(item.footprint_m()) == OFF).all()
    trained = place_scenery(road, road.surface, Draw('Accident', TRAIN_SEED_START + 3))
    assert not {item.colour for item in items} & {item.colour for item in trained}
    assert {item.kind for item in items} <= set(KINDS['evaluation'])


def test_stop_lines_and_posts_belong_to_their_approach(road) -> None:
    """Each line is right of the middle of its road and its lanes cross it; posts stand beside the road, in view."""
    for number, site in enumerate(road.junctions):
        for arm in site.inlets:
            (x, y, yaw), width = road.stop_line(number, arm)
            assert width == pytest.approx(road.layout.forward_lanes * road.layout.lane_width_m)
            lanes = road.lanes_into(road.node_into(site.piece, arm))
            assert len(lanes) == road.layout.forward_lanes
            for lane in lanes:
                along, aside = lane.local_coordinates(np.array((x, y)))
                assert lane.length - along == pytest.approx(site.spec.line_before_m(arm), abs=0.01)
                assert abs(aside) < width / 2
            for pole, near, far in ((sign_pole, -13.0, 0.0), (lamp_pole, 8.0, 70.0)):
                px, py, facing = pole(road, number, arm)
                assert road.surface.kind_at(np.array([(px, py)]))[0] in (OFF, SIDEWALK)
                ahead = (px - x) * math.cos(yaw) + (py - y) * math.sin(yaw)
                assert near < ahead < far
                assert math.cos(facing - yaw) == pytest.approx(-1.0)


def test_turn_lanes_let_each_lane_turn_only_as_marked() -> None:
    road = build_road(LAYOUTS['turn lanes and zebras'])
    book = CourseBook(road)
    for arm in road.junctions[0].inlets:
        first = book.approach_of(0, arm)
        turns = [{book.turn_of(other) for other in book.choices((*first[:2], number))} for number in (0, 1)]
        assert turns == [{'left', 'ahead'}, {'ahead', 'right'}]
    arrows = [marking for marking in road.markings if marking.kind == 'arrow']
    assert len(arrows) == 4 * 2 * 2 * (1 + 1 + 2), 'two arrows on each of eight lanes: shaft, tip, and a bent tip'
    # A path in the lane that may not turn left can still be measured along the chain.
    assert road.forward_path(1).curvature(0.0, 150.0) < 0.2
    assert chain_lanes(LAYOUTS['turn lanes and zebras']) == (0,)


def test_no_lane_is_left_without_a_way_on_or_a_way_in() -> None:
    """Turn lanes that leave a lane of a T junction nowhere to go are completed."""
    spec = Junction('left', ('left', 'right'), turn_lanes=(('left', (0,)), ('right', (0,)), ('ahead', (0,))))
    found = lanes_through(spec, 3)
    for arm in ('back', 'left', 'right'):
        for end in (0, 1):
            reached = {lane for pair, lanes in found.items() if pair[end] == arm for lane in lanes}
            assert reached == {0, 1, 2}


def test_stations_of_pieces_are_those_of_the_built_road() -> None:
    for name in ('light after a curve', 'roundabout, left', 'Y', 'skewed, two lanes'):
        road = build_road(LAYOUTS[name])
        for lane in range(road.layout.forward_lanes):
            stations = piece_stations_m(road.layout, lane)
            path = road.forward_path(lane)
            for edge, station in zip(road.forward, stations, strict=False):
                x, y, _ = road.lane(edge, lane).pose(0.0)
                assert path.project(x, y)[0] == pytest.approx(station, abs=0.5), (name, lane, edge)


def test_waiting_at_a_line_one_sees_the_roads_across_whatever_stands_there() -> None:
    """And coming near one sees less at some junctions."""
    hidden = 0
    layout = RoadLayout((Straight(100), Junction('ahead', control='yield'), Straight(80)))
    road = build_road(layout)
    for seed in range(8):
        items = [item for item in place_scenery(road, road.surface, Draw('Accident', seed)) if item.kind != 'pole']
        for before_m, must_see in ((5.0, True), (25.0, False)):
            eye = np.array(road.forward_path(0).pose(100.0 - before_m)[:2])
            for arm in ('left', 'right'):
                seen = [_sees(eye, np.array(advance(road.junctions[0].inlets[arm], -s)[:2]), items) for s in (15, 50)]
                assert all(seen) or not must_see
                hidden += not all(seen)
    assert hidden > 5


def _sees(eye, place, items) -> bool:
    points = eye + np.linspace(0.0, 1.0, 120)[:, None] * (place - eye)
    for item in items:
        cos, sin = math.cos(item.yaw_rad), math.sin(item.yaw_rad)
        inside = np.abs((points - (item.x_m, item.y_m)) @ np.array([[cos, -sin], [sin, cos]]))
        if ((inside[:, 0] < item.length_m / 2) & (inside[:, 1] < item.width_m / 2)).any():
            return False
    return True


def test_drawn_roads_are_of_all_forms_the_same_for_twins_and_nearly_always_fit() -> None:
    forms, misfits = set(), 0
    for seed in range(40):
        draw = Draw('Grammar', seed)
        layout = draw_road(draw)
        assert layout == draw_road(Draw('Grammar', seed, event=False))
        assert chain_lanes(layout), 'some lane leads along the whole chain'
        forms.add(draw.parameters['road_form'].value)
        try:
            road = build_road(layout)
        except LayoutError:
            misfits += 1
            continue
        ahead = road.forward_path(chain_lanes(layout)[0])
        assert 150.0 < ahead.end_s_m < 520.0
        assert ahead.curvature(0.0, ahead.end_s_m) < 1.0 / 5.0
    assert forms == set(FORMS)
    assert misfits <= 4


def test_a_ramp_that_would_meet_another_road_is_refused() -> None:
    with pytest.raises(LayoutError, match='ramp'):
        build_road(RoadLayout((Straight(60), Curve(60, -1.0), Straight(120, ramp=True), Straight(60)), 2, 0))
    build_road(RoadLayout((Straight(120), Straight(120, ramp=True), Straight(60)), 2, 0))


def test_arms_are_shortened_where_roads_would_meet() -> None:
    pieces = (Straight(40), Junction('left'), Straight(80), Junction('left'), Straight(50))
    road = build_road(RoadLayout(pieces))
    lengths = [lane.length for lane in CourseBook(road).lanes.values() if lane.junction < 0]
    assert min(lengths) > 30.0
    with pytest.raises(LayoutError):
        build_road(RoadLayout((Straight(40), *(Junction('left'), Straight(30)) * 4)))


def test_a_path_may_begin_before_the_place_it_counts_from() -> None:
    points = np.stack([np.arange(-50.0, 51.0), np.zeros(101)], axis=1)
    path = Path(points, -50.0)
    assert path.pose(-20.0)[:2] == pytest.approx((-20.0, 0.0))
    assert path.length_m == 50.0
    assert path.project(-20.3, 1.0) == pytest.approx((-20.3, 1.0))
    assert path.project(-20.3, 1.0, -25.0) == pytest.approx((-20.3, 1.0))
    stations, laterals = path.project_many(np.array([(-20.3, 1.0)]), -25.0, 15.0)
    assert (stations[0], laterals[0]) == pytest.approx((-20.3, 1.0))
    assert path.window(-10.0, 3.0)[:, 0].tolist() == [-10.0, -9.0, -8.0]
    assert path.station(path.index_at(-10.0)) == -10.0
    moved = path.shifted(lambda s_m: 2.0 if s_m > 0.0 else 0.0)
    assert moved.pose(-20.0)[:2] == pytest.approx((-20.0, 0.0))


@pytest.mark.parametrize(
    'wrong',
    [
        {'turn': 'up'},
        {'priority': 'me'},
        {'angles': (('back', 0.1),)},
        {'angles': (('left', 0.9),)},
        {'control': 'no'},
        {'turn_lanes': (('up', (0,)),)},
        {'turn_lanes': (('left', ()),)},
        {'zebras': ('sky',)},
    ],
)
def test_a_wrong_junction_is_refused(wrong) -> None:
    with pytest.raises(ValueError, match='Junction'):
        Junction(**wrong)
