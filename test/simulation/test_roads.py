"""Roads: lanes join, kerbs hold them, roads go on beyond the route, and scenery stands clear of all of it."""

import math

import numpy as np
import pytest

from raw2drive_ros.contracts.errors import LayoutError
from raw2drive_ros.simulation.courses import CourseBook
from raw2drive_ros.simulation.draws import TRAIN_SEED_START, Draw
from raw2drive_ros.simulation.layout import LEAD_M, Curve, Junction, RoadLayout, Straight
from raw2drive_ros.simulation.path import Path
from raw2drive_ros.simulation.road_builder import build_road
from raw2drive_ros.simulation.road_surface import BACKWARD, FORWARD, JUNCTION, OFF, SHOULDER, SIDEWALK
from raw2drive_ros.simulation.scenery import KINDS, place_scenery

SKEW = (('left', 0.5), ('right', 0.5))
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
    beyond = [ahead.pose(x_m, edge - aside)[:2] for aside in (0.25, road.layout.shoulder_m + 1.0, 6.0)]
    assert road.surface.kind_at(np.array(beyond)).tolist() == [SHOULDER, SIDEWALK, OFF]
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
    assert len(items) > 5
    for item in items:
        assert (road.surface.kind_at(item.footprint_m()) == OFF).all()
    trained = place_scenery(road, road.surface, Draw('Accident', TRAIN_SEED_START + 3))
    assert not {item.colour for item in items} & {item.colour for item in trained}
    assert {item.kind for item in items} <= set(KINDS['evaluation'])


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
    [{'turn': 'up'}, {'priority': 'me'}, {'angles': (('back', 0.1),)}, {'angles': (('left', 0.9),)}, {'control': 'no'}],
)
def test_a_wrong_junction_is_refused(wrong) -> None:
    with pytest.raises(ValueError, match='Junction'):
        Junction(**wrong)
