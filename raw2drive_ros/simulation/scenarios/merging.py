"""Merging on roads, ramps and from the kerb: the ego joins a stream of traffic."""

from __future__ import annotations

from raw2drive_ros.simulation.actors import Script
from raw2drive_ros.simulation.layout import LANE_WIDTH_M, RoadLayout, Straight
from raw2drive_ros.simulation.scenario import (
    LaneChange,
    Rng,
    RouteSpec,
    Scene,
    StandingSpec,
    TrafficSpec,
    scenario,
)


def stream(rng: Rng, count: int, first_m: float, gap_m: tuple[float, float]) -> list[float]:
    """Arc lengths of `count` vehicles, nearest to the path's end first."""
    stations, s = [], first_m
    for _ in range(count):
        stations.append(s)
        s -= float(rng.uniform(*gap_m))
    return stations


@scenario('MergerIntoSlowTraffic', 'Merging')
def merge_from_ramp(rng: Rng) -> Scene:
    """The ego comes up a ramp and merges into slow traffic."""
    speed = float(rng.uniform(6, 9))
    layout = RoadLayout((Straight(130), Straight(110, ramp=True), Straight(110)), 2, 0, 13.0)
    traffic = tuple(TrafficSpec('forward', s, speed, lane=1) for s in stream(rng, 7, 150, (18, 34)) if s > 0)
    return Scene(layout, RouteSpec(from_ramp=True, start_speed_mps=6.0), traffic)


@scenario('HighwayCutIn', 'Merging')
def highway_cut_in(rng: Rng) -> Scene:
    """A car on the left lane cuts in close ahead."""
    speed = float(rng.uniform(8, 11))
    cutter = TrafficSpec(
        'forward',
        s_m=float(rng.uniform(16, 24)),
        speed_mps=speed,
        lane=0,
        target_speed_mps=speed * float(rng.uniform(0.6, 0.8)),
        scripts=(Script(ego_at_s_m=float(rng.uniform(50, 80)), drift_m=-3.5, drift_over_m=18.0),),
    )
    others = tuple(TrafficSpec('forward', float(s), speed, lane=int(rng.integers(0, 2))) for s in (70, 95, 120))
    layout = RoadLayout((Straight(260),), 3, 0, 14.0)
    return Scene(layout, RouteSpec(lane=1, start_speed_mps=speed * 0.9), (cutter, *others))


@scenario('SequentialLaneChange', 'Merging')
def sequential_lane_change(rng: Rng) -> Scene:
    """The route asks for two lane changes through moving traffic."""
    speed = float(rng.uniform(6, 9))
    start = int(rng.choice((0, 2)))
    changes = (
        LaneChange(float(rng.uniform(60, 75)), 1),
        LaneChange(float(rng.uniform(130, 150)), 2 - start),
    )
    traffic = tuple(
        TrafficSpec('forward', s, speed, lane=int(rng.integers(0, 3))) for s in stream(rng, 7, 200, (18, 30)) if s > 30
    )
    layout = RoadLayout((Straight(270),), 3, 0, 11.0)
    return Scene(layout, RouteSpec(start, changes, start_speed_mps=6.0), traffic)


@scenario('MergerIntoSlowTrafficV2', 'Merging')
def merge_from_ramp_into_dense_traffic(rng: Rng) -> Scene:
    """The ego comes up a ramp beside a three-lane road whose right lane crawls."""
    speed = float(rng.uniform(4, 6))
    layout = RoadLayout((Straight(130), Straight(120, ramp=True), Straight(110)), 3, 0, 13.0)
    slow = tuple(TrafficSpec('forward', s, speed, lane=2) for s in stream(rng, 7, 190, (17, 28)) if s > 0)
    fast = tuple(TrafficSpec('forward', float(s), speed * 1.6, lane=1) for s in (40, 95, 150))
    return Scene(layout, RouteSpec(from_ramp=True, start_speed_mps=6.0), (*slow, *fast))


@scenario('HighwayExit', 'Merging')
def highway_exit(rng: Rng) -> Scene:
    """The ego leaves the left lane, crosses the traffic of the right one and takes an exit."""
    speed = float(rng.uniform(7, 10))
    layout = RoadLayout((Straight(120), Straight(100, exit=True), Straight(70)), 2, 0, 13.0)
    changes = (LaneChange(float(rng.uniform(45, 65)), 1, 30), LaneChange(155.0, 2, 30))
    stations = [s for s in stream(rng, 6, 110, (20, 34)) if s > 12 or s < -12]
    traffic = tuple(TrafficSpec('forward', s, speed, lane=1) for s in stations if s > 0)
    return Scene(layout, RouteSpec(0, changes, to_exit=True, start_speed_mps=speed * 0.8), traffic)


@scenario('ParkingExit', 'Merging')
def parking_exit(rng: Rng) -> Scene:
    """The ego leaves a parking bay between parked cars and joins the lane beside it."""
    bay = (LANE_WIDTH_M / 2 + 1.3) / LANE_WIDTH_M
    start = 30.0
    # Spots of the row lie on the bay's line: the route has left it further on, hence the offset there.
    before = tuple(StandingSpec('parked', s, 0.0) for s in (start - 17.0, start - 8.0))
    after = tuple(StandingSpec('parked', start + s, -bay * LANE_WIDTH_M) for s in (26.0, 33.0))
    speed = float(rng.uniform(5, 8))
    traffic = tuple(TrafficSpec('forward', s, speed) for s in stream(rng, 4, 16, (18, 32)) if s > 0)
    later = tuple(TrafficSpec('forward', float(s), speed) for s in (70.0, 95.0))
    layout = RoadLayout((Straight(170),), 1, 1, float(rng.uniform(8, 10)), shoulder_m=3.2)
    route = RouteSpec(bay, (LaneChange(start + 3.0, 0, 15.0),), start_s_m=start)
    return Scene(layout, route, (*before, *after, *traffic, *later))
