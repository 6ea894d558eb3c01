"""Ability Merging, on roads, ramps and from a parking bay: the ego joins a flow of traffic."""

from __future__ import annotations

import math
from dataclasses import replace

from raw2drive_ros.simulation.draws import Draw
from raw2drive_ros.simulation.layout import Piece, Straight
from raw2drive_ros.simulation.road_builder import RAMP_BEFORE_M, RAMP_CURVE_M
from raw2drive_ros.simulation.scenario import (
    AlongRoad,
    CarSpec,
    LaneChange,
    OnRamp,
    RouteSpec,
    Scene,
    StandingSpec,
    scenario,
)
from raw2drive_ros.simulation.scenarios.parts import (
    background,
    bend,
    layout,
    parked_row,
    stream,
)
from raw2drive_ros.simulation.scripts import Meeting, Script

# Headways in a stream in the ego's direction. Gaps for an ego that joins it: reaction, and room to get up to speed.
ALONG_S, ROOM_S, FROM_STANDING_S = (1.5, 1.9), 6.0, 7.5
# Where the way from an acceleration lane is within reach of a car in the next lane, before its end.
JOINS_M = 17.0
OTHER_LANES = ('beside', 'oncoming', 'cross')


def _onward(draw: Draw, straight_m: float) -> tuple[Piece, ...]:
    """The road after the event: straight, then with a bend or without."""
    curve = bend(draw, 'onward_bend', 0.5)
    if draw.choice('onward', ('straight', 'bend')) == 'straight':
        return (Straight(straight_m + 50.0),)
    return Straight(straight_m), curve, Straight(30.0)


def _from_ramp(
    draw: Draw,
    lanes: int,
    limit_mps: tuple[float, float],
    speed_mps: tuple[float, float],
    headway_s: tuple[float, float],
) -> Scene:
    """The ego comes from an on-ramp; a stream flows in the lane that it has to join."""
    along = draw.uniform('acceleration_lane_m', 95.0, 145.0, key=True)
    before = draw.uniform('before_m', 125.0, 160.0)
    speed = draw.uniform('stream_mps', *speed_mps, key=True)
    pieces = (Straight(before), Straight(along, ramp=True), *_onward(draw, 25.0))
    road = layout(draw, pieces, (lanes, draw.choice('backward', (0, lanes))), limit_mps, (0.8, 1.8))
    start = draw.uniform('start_s_m', -60.0, 0.0, key=True)
    place = AlongRoad(before + along - JOINS_M, lanes - 1)
    flow = stream(draw, place, speed, ROOM_S, headway_s=headway_s)
    # The ramp's arc lengths begin below 0.
    flow = replace(flow, armed_within_m=60.0, from_s_m=-math.inf)
    ends = RAMP_BEFORE_M + RAMP_CURVE_M + along
    route = RouteSpec(from_ramp=True, start_s_m=start, start_speed_mps=7.0)
    event = (ends - along - 20.0, ends + 25.0)
    return Scene(road, route, (flow,), background=background(draw, parked=False, lanes=OTHER_LANES), event_s_m=event)


@scenario('MergerIntoSlowTraffic', 'Merging')
def merge_from_ramp(draw: Draw) -> Scene:
    """The ego merges from an on-ramp into slow traffic."""
    return _from_ramp(draw, 2, (9.0, 10.5), (5.5, 7.5), (1.55, 1.8))


@scenario('MergerIntoSlowTrafficV2', 'Merging')
def merge_from_ramp_into_dense_traffic(draw: Draw) -> Scene:
    """The ego merges from an on-ramp into the slow right lane of a three-lane road."""
    return _from_ramp(draw, 3, (9.0, 10.0), (4.5, 6.0), (1.8, 2.0))


@scenario('HighwayCutIn', 'Merging')
def highway_cut_in(draw: Draw) -> Scene:
    """A slower car from an on-ramp cuts in right in front of the ego, then accelerates."""
    lanes = draw.choice('lanes', (2, 3), key=True)
    before = draw.uniform('event_s_m', 90.0, 170.0, key=True)
    along = draw.uniform('acceleration_lane_m', 90.0, 120.0, key=True)
    share = draw.uniform('speed_share', 0.36, 0.48, key=True)
    ahead_s = draw.uniform('ahead_s', 0.3, 0.38)
    pieces = (Straight(before), Straight(along, ramp=True), *_onward(draw, 130.0))
    road = layout(draw, pieces, (lanes, 0), (14.0, 15.0), (0.8, 1.8))
    start = 6.0
    # The car comes to where its way meets the ego's lane when the ego is `ahead_s` behind it: at whatever speed the ego
    # drives, the car has `share` of it, because it begins at that share of the ego's distance. `ahead_s` is that of an
    # ego at half the limit: nobody who feels his way with a bumper may be able to drive faster.
    own, ego = RAMP_BEFORE_M + RAMP_CURVE_M + along - JOINS_M, before + along - JOINS_M
    begins = own - share * (ego - start)
    limit = road.speed_limit_mps
    ego -= 4.9 + ahead_s * (1.0 - share) * 0.45 * limit
    signal = Script(ego_due=(ego, draw.uniform('signal_s', 2.0, 2.6)), indicator='left')
    meeting = Meeting(own, ego, (1.2, 10.0), 30.0, release_m=1.0, until_left_m=-math.inf if draw.event else 46.0)
    lets_pass = (
        Script(ego_at_s_m=ego - 45.0, acceleration_mps2=-2.5, lasts_s=1.8),
        Script(ego_at_s_m=ego - 45.0, target_speed_mps=0.6),
        Script(ego_at_s_m=ego + 10.0, target_speed_mps=0.8 * limit),
    )
    # It brakes for a moment, as those do who see late how fast the others are.
    brakes = Script(ego_at_s_m=ego - 1.0, acceleration_mps2=-6.0, until_speed_mps=1.0, lasts_s=0.9)
    scripts = (signal, brakes) if draw.event else lets_pass
    car = CarSpec(OnRamp(begins), share * 0.8 * limit, 0.8 * limit, scripts=scripts, pacing=meeting)
    route = RouteSpec(lanes - 1, start_s_m=start, start_speed_mps=9.0)
    event = (before + 10.0, before + along + 40.0)
    return Scene(road, route, (car,), background=background(draw, parked=False, lanes=OTHER_LANES), event_s_m=event)


@scenario('HighwayExit', 'Merging')
def highway_exit(draw: Draw) -> Scene:
    """The ego leaves the left lane, crosses the traffic of the right one and takes an exit."""
    before = draw.uniform('event_s_m', 125.0, 190.0, key=True)
    along = draw.uniform('deceleration_lane_m', 95.0, 125.0, key=True)
    speed = draw.uniform('stream_mps', 8.0, 9.5, key=True)
    late = draw.uniform('change_m', 0.0, 20.0)
    road = layout(
        draw,
        (Straight(before), Straight(along, exit=True), Straight(80.0)),
        (2, draw.choice('backward', (0, 2))),
        (10.5, 12.0),
        (0.8, 1.8),
    )
    first = before - 75.0 + late
    changes = LaneChange(first, 1, 28.0), LaneChange(before + 30.0, 2, 30.0)
    flow = stream(draw, AlongRoad(first + 14.0, 1), speed, ROOM_S, headway_s=ALONG_S)
    route = RouteSpec(0, changes, to_exit=True, start_speed_mps=8.0)
    event = (first - 30.0, before + 60.0)
    return Scene(road, route, (flow,), background=background(draw, parked=False, lanes=OTHER_LANES), event_s_m=event)


@scenario('SequentialLaneChange', 'Merging')
def sequential_lane_change(draw: Draw) -> Scene:
    """The route requires two lane changes through moving traffic."""
    speed = draw.uniform('stream_mps', 7.0, 8.5, key=True)
    start = draw.choice('from_lane', (0, 2), key=True)
    first = draw.uniform('event_s_m', 90.0, 160.0, key=True)
    second = first + draw.uniform('apart_m', 75.0, 100.0, key=True)
    changes = LaneChange(first, 1, 26.0), LaneChange(second, 2 - start, 26.0)
    road = layout(
        draw, (Straight(second + 60.0), *_onward(draw, 20.0)), (3, draw.choice('backward', (0, 3))), (10.0, 11.5)
    )
    middle = stream(draw, AlongRoad(first + 13.0, 1), speed, FROM_STANDING_S, 'middle', headway_s=ALONG_S)
    far = stream(
        draw,
        AlongRoad(second + 13.0, 2 - start),
        draw.uniform('far_mps', 7.0, 8.5),
        FROM_STANDING_S,
        'far',
        headway_s=ALONG_S,
    )
    middle = replace(middle, armed_within_m=60.0)
    # Who has waited for the first stream does not wait as long for the second one.
    far = replace(far, first_gap_after_s=draw.uniform('far_gap_s', 6.0, 10.0))
    event = (first - 30.0, second + 40.0)
    route = RouteSpec(start, changes, start_speed_mps=8.0)
    return Scene(
        road, route, (middle, far), background=background(draw, parked=False, lanes=('oncoming',)), event_s_m=event
    )


@scenario('ParkingExit', 'Merging')
def parking_exit(draw: Draw) -> Scene:
    """The ego leaves a parking bay between parked cars and joins the lane beside it."""
    start = draw.uniform('start_s_m', 25.0, 60.0, key=True)
    lanes = draw.choice('lanes', (1, 2), key=True)
    speed = draw.uniform('stream_mps', 5.5, 7.5, key=True)
    ahead = draw.uniform('room_ahead_m', 14.0, 20.0, key=True)
    pieces = (Straight(start + 90.0), bend(draw, 'bend'), Straight(draw.uniform('after_m', 60.0, 110.0)))
    road = layout(draw, pieces, (lanes, lanes), (9.0, 12.0), (2.9, 3.3))
    lane = lanes - 1
    beside = road.lane_width_m / 2 + 1.3
    row = _row_beside(draw, start, ahead, beside)
    flow = stream(draw, AlongRoad(start + 14.0, lane), speed, 5.4, headway_s=(1.4, 1.75))
    flow = replace(flow, last_passes_m=None if draw.event else 8.0)
    route = RouteSpec(lane + beside / road.lane_width_m, (LaneChange(start + 3.0, lane, 15.0),), start_s_m=start)
    return Scene(
        road,
        route,
        (*row, flow),
        background=background(draw, parked=False, lanes=OTHER_LANES),
        event_s_m=(start, start + 45.0),
    )


def _row_beside(draw: Draw, start_m: float, ahead_m: float, beside_m: float) -> tuple[StandingSpec, ...]:
    """Cars parked in one row with the ego. The route leaves it, so those further on have an offset from the route."""
    behind = parked_row(draw, 'behind', start_m - 24.0, start_m - 7.0, 0.0)
    return (*behind, *parked_row(draw, 'ahead', start_m + ahead_m + 3.0, start_m + 70.0, -beside_m))
