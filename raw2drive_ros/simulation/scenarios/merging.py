"""Ability Merging, on roads, ramps and from a parking bay: the ego joins a flow of traffic."""

from __future__ import annotations

from raw2drive_ros.simulation.draws import Rng
from raw2drive_ros.simulation.flows import arriving, group_times
from raw2drive_ros.simulation.layout import LANE_WIDTH_M, RoadLayout, Straight
from raw2drive_ros.simulation.scenario import (
    LaneChange,
    RouteSpec,
    Scene,
    StandingSpec,
    TrafficSpec,
    scenario,
)
from raw2drive_ros.simulation.scripts import Pacing, Script

# Headways in a flow of traffic in the ego's direction, and the gaps that are large enough for the ego.
ALONG_S, ROOM_S = (1.6, 2.0), (4.2, 5.2)


@scenario('MergerIntoSlowTraffic', 'Merging')
def merge_from_ramp(rng: Rng) -> Scene:
    """The ego merges from an on-ramp into slow traffic."""
    speed = float(rng.uniform(6, 8))
    layout = RoadLayout((Straight(130), Straight(110, ramp=True), Straight(110)), 2, 0, 13.0)
    times = group_times(rng, float(rng.uniform(9, 11)), 21.0, ALONG_S, ROOM_S, 9.0, groups=3)
    traffic = arriving(times, 'forward', 225.0, speed, lane=1, has_priority=False)
    return Scene(layout, RouteSpec(from_ramp=True, start_speed_mps=6.0), traffic)


@scenario('MergerIntoSlowTrafficV2', 'Merging')
def merge_from_ramp_into_dense_traffic(rng: Rng) -> Scene:
    """The ego merges from an on-ramp into the slow right lane of a three-lane road."""
    speed = float(rng.uniform(4, 6))
    layout = RoadLayout((Straight(130), Straight(120, ramp=True), Straight(110)), 3, 0, 13.0)
    times = group_times(rng, float(rng.uniform(9, 11)), 24.0, (2.0, 2.5), (5.0, 6.5), 12.0, groups=3)
    slow = arriving(times, 'forward', 235.0, speed, lane=2, has_priority=False)
    fast = tuple(TrafficSpec('forward', float(s), speed * 1.6, lane=1) for s in (40, 95, 150))
    return Scene(layout, RouteSpec(from_ramp=True, start_speed_mps=6.0), (*slow, *fast))


@scenario('HighwayCutIn', 'Merging')
def highway_cut_in(rng: Rng) -> Scene:
    """A car in the left lane keeps pace with the ego, then cuts in close ahead and brakes."""
    speed = float(rng.uniform(8, 11))
    where = float(rng.uniform(55, 85))
    cutter = TrafficSpec(
        'forward',
        s_m=float(rng.uniform(14, 22)),
        speed_mps=speed,
        lane=0,
        scripts=(
            Script(ego_at_s_m=where, drift_m=-LANE_WIDTH_M, drift_over_m=float(rng.uniform(12, 16))),
            Script(ego_at_s_m=where, acceleration_mps2=-float(rng.uniform(3.0, 4.5)), until_speed_mps=4.0),
        ),
        pacing=Pacing(float(rng.uniform(6.5, 9.0)), where),
    )
    others = tuple(TrafficSpec('forward', float(s), speed, lane=int(rng.choice((0, 2)))) for s in (70, 95, 120))
    layout = RoadLayout((Straight(260),), 3, 0, 14.0)
    return Scene(layout, RouteSpec(lane=1, start_speed_mps=speed * 0.8), (cutter, *others))


@scenario('SequentialLaneChange', 'Merging')
def sequential_lane_change(rng: Rng) -> Scene:
    """The route requires two lane changes through moving traffic."""
    speed = float(rng.uniform(6.5, 8.5))
    start = int(rng.choice((0, 2)))
    first, second = float(rng.uniform(65, 80)), float(rng.uniform(140, 155))
    changes = (LaneChange(first, 1, 25), LaneChange(second, 2 - start, 25))
    middle = arriving(
        group_times(rng, float(rng.uniform(4, 6)), 17.0, ALONG_S, ROOM_S, 8.0, groups=3),
        'forward',
        first + 12.0,
        speed,
        lane=1,
        has_priority=False,
    )
    far = arriving(
        group_times(rng, float(rng.uniform(12, 15)), 27.0, ALONG_S, ROOM_S, 8.0, groups=3),
        'forward',
        second + 12.0,
        speed,
        lane=2 - start,
        has_priority=False,
    )
    layout = RoadLayout((Straight(270),), 3, 0, 11.0)
    return Scene(layout, RouteSpec(start, changes, start_speed_mps=6.0), (*middle, *far))


@scenario('HighwayExit', 'Merging')
def highway_exit(rng: Rng) -> Scene:
    """The ego leaves the left lane, crosses the traffic of the right one and takes an exit."""
    speed = float(rng.uniform(7, 9))
    layout = RoadLayout((Straight(120), Straight(100, exit=True), Straight(70)), 2, 0, 13.0)
    first = float(rng.uniform(50, 65))
    changes = (LaneChange(first, 1, 28), LaneChange(155.0, 2, 30))
    times = group_times(rng, float(rng.uniform(3, 4)), 15.0, ALONG_S, ROOM_S, 8.0, groups=3)
    traffic = arriving(times, 'forward', first + 14.0, speed, lane=1, has_priority=False)
    return Scene(layout, RouteSpec(0, changes, to_exit=True, start_speed_mps=6.0), traffic)


@scenario('ParkingExit', 'Merging')
def parking_exit(rng: Rng) -> Scene:
    """The ego leaves a parking bay between parked cars and joins the lane beside it."""
    bay = (LANE_WIDTH_M / 2 + 1.3) / LANE_WIDTH_M
    start = 30.0
    # All parked cars stand in one row. The route leaves it, so those further on have a lateral offset from the route.
    before = tuple(StandingSpec('parked', s, 0.0) for s in (start - 17.0, start - 8.0))
    after = tuple(StandingSpec('parked', start + s, -bay * LANE_WIDTH_M) for s in (26.0, 33.0))
    speed = float(rng.uniform(5.5, 7.5))
    times = group_times(rng, float(rng.uniform(0.5, 1.2)), float(rng.uniform(9, 13)), (1.5, 1.8))
    traffic = arriving(times, 'forward', start + 12.0, speed, has_priority=False)
    layout = RoadLayout((Straight(170),), 1, 1, float(rng.uniform(8, 10)), shoulder_m=3.2)
    route = RouteSpec(bay, (LaneChange(start + 3.0, 0, 15.0),), start_s_m=start)
    return Scene(layout, route, (*before, *after, *traffic))
