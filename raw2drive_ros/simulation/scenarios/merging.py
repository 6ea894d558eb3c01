"""Merging: the ego joins or crosses a stream of traffic."""

from __future__ import annotations

from raw2drive_ros.simulation.actors import Script
from raw2drive_ros.simulation.layout import Junction, RoadLayout, Straight
from raw2drive_ros.simulation.scenario import (
    LaneChange,
    Rng,
    RouteSpec,
    Scene,
    TrafficSpec,
    scenario,
)


def _stream(rng: Rng, count: int, first_m: float, gap_m: tuple[float, float]) -> list[float]:
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
    traffic = tuple(TrafficSpec('forward', s, speed, lane=1) for s in _stream(rng, 7, 150, (18, 34)) if s > 0)
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
        TrafficSpec('forward', s, speed, lane=int(rng.integers(0, 3))) for s in _stream(rng, 7, 200, (18, 30)) if s > 30
    )
    layout = RoadLayout((Straight(270),), 3, 0, 11.0)
    return Scene(layout, RouteSpec(start, changes, start_speed_mps=6.0), traffic)


@scenario('NonSignalizedJunctionLeftTurn', 'Merging', 'TrafficSign')
def unprotected_left_turn(rng: Rng) -> Scene:
    """Turn left across oncoming traffic."""
    speed = float(rng.uniform(5, 8))
    oncoming = tuple(TrafficSpec(('ahead', 'back'), s, speed) for s in _stream(rng, 5, 40, (14, 26)) if s > 0)
    layout = RoadLayout((Straight(50), Junction('left'), Straight(70)), 1, 1, 9.0)
    return Scene(layout, RouteSpec(start_speed_mps=4.0), oncoming)


@scenario('NonSignalizedJunctionRightTurn', 'Merging', 'TrafficSign')
def unprotected_right_turn(rng: Rng) -> Scene:
    """Turn right into traffic that comes from the left."""
    speed = float(rng.uniform(5, 8))
    crossing = tuple(TrafficSpec(('left', 'right'), s, speed) for s in _stream(rng, 5, 50, (14, 26)) if s > 0)
    layout = RoadLayout((Straight(50), Junction('right'), Straight(80)), 1, 1, 9.0)
    return Scene(layout, RouteSpec(start_speed_mps=4.0), crossing)
