"""Which checkpoint comes next: on routes that turn back, cross themselves, or begin behind the car."""

import itertools
import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from raw2drive_ros.contracts.public import OdometrySample, Route
from raw2drive_ros.driving.preprocessing import (
    BEHIND_M,
    GAIN_M,
    REACHED_AHEAD_M,
    REACHED_ALONG_M,
    SHORT_CUT,
    RouteProgress,
)
from raw2drive_ros.evaluation.suites import load_suite
from raw2drive_ros.simulation.environment import DrivingEnv, SimulationConfig

STEP_M = 0.5
START = [(0, 0), (25, 0), (50, 0)]
U_TURN = [*START, (50, 8), (25, 8), (0, 8), (-25, 8)]
NARROW_U_TURN = [*START, (50, 3.5), (25, 3.5), (0, 3.5), (-25, 3.5)]
SQUARE_CORNER = [*START, (50, 25), (50, 50), (50, 75), (50, 100)]
HAIRPINS = [(0, 0), (30, 0), (30, 6), (0, 6), (0, 12), (30, 12), (30, 18), (0, 18)]
FIGURE_OF_EIGHT = [
    (0, 0),
    (20, 0),
    (40, 0),
    (40, 20),
    (20, 20),
    (20, 0),
    (20, -20),
    (0, -20),
    (0, 0),
    (20, 0),
    (20, 20),
]
TWO_LAPS = [(0, 0), (20, 0), (20, 20), (0, 20)] * 2 + [(0, 0)]
SHAPES = {
    'U-turn': U_TURN,
    'narrow U-turn': NARROW_U_TURN,
    'square corner': SQUARE_CORNER,
    'hairpins': HAIRPINS,
    'figure of eight': FIGURE_OF_EIGHT,
    'two laps': TWO_LAPS,
}


def route_of(points, stamp_ns: int = 1) -> Route:
    return Route(stamp_ns, np.array(points, float)).validate()


def at(x: float, y: float, yaw: float = 0.0) -> OdometrySample:
    return OdometrySample(0, x, y, yaw, 5.0, 0.0)


def along(points, step_m: float = STEP_M, left_m: float = 0.0):
    """(arc length, sample) of a car that follows the line, `left_m` to the left of it."""
    before_m = 0.0
    for (x, y), (next_x, next_y) in itertools.pairwise(points):
        length_m, yaw = math.hypot(next_x - x, next_y - y), math.atan2(next_y - y, next_x - x)
        for done_m in np.arange(0.0, length_m, step_m):
            px, py = x + done_m * math.cos(yaw), y + done_m * math.sin(yaw)
            yield before_m + done_m, at(px - left_m * math.sin(yaw), py + left_m * math.cos(yaw), yaw)
        before_m += length_m


def stations(points) -> list[float]:
    return [0.0, *itertools.accumulate(math.dist(a, b) for a, b in itertools.pairwise(points))]


@pytest.mark.parametrize('left_m', [0.0, 1.5, -1.5])
@pytest.mark.parametrize('name', SHAPES)
def test_a_car_that_follows_the_line_passes_one_checkpoint_at_a_time(name, left_m) -> None:
    points, progress, seen = SHAPES[name], RouteProgress(), []
    arcs_m = stations(points)
    for arc_m, sample in along(points, left_m=left_m):
        progress.update(route_of(points), sample)
        seen.append(progress.next_index)
        # The first checkpoint ahead: what is behind the car has been passed, and nothing that is far ahead.
        assert arcs_m[progress.next_index] > arc_m - BEHIND_M
        assert arcs_m[max(progress.next_index - 1, 0)] <= arc_m + REACHED_ALONG_M + abs(left_m)
    assert all(after - before in (0, 1) for before, after in itertools.pairwise(seen))
    assert seen[0] == 1
    assert seen[-1] == len(points) - 1


@pytest.mark.parametrize('tail', [U_TURN[3:], SQUARE_CORNER[3:]], ids=['U-turn', 'square corner'])
def test_nothing_is_skipped_before_the_turn(tail) -> None:
    progress = RouteProgress()
    for x in np.arange(0.0, 50.0, STEP_M):
        progress.update(route_of([*START, *tail]), at(x, 0.0))
        assert progress.next_index == (1 if x < 21 else 2 if x < 46 else 3), x


@pytest.mark.parametrize(
    ('here', 'expected'),
    [
        ((0.0, 0.0, 0.0), 5),
        ((2.0, 3.0, 0.1), 5),
        ((-90.0, 1.0, 0.0), 1),
        ((-130.0, 0.0, 0.0), 0),
        ((60.0, -2.0, 0.0), 7),
        # The wrong way round: it has to turn, and then goes on from here.
        ((-40.0, 0.0, math.pi), 3),
    ],
)
def test_a_route_that_begins_behind_the_car_goes_on_where_the_car_is(here, expected) -> None:
    progress = RouteProgress()
    progress.update(route_of([(25 * i - 100, 0) for i in range(9)]), at(*here))
    assert progress.next_index == expected


def test_a_route_behind_the_back_of_the_car_is_not_skipped() -> None:
    progress = RouteProgress()
    progress.update(route_of([(25 * i, 0) for i in range(6)]), at(0.0, 0.0, math.pi))
    assert progress.next_index == 1


def test_of_two_lanes_the_one_in_the_direction_of_the_car_counts() -> None:
    progress = RouteProgress()
    progress.update(route_of(U_TURN), at(20.0, 3.0, math.pi))
    assert U_TURN[progress.next_index] == (0, 8)
    progress = RouteProgress()
    progress.update(route_of(U_TURN), at(20.0, 5.0, 0.0))
    assert U_TURN[progress.next_index] == (25, 0)


def test_a_lap_begins_at_its_beginning() -> None:
    lap = [(0, 0), (25, 0), (50, 0), (50, 25), (25, 25), (0, 25), (-25, 25), (-25, 0), (0, 0)]
    progress = RouteProgress()
    progress.update(route_of(lap), at(0.0, 0.3, 0.05))
    assert progress.next_index == 1


def test_a_car_that_turns_back_early_goes_on_with_the_way_back() -> None:
    points = [(0, 0), (25, 0), (50, 0), (75, 0), (75, 8), (50, 8), (25, 8), (0, 8), (-25, 8), (-50, 8)]
    progress = RouteProgress()
    half_circle = [at(40 + 4 * math.sin(a), 4 - 4 * math.cos(a), a) for a in np.linspace(0, math.pi, 26)]
    way_back = [at(x, 8.0, math.pi) for x in np.arange(40.0, -30.0, -STEP_M)]
    passed = []
    for sample in [*(at(x, 0.0) for x in np.arange(0, 40, STEP_M)), *half_circle, *way_back]:
        progress.update(route_of(points), sample)
        passed.append(progress.next_index)
    found = next(i for i, sample in enumerate(way_back) if passed[len(passed) - len(way_back) + i] > 4)
    assert way_back[found].x_m > 0.0
    assert points[passed[-1]] == (-50, 8)


def test_a_car_beside_the_way_back_stays_on_its_way_there() -> None:
    """It overtakes for longer than the way back is away, nearer to that than to its own lane."""
    points = [(0, 0), (100, 0), (200, 0), (200, 6), (100, 6), (0, 6)]
    progress = RouteProgress()
    for x in np.arange(0.0, 180.0, STEP_M):
        progress.update(route_of(points), at(x, 3.5 if x > 20 else 0.0))
    assert progress.next_index == 2


def test_standing_still_passes_nothing() -> None:
    progress = RouteProgress()
    rng = np.random.default_rng(0)
    for x, y in rng.normal(0.0, 0.02, (3000, 2)):
        progress.update(route_of(HAIRPINS), at(20.0 + x, y))
    assert progress.next_index == 1
    assert progress.arc_m == pytest.approx(20.0, abs=0.5)


coordinates = st.floats(-60.0, 60.0, allow_nan=False)
routes = st.lists(st.tuples(coordinates, coordinates), min_size=2, max_size=9)
moves = st.tuples(st.floats(-3.0, 3.0), st.floats(-3.0, 3.0), st.floats(-math.pi, math.pi))


@given(routes, st.tuples(coordinates, coordinates), st.lists(moves, max_size=60))
def test_progress_only_grows_and_no_faster_than_the_car_drives(points, start, drive) -> None:
    route, progress, arcs_m = route_of(points), RouteProgress(), stations(points)
    x, y = start
    progress.update(route, at(x, y))
    driven_m = 0.0
    for dx, dy, yaw in drive:
        before = progress.next_index, progress.arc_m
        x, y, driven_m = x + dx, y + dy, driven_m + math.hypot(dx, dy)
        progress.update(route, at(x, y, yaw))
        gained_m = progress.arc_m - before[1]
        assert progress.next_index >= before[0]
        assert 0.0 <= gained_m <= SHORT_CUT * driven_m + GAIN_M + 1e-6
        assert progress.next_index < len(points)
        if progress.next_index > before[0]:
            assert arcs_m[progress.next_index - 1] <= progress.arc_m + REACHED_ALONG_M
        driven_m = 0.0 if gained_m else driven_m


@given(st.lists(st.tuples(st.floats(10.0, 30.0), st.floats(-math.pi, math.pi)), min_size=1, max_size=8), st.data())
def test_any_line_is_followed_in_its_order(legs, data) -> None:
    """Corners of any angle, crossings included: the car is never taken to be far from where it is along the line."""
    points = [(0.0, 0.0)]
    for length_m, yaw in legs:
        points.append((points[-1][0] + length_m * math.cos(yaw), points[-1][1] + length_m * math.sin(yaw)))
    progress = RouteProgress()
    step_m = data.draw(st.floats(0.2, 2.5))
    for arc_m, sample in along(points, step_m):
        progress.update(route_of(points), sample)
        assert arc_m - 1e-6 <= progress.arc_m <= arc_m + GAIN_M + step_m


def passed_by_car_axes_alone(route: Route, samples) -> list[int]:
    """The rule with which the shipped policy was trained: pass whatever is less than 4 m ahead in the car's axes."""
    index, passed, last = 0, [], len(route.checkpoints_m) - 1
    for sample in samples:
        cos, sin = math.cos(sample.yaw_rad), math.sin(sample.yaw_rad)
        ahead_m = (route.checkpoints_m - (sample.x_m, sample.y_m)) @ (cos, sin)
        while index < last and ahead_m[index] <= REACHED_AHEAD_M:
            index += 1
        passed.append(index)
    return passed


@pytest.mark.parametrize('left_m', [0.0, 1.5, -3.5])
def test_on_the_routes_of_a_suite_the_old_rule_says_the_same(left_m) -> None:
    env = DrivingEnv(SimulationConfig(cameras=False, bev=False))
    for name in load_suite('dev10').routes:
        env.reset_to(name)
        route, progress, passed, samples = env.route, RouteProgress(), [], []
        for s_m in np.arange(1.0, env.world.goal_s_m, STEP_M):
            x, y, yaw = env.world.route.pose(float(s_m))
            samples.append(at(x - left_m * math.sin(yaw), y + left_m * math.cos(yaw), yaw))
            progress.update(route, samples[-1])
            passed.append(progress.next_index)
        assert passed == passed_by_car_axes_alone(route, samples), name
        assert passed[-1] == len(route.checkpoints_m) - 1


def test_a_car_that_is_turned_sideways_does_not_lose_its_route() -> None:
    """Noise of a collected drive turns the car about; the rule in the car's axes alone then goes on to the goal."""
    points = [(0, -1.8), (25, -1.8), (50, -1.8), (62.2, 16.3), (62.2, 41.3), (62.2, 66.3), (62.3, 82.3)]
    samples = [*(at(x, -1.8) for x in np.arange(0.0, 47.0, STEP_M)), at(51.2, 1.3, -0.43)]
    progress = RouteProgress()
    for sample in samples:
        progress.update(route_of(points), sample)
    assert progress.next_index == 3
    assert passed_by_car_axes_alone(route_of(points), samples)[-1] == 6
