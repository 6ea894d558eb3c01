"""Ability Overtaking: an obstacle blocks the lane, and another lane leads past it."""

from __future__ import annotations

from raw2drive_ros.simulation.draws import Draw, Rng
from raw2drive_ros.simulation.flows import arriving, group_times
from raw2drive_ros.simulation.layout import LANE_WIDTH_M, RoadLayout, Straight
from raw2drive_ros.simulation.scenario import (
    AlongRoad,
    DoorSpec,
    FlowSpec,
    LaneChange,
    RouteSpec,
    Scene,
    StandingSpec,
    TrafficSpec,
    scenario,
)
from raw2drive_ros.simulation.scenarios.parts import approach, background, layout, road_length_m, stream


def _past(where_m: float, lane: int) -> tuple[LaneChange, ...]:
    """Lane changes of the detour around an obstacle at `where_m`: to the left before it and back after it."""
    return (LaneChange(where_m - 42, lane - 1, 26), LaneChange(where_m + 12, lane, 26))


def _left_lane(rng: Rng, where_m: float) -> tuple[TrafficSpec, ...]:
    """A flow of traffic in the left lane that passes the obstacle at `where_m` when the ego arrives there."""
    times = group_times(rng, float(rng.uniform(4, 6)), float(rng.uniform(14, 19)), (1.6, 2.0), (5.0, 6.5), groups=3)
    return arriving(times, 'forward', where_m - 25.0, float(rng.uniform(7.0, 9.0)), has_priority=False)


def _past_oncoming(where_m: float, length_m: float, lane: float = -1) -> tuple[LaneChange, ...]:
    """Lane changes of the detour through (part of) the oncoming lane, around an obstacle `length_m` long that ends at
    `where_m`."""
    return (LaneChange(where_m - length_m - 24, lane, 18), LaneChange(where_m + 6, 0, 18))


def _oncoming(rng: Rng, first_m: float, count: int) -> tuple[TrafficSpec, ...]:
    """Oncoming cars, the first one `first_m` from the far end of the road, with one long gap between them."""
    speed = float(rng.uniform(5.5, 8.0))
    cars, s = [], first_m
    long_gap = int(rng.integers(1, count)) if count > 1 else 0
    for i in range(count):
        if s > 0:
            cars.append(TrafficSpec('backward', s, speed))
        s -= float(rng.uniform(95, 130)) if i + 1 == long_gap else float(rng.uniform(16, 30))
    return tuple(cars)


def _crash(rng: Rng, where_m: float, lateral_m: float) -> tuple[StandingSpec, ...]:
    """Two crashed cars, and a police van behind them."""
    turned = float(rng.uniform(0.15, 0.35)) * float(rng.choice((-1, 1)))
    return (
        StandingSpec('parked_emergency', where_m - 13.5, lateral_m),
        StandingSpec('parked', where_m - 5.2, lateral_m, turned),
        StandingSpec('parked', where_m, lateral_m + 0.2, -turned),
    )


def _blocked_lane(draw: Draw, length_m: float) -> tuple[RoadLayout, float, int]:
    """(road with two or three lanes in the ego's direction, where an obstacle of `length_m` ends, the ego's lane)."""
    lanes = draw.choice('lanes', (2, 3), key=True)
    before = draw.uniform('event_s_m', 130.0, 230.0, key=True)
    pieces = (*approach(draw, before - 60.0), Straight(170.0 + length_m))
    road = layout(draw, pieces, (lanes, draw.choice('backward', (0, lanes))), (10.0, 13.5), (2.8, 3.4))
    return road, road_length_m(pieces[:-1], road, lanes - 1) + 80.0 + length_m, lanes - 1


def _beside(road: RoadLayout, lane: int) -> float:
    """Lateral offset from the middle of the rightmost lane at which a car stands on the shoulder."""
    return -(road.lane_width_m / 2 + road.shoulder_m - 1.3)


def _next_lane(draw: Draw, where_m: float, lane: int) -> FlowSpec:
    """A stream in the lane left of the ego's, past an obstacle at `where_m`."""
    speed = draw.uniform('stream_mps', 7.0, 9.0)
    return stream(draw, AlongRoad(where_m - 22.0, lane - 1), speed, 4.8, headway_s=(1.5, 1.9), passes=False)


@scenario('ParkedObstacle', 'Overtaking')
def parked_obstacle(draw: Draw) -> Scene:
    """A broken-down car stands in the right lane; traffic flows in the next one."""
    road, where, lane = _blocked_lane(draw, 6.0)
    kind = draw.choice('kind', ('parked', 'parked_van'))
    aside = 0.0 if draw.event else _beside(road, lane)
    route = RouteSpec(lane, detour=_past(where, lane) if draw.event else (), start_speed_mps=7.0)
    actors = (StandingSpec(kind, where, aside), _next_lane(draw, where, lane))
    return Scene(road, route, actors, background=background(draw), event_s_m=(where - 45.0, where + 40.0))


@scenario('ConstructionObstacle', 'Overtaking')
def construction(rng: Rng) -> Scene:
    """Cones and a barrier close the right lane; traffic flows in the left one."""
    where = float(rng.uniform(80, 110))
    cones = tuple(StandingSpec('cone', where - 10 + 3 * i, -1.4 + 0.45 * i) for i in range(4))
    barrier = StandingSpec('barrier', where + 4, 0.0)
    layout = RoadLayout((Straight(220),), 2, 0, 11.0)
    route = RouteSpec(1, detour=_past(where, 1), start_speed_mps=5.0)
    return Scene(layout, route, (*cones, barrier, *_left_lane(rng, where)))


@scenario('HazardAtSideLane', 'Overtaking')
def slow_cyclists(rng: Rng) -> Scene:
    """Slow cyclists ride near the edge of the right lane; traffic flows in the left one."""
    where = float(rng.uniform(55, 70))
    speed = float(rng.uniform(1.2, 1.8))
    riders = tuple(
        TrafficSpec('forward', where + gap, speed, lane=1, kind='cyclist', lateral_m=-0.8, ignores_traffic=True)
        for gap in (0.0, 4.0)
    )
    # Long before and long after: the cyclists move on while the ego passes them.
    detour = (LaneChange(where - 32, 0, 25), LaneChange(where + 65, 1, 30))
    layout = RoadLayout((Straight(240),), 2, 0, 11.0)
    times = group_times(rng, float(rng.uniform(2, 4)), float(rng.uniform(10, 14)), (1.6, 2.0), (5.0, 6.5))
    traffic = arriving(times, 'forward', where - 15.0, float(rng.uniform(7.0, 9.0)), has_priority=False)
    return Scene(layout, RouteSpec(1, detour=detour, start_speed_mps=5.0), (*riders, *traffic))


@scenario('Accident', 'Overtaking')
def accident(rng: Rng) -> Scene:
    """Two crashed cars and a police van block the right lane; traffic flows in the left one."""
    where = float(rng.uniform(90, 120))
    detour = (LaneChange(where - 55, 0, 26), LaneChange(where + 12, 1, 26))
    layout = RoadLayout((Straight(230),), 2, 0, 11.0)
    route = RouteSpec(1, detour=detour, start_speed_mps=5.0)
    return Scene(layout, route, (*_crash(rng, where, 0.0), *_left_lane(rng, where - 12.0)))


@scenario('AccidentTwoWays', 'Overtaking')
def accident_two_ways(rng: Rng) -> Scene:
    """Two crashed cars and a police van block the ego's only lane; the detour leads through the oncoming one."""
    where = float(rng.uniform(95, 115))
    layout = RoadLayout((Straight(230),), 1, 1, 10.0, shoulder_m=1.5)
    blockers = _crash(rng, where, 0.0)
    traffic = _oncoming(rng, float(rng.uniform(60, 110)), int(rng.integers(1, 4)))
    return Scene(layout, RouteSpec(0, detour=_past_oncoming(where + 4, 22), start_speed_mps=5.0), (*blockers, *traffic))


@scenario('ParkedObstacleTwoWays', 'Overtaking')
def parked_obstacle_two_ways(rng: Rng) -> Scene:
    """A broken-down car stands in the ego's only lane; oncoming cars use the other."""
    where = float(rng.uniform(80, 110))
    layout = RoadLayout((Straight(220),), 1, 1, 10.0, shoulder_m=1.5)
    kind = str(rng.choice(('parked', 'parked_van')))
    blocker = StandingSpec(kind, where, 0.0)
    traffic = _oncoming(rng, float(rng.uniform(60, 110)), int(rng.integers(1, 4)))
    return Scene(layout, RouteSpec(0, detour=_past_oncoming(where + 3, 6), start_speed_mps=5.0), (blocker, *traffic))


@scenario('ConstructionObstacleTwoWays', 'Overtaking')
def construction_two_ways(rng: Rng) -> Scene:
    """Cones and a barrier close the ego's only lane; oncoming cars use the other."""
    where = float(rng.uniform(85, 110))
    cones = tuple(StandingSpec('cone', where - 10 + 3 * i, -1.4 + 0.4 * i) for i in range(4))
    barrier = StandingSpec('barrier', where + 4, 0.0)
    layout = RoadLayout((Straight(220),), 1, 1, 10.0, shoulder_m=1.5)
    traffic = _oncoming(rng, float(rng.uniform(60, 110)), int(rng.integers(1, 4)))
    return Scene(
        layout, RouteSpec(0, detour=_past_oncoming(where + 6, 17), start_speed_mps=5.0), (*cones, barrier, *traffic)
    )


@scenario('HazardAtSideLaneTwoWays', 'Overtaking')
def slow_cyclists_two_ways(rng: Rng) -> Scene:
    """Slow cyclists ride near the edge of the ego's only lane; passing them takes most of the oncoming one."""
    where = float(rng.uniform(60, 75))
    speed = float(rng.uniform(1.2, 1.8))
    riders = tuple(
        TrafficSpec('forward', where + gap, speed, kind='cyclist', lateral_m=-1.0, ignores_traffic=True)
        for gap in (0.0, 4.0)
    )
    detour = (LaneChange(where - 20, -0.75, 18), LaneChange(where + 70, 0, 18))
    layout = RoadLayout((Straight(240),), 1, 1, 10.0, shoulder_m=1.0)
    traffic = _oncoming(rng, float(rng.uniform(60, 110)), int(rng.integers(1, 3)))
    return Scene(layout, RouteSpec(0, detour=detour, start_speed_mps=5.0), (*riders, *traffic))


@scenario('VehicleOpensDoorTwoWays', 'Overtaking')
def opening_door(rng: Rng) -> Scene:
    """The door of a parked car opens into the ego's lane; passing it takes a part of the oncoming one."""
    where = float(rng.uniform(65, 95))
    beside = -(LANE_WIDTH_M / 2 + 0.75 + float(rng.uniform(0.0, 0.2)))
    parked = tuple(StandingSpec('parked', where + gap, beside) for gap in (-7.0, 0.0, 7.5))
    door = DoorSpec(where + 0.5, beside + 0.95, float(rng.uniform(30, 40)))
    layout = RoadLayout((Straight(200),), 1, 1, float(rng.uniform(8, 10)), shoulder_m=3.0)
    traffic = _oncoming(rng, float(rng.uniform(50, 100)), int(rng.integers(1, 3)))
    route = RouteSpec(0, detour=_past_oncoming(where + 10, 20, lane=-0.5), start_speed_mps=5.0)
    return Scene(layout, route, (*parked, door, *traffic))
