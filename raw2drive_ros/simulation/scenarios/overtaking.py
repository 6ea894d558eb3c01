"""Ability Overtaking: an obstacle blocks the lane, and another lane leads past it."""

from __future__ import annotations

from dataclasses import replace

from raw2drive_ros.simulation.draws import Draw
from raw2drive_ros.simulation.layout import RoadLayout, Straight
from raw2drive_ros.simulation.scenario import (
    AlongRoad,
    CarSpec,
    DoorSpec,
    FlowSpec,
    LaneChange,
    RouteSpec,
    Scene,
    StandingSpec,
    scenario,
)
from raw2drive_ros.simulation.scenarios.parts import approach, background, layout, parked_row, road_length_m, stream
from raw2drive_ros.simulation.scripts import Script

# Straight road before and beyond an obstacle: it has to be seen, and oncoming traffic too.
BEFORE_M, BEYOND_M = 60.0, 115.0
# Traffic in the lane that is blocked would stand behind the obstacle in the event alone.
OTHER_LANES = ('beside', 'oncoming', 'cross')
# Way from one lane to the next before and behind an obstacle in the ego's only lane, speed of the ego meanwhile, and
# the time that it takes to get going.
SHIFT_M, PASSING_MPS, START_S = 18.0, 6.0, 2.5
# Cyclists dawdle until the ego is due within this time: whoever drives slowly meets them, too.
CYCLISTS_DUE_S, DAWDLE_MPS = 6.0, 0.4


def _past(where_m: float, length_m: float, lane: int) -> tuple[LaneChange, ...]:
    """Lane changes of the detour around an obstacle of `length_m` that ends at `where_m`: to the left and back."""
    return LaneChange(where_m - length_m - 36.0, lane - 1, 26.0), LaneChange(where_m + 12.0, lane, 26.0)


def _past_oncoming(where_m: float, length_m: float) -> tuple[LaneChange, ...]:
    """Lane changes of the detour through the oncoming lane, around an obstacle of `length_m` that ends at `where_m`."""
    return LaneChange(where_m - length_m - 24.0, -1, SHIFT_M), LaneChange(where_m + 6.0, 0, SHIFT_M)


def _beside(road: RoadLayout, half_width_m: float = 0.95) -> float:
    """Lateral offset from the middle of the rightmost lane at which something stands on the shoulder."""
    return -(road.lane_width_m / 2 + max(half_width_m + 0.25, road.shoulder_m - half_width_m - 0.2))


def _blocked_lane(draw: Draw, length_m: float, beyond_m: float = BEYOND_M) -> tuple[RoadLayout, float, int]:
    """(road with two or three lanes in the ego's direction, where an obstacle of `length_m` ends, the ego's lane)."""
    lanes = draw.choice('lanes', (2, 3), key=True)
    before = draw.uniform('event_s_m', 140.0, 230.0, key=True)
    pieces = (*approach(draw, before - BEFORE_M), Straight(BEFORE_M + length_m + beyond_m))
    road = layout(draw, pieces, (lanes, draw.choice('backward', (0, lanes))), (10.0, 11.5), (2.8, 3.4))
    return road, road_length_m(pieces[:-1], road, lanes - 1) + BEFORE_M + length_m, lanes - 1


def _two_ways(draw: Draw, length_m: float, beyond_m: float = BEYOND_M) -> tuple[RoadLayout, float]:
    """(road with one lane each way, where an obstacle of `length_m` ends)."""
    before = draw.uniform('event_s_m', 130.0, 220.0, key=True)
    pieces = (*approach(draw, before - BEFORE_M), Straight(BEFORE_M + length_m + beyond_m))
    road = layout(draw, pieces, (1, 1), (9.5, 12.5), (2.6, 3.2))
    return road, road_length_m(pieces[:-1], road, 0) + BEFORE_M + length_m


def _next_lane(draw: Draw, where_m: float, lane: int) -> FlowSpec:
    """A stream in the lane left of the ego's, with a point at `where_m`."""
    speed = draw.uniform('stream_mps', 7.0, 8.5, key=True)
    return stream(draw, AlongRoad(where_m, lane - 1), speed, 6.5, headway_s=(1.5, 1.9), passes=False)


def _oncoming(draw: Draw, where_m: float, length_m: float, shift_m: float = SHIFT_M) -> FlowSpec:
    """An oncoming stream with gaps for an ego that passes an obstacle of `length_m` that ends at `where_m`: the last
    car of a platoon has to be by before it starts, and it has to be back before the next one comes."""
    speed = draw.uniform('stream_mps', 5.5, 7.5, key=True)
    zone = length_m + 2.0 * shift_m
    need = START_S + zone / PASSING_MPS + zone / speed
    return stream(draw, AlongRoad(where_m - length_m / 2, 0, oncoming=True), speed, need, passes=False)


def _scene(
    draw: Draw,
    road: RoadLayout,
    lane: int,
    where_m: float,
    length_m: float,
    actors: tuple[StandingSpec | CarSpec | DoorSpec | FlowSpec, ...],
    detour: tuple[LaneChange, ...],
) -> Scene:
    """The scene with an obstacle of `length_m` that ends at `where_m`; the twin has no detour."""
    route = RouteSpec(lane, detour=detour if draw.event else (), start_speed_mps=7.0)
    event = (where_m - length_m - 40.0, where_m + 30.0)
    # Wide enough for the obstacle in the lane and beside it.
    traffic = replace(background(draw, lanes=OTHER_LANES), clear_m=(where_m - length_m - 15.0, where_m + 15.0))
    return Scene(road, route, actors, background=traffic, event_s_m=event)


def _without_strip(scene: Scene) -> Scene:
    """The scene without background traffic where its own actors ride and stand beside the lane."""
    assert scene.background is not None
    return replace(scene, background=replace(scene.background, parked=0.0, cyclists=0))


# -- obstacles --------------------------------------------------------------------------------


def _broken_down(draw: Draw, road: RoadLayout, where_m: float) -> tuple[StandingSpec, ...]:
    """A car or van that stands in the lane; in the twin on the shoulder."""
    kind = draw.choice('kind', ('parked', 'parked_van'), key=True)
    lateral, yaw = draw.uniform('lateral_m', -0.3, 0.2), draw.uniform('yaw_rad', -0.06, 0.06)
    return (StandingSpec(kind, where_m - 3.0, lateral if draw.event else _beside(road), yaw),)


def _road_works(draw: Draw, road: RoadLayout, where_m: float) -> tuple[StandingSpec, ...]:
    """A taper of cones and barriers that closes the lane, 16 m long; in the twin the same beside it."""
    count = draw.integer('cones', 4, 6)
    barriers = draw.integer('barriers', 1, 2, key=True)
    half = road.lane_width_m / 2
    begin, end = (-half + 0.2, 0.7) if draw.event else (_beside(road) - 0.3, _beside(road) + 0.3)
    step = 9.0 / (count - 1)
    cones = tuple(
        StandingSpec('cone', where_m - 16.0 + step * i, begin + (end - begin) * i / (count - 1)) for i in range(count)
    )
    aside = 0.0 if draw.event else _beside(road)
    return (*cones, *(StandingSpec('barrier', where_m - 1.0 - 3.5 * i, aside) for i in range(barriers)))


def _crash(draw: Draw, road: RoadLayout, where_m: float) -> tuple[StandingSpec, ...]:
    """Two crashed cars, and a police van behind them, 18 m long; in the twin they stand on the shoulder."""
    turned = draw.uniform('turned_rad', 0.15, 0.35) * draw.side('turned_side', key=True)
    lateral = draw.uniform('lateral_m', -0.2, 0.2)
    aside = _beside(road, 1.05)
    gap = draw.uniform('crash_gap_m', 4.9, 5.4)
    places = ((-2.5 - gap - 7.8, 'parked_emergency', 0.0), (-2.5 - gap, 'parked', turned), (-2.5, 'parked', -turned))
    return tuple(
        StandingSpec(kind, where_m + at, lateral if draw.event else aside, yaw if draw.event else 0.2 * yaw)
        for at, kind, yaw in places
    )


def _cyclists(draw: Draw, road: RoadLayout, where_m: float, lane: int) -> tuple[CarSpec | StandingSpec, ...]:
    """Two slow cyclists, almost side by side, in the lane; in the twin on the strip beside it. Before: parked cars."""
    speed = draw.uniform('cyclist_mps', 1.6, 2.4, key=True)
    inner, outer = draw.uniform('inner_m', -0.2, 0.1), draw.uniform('outer_m', -1.15, -1.0)
    ahead = draw.uniform('ahead_m', 0.6, 2.2)
    strip = -road.lane_width_m / 2 - 0.75
    places = ((0.0, inner), (ahead, outer)) if draw.event else ((0.0, strip), (ahead, strip - 0.9))
    row = parked_row(draw, 'row', 25.0, where_m - 25.0, _beside(road))
    riders = tuple(
        CarSpec(
            AlongRoad(where_m + along, lane),
            DAWDLE_MPS,
            kind='cyclist',
            lateral_m=lateral,
            scripts=(Script(ego_due=(where_m, CYCLISTS_DUE_S), target_speed_mps=speed),),
        )
        for along, lateral in places
    )
    return (*riders, *row)


# -- types ------------------------------------------------------------------------------------


@scenario('ParkedObstacle', 'Overtaking')
def parked_obstacle(draw: Draw) -> Scene:
    """A broken-down car stands in the right lane; traffic flows in the next one."""
    road, where, lane = _blocked_lane(draw, 6.0)
    actors = (*_broken_down(draw, road, where), _next_lane(draw, where - 22.0, lane))
    return _scene(draw, road, lane, where, 6.0, actors, _past(where, 6.0, lane))


@scenario('ConstructionObstacle', 'Overtaking')
def construction(draw: Draw) -> Scene:
    """Cones and barriers close the right lane; traffic flows in the next one."""
    road, where, lane = _blocked_lane(draw, 16.0)
    actors = (*_road_works(draw, road, where), _next_lane(draw, where - 32.0, lane))
    return _scene(draw, road, lane, where, 16.0, actors, _past(where, 16.0, lane))


@scenario('Accident', 'Overtaking')
def accident(draw: Draw) -> Scene:
    """Two crashed cars and a police van block the right lane; traffic flows in the next one."""
    road, where, lane = _blocked_lane(draw, 18.0)
    actors = (*_crash(draw, road, where), _next_lane(draw, where - 34.0, lane))
    return _scene(draw, road, lane, where, 18.0, actors, _past(where, 18.0, lane))


@scenario('ParkedObstacleTwoWays', 'Overtaking')
def parked_obstacle_two_ways(draw: Draw) -> Scene:
    """A broken-down car stands in the ego's only lane; oncoming cars use the other."""
    road, where = _two_ways(draw, 6.0)
    actors = (*_broken_down(draw, road, where), _oncoming(draw, where, 6.0))
    return _scene(draw, road, 0, where, 6.0, actors, _past_oncoming(where, 6.0))


@scenario('ConstructionObstacleTwoWays', 'Overtaking')
def construction_two_ways(draw: Draw) -> Scene:
    """Cones and barriers close the ego's only lane; oncoming cars use the other."""
    road, where = _two_ways(draw, 16.0)
    actors = (*_road_works(draw, road, where), _oncoming(draw, where, 16.0))
    return _scene(draw, road, 0, where, 16.0, actors, _past_oncoming(where, 16.0))


@scenario('AccidentTwoWays', 'Overtaking')
def accident_two_ways(draw: Draw) -> Scene:
    """Two crashed cars and a police van block the ego's only lane; the detour leads through the oncoming one."""
    road, where = _two_ways(draw, 18.0)
    actors = (*_crash(draw, road, where), _oncoming(draw, where, 18.0))
    return _scene(draw, road, 0, where, 18.0, actors, _past_oncoming(where, 18.0))


@scenario('HazardAtSideLane', 'Overtaking')
def slow_cyclists(draw: Draw) -> Scene:
    """Slow cyclists ride in the right lane; traffic flows in the next one."""
    road, where, lane = _blocked_lane(draw, 0.0, 185.0)
    actors = (*_cyclists(draw, road, where, lane), _next_lane(draw, where + 40.0, lane))
    # Long before and long after: the cyclists move on while the ego waits for a gap, and while it passes them.
    detour = LaneChange(where - 25.0, lane - 1, 26.0), LaneChange(where + 140.0, lane, 26.0)
    return _without_strip(_scene(draw, road, lane, where + 100.0, 100.0, actors, detour))


@scenario('HazardAtSideLaneTwoWays', 'Overtaking')
def slow_cyclists_two_ways(draw: Draw) -> Scene:
    """Slow cyclists ride in the ego's only lane; passing them takes most of the oncoming one."""
    road, where = _two_ways(draw, 0.0, 200.0)
    actors = (*_cyclists(draw, road, where, 0), _oncoming(draw, where + 45.0, 16.0))
    detour = LaneChange(where - 15.0, -1, SHIFT_M), LaneChange(where + 150.0, 0, SHIFT_M)
    return _without_strip(_scene(draw, road, 0, where + 100.0, 100.0, actors, detour))


@scenario('VehicleOpensDoorTwoWays', 'Overtaking')
def opening_door(draw: Draw) -> Scene:
    """The door of a parked car opens into the ego's narrow lane; passing it takes a part of the oncoming one."""
    road, where = _two_ways(draw, 0.0)
    road = replace(road, lane_width_m=draw.uniform('narrow_m', 3.1, 3.4))
    # One car is parked with its wheels beyond the line. Cars on the other side make oncoming ones keep to the middle of
    # the road: between those and the door is no way.
    near_side = -draw.uniform('near_side_m', 1.2, 1.25)
    due = draw.uniform('due_s', 2.8, 3.6, key=True)
    parked = StandingSpec('parked', where, near_side - 0.9)
    row = parked_row(draw, 'row', 30.0, where + 50.0, -road.lane_width_m / 2 - 1.1, (where - 20.0, where + 22.0))
    aside = 1.5 * road.lane_width_m + 0.9
    opposite = parked_row(draw, 'opposite', where - 40.0, where + 70.0, aside)
    door = DoorSpec(where + 0.5, near_side, due, happens=draw.event)
    flow = replace(_oncoming(draw, where + 3.0, 6.0, 13.0), lateral_m=road.lane_width_m - 2.7)
    detour = LaneChange(where - 20.0, -0.5, 14.0), LaneChange(where + 8.0, 0, 14.0)
    return _without_strip(_scene(draw, road, 0, where, 0.0, (parked, door, *row, *opposite, flow), detour))
