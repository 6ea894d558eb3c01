"""Overtaking: something blocks the lane, and another lane leads past it."""

from __future__ import annotations

from raw2drive_ros.simulation.layout import LANE_WIDTH_M, RoadLayout, Straight
from raw2drive_ros.simulation.scenario import (
    DoorSpec,
    LaneChange,
    Rng,
    RouteSpec,
    Scene,
    StandingSpec,
    TrafficSpec,
    scenario,
)


def _past(where_m: float, lane: int) -> tuple[LaneChange, ...]:
    """Route around an obstacle at `where_m`: out before it and back after it."""
    return (LaneChange(where_m - 42, lane - 1, 28), LaneChange(where_m + 16, lane, 28))


def _past_oncoming(where_m: float, length_m: float, lane: float = -1) -> tuple[LaneChange, ...]:
    """Route through the oncoming lane (or part of it) around something `length_m` long that ends at `where_m`."""
    return (LaneChange(where_m - length_m - 24, lane, 18), LaneChange(where_m + 6, 0, 18))


def _oncoming(rng: Rng, first_m: float, count: int) -> tuple[TrafficSpec, ...]:
    """Cars in the oncoming lane, the first `first_m` from the far end of the road, with one long gap among them."""
    speed = float(rng.uniform(5.5, 8.0))
    cars, s = [], first_m
    long_gap = int(rng.integers(1, count)) if count > 1 else 0
    for i in range(count):
        if s > 0:
            cars.append(TrafficSpec('backward', s, speed))
        s -= float(rng.uniform(95, 130)) if i + 1 == long_gap else float(rng.uniform(16, 30))
    return tuple(cars)


def _crash(rng: Rng, where_m: float, lateral_m: float) -> tuple[StandingSpec, ...]:
    """Two cars that have run into each other, and a police van behind them."""
    turned = float(rng.uniform(0.15, 0.35)) * float(rng.choice((-1, 1)))
    return (
        StandingSpec('parked_emergency', where_m - 13.5, lateral_m),
        StandingSpec('parked', where_m - 5.2, lateral_m, turned),
        StandingSpec('parked', where_m, lateral_m + 0.2, -turned),
    )


@scenario('ParkedObstacle', 'Overtaking')
def parked_obstacle(rng: Rng) -> Scene:
    """A broken-down car stands in the right lane; traffic flows in the left one."""
    where = float(rng.uniform(80, 110))
    speed = float(rng.uniform(6, 9))
    # The standing car is placed on the right lane: 3.5 m right of the route, which has moved left there.
    blocker = StandingSpec('parked', where, -3.5)
    traffic = tuple(
        TrafficSpec('forward', float(s), speed, lane=0)
        for s in (60 + rng.uniform(-6, 6), 95 + rng.uniform(-6, 6), 10 + rng.uniform(-4, 4))
    )
    layout = RoadLayout((Straight(220),), 2, 0, 11.0)
    return Scene(layout, RouteSpec(1, _past(where, 1), start_speed_mps=5.0), (blocker, *traffic))


@scenario('ConstructionObstacle', 'Overtaking')
def construction(rng: Rng) -> Scene:
    """Cones and a barrier close the right lane."""
    where = float(rng.uniform(80, 110))
    cones = tuple(StandingSpec('cone', where - 10 + 3 * i, -4.9 + 0.45 * i) for i in range(4))
    barrier = StandingSpec('barrier', where + 4, -3.5)
    layout = RoadLayout((Straight(220),), 2, 0, 11.0)
    return Scene(layout, RouteSpec(1, _past(where, 1), start_speed_mps=5.0), (*cones, barrier))


@scenario('HazardAtSideLane', 'Overtaking')
def slow_cyclists(rng: Rng) -> Scene:
    """Slow cyclists ride at the right edge of the right lane."""
    where = float(rng.uniform(70, 90))
    speed = float(rng.uniform(2.0, 3.5))
    riders = tuple(TrafficSpec('forward', where + gap, speed, lane=1, kind='cyclist') for gap in (0.0, 4.0))
    # Out early and back late: the riders move on while the ego passes.
    changes = (LaneChange(where - 35, 0, 25), LaneChange(where + 60, 1, 30))
    layout = RoadLayout((Straight(240),), 2, 0, 11.0)
    return Scene(layout, RouteSpec(1, changes, start_speed_mps=5.0), riders)


@scenario('Accident', 'Overtaking')
def accident(rng: Rng) -> Scene:
    """Two crashed cars and a police van block the right lane; traffic flows in the left one."""
    where = float(rng.uniform(90, 120))
    speed = float(rng.uniform(6, 9))
    traffic = tuple(TrafficSpec('forward', float(s + rng.uniform(-6, 6)), speed, lane=0) for s in (12, 55, 90))
    changes = (LaneChange(where - 55, 0, 28), LaneChange(where + 14, 1, 28))
    layout = RoadLayout((Straight(230),), 2, 0, 11.0)
    return Scene(layout, RouteSpec(1, changes, start_speed_mps=5.0), (*_crash(rng, where, -LANE_WIDTH_M), *traffic))


@scenario('AccidentTwoWays', 'Overtaking')
def accident_two_ways(rng: Rng) -> Scene:
    """Two crashed cars and a police van block the ego's only lane; the way past is the oncoming one."""
    where = float(rng.uniform(95, 115))
    layout = RoadLayout((Straight(230),), 1, 1, 10.0, shoulder_m=1.5)
    blockers = _crash(rng, where, -LANE_WIDTH_M)
    traffic = _oncoming(rng, float(rng.uniform(60, 110)), int(rng.integers(1, 4)))
    return Scene(layout, RouteSpec(0, _past_oncoming(where + 4, 22), start_speed_mps=5.0), (*blockers, *traffic))


@scenario('ParkedObstacleTwoWays', 'Overtaking')
def parked_obstacle_two_ways(rng: Rng) -> Scene:
    """A broken-down car stands in the ego's only lane; oncoming cars use the other."""
    where = float(rng.uniform(80, 110))
    layout = RoadLayout((Straight(220),), 1, 1, 10.0, shoulder_m=1.5)
    kind = str(rng.choice(('parked', 'parked_van')))
    blocker = StandingSpec(kind, where, -LANE_WIDTH_M)
    traffic = _oncoming(rng, float(rng.uniform(60, 110)), int(rng.integers(1, 4)))
    return Scene(layout, RouteSpec(0, _past_oncoming(where + 3, 6), start_speed_mps=5.0), (blocker, *traffic))


@scenario('ConstructionObstacleTwoWays', 'Overtaking')
def construction_two_ways(rng: Rng) -> Scene:
    """Cones and a barrier close the ego's only lane; oncoming cars use the other."""
    where = float(rng.uniform(85, 110))
    cones = tuple(StandingSpec('cone', where - 10 + 3 * i, -4.9 + 0.4 * i) for i in range(4))
    barrier = StandingSpec('barrier', where + 4, -LANE_WIDTH_M)
    layout = RoadLayout((Straight(220),), 1, 1, 10.0, shoulder_m=1.5)
    traffic = _oncoming(rng, float(rng.uniform(60, 110)), int(rng.integers(1, 4)))
    return Scene(layout, RouteSpec(0, _past_oncoming(where + 6, 17), start_speed_mps=5.0), (*cones, barrier, *traffic))


@scenario('HazardAtSideLaneTwoWays', 'Overtaking')
def slow_cyclists_two_ways(rng: Rng) -> Scene:
    """Slow cyclists at the edge of the ego's only lane; passing them takes most of the oncoming one."""
    where = float(rng.uniform(60, 75))
    speed = float(rng.uniform(1.8, 2.8))
    riders = tuple(
        TrafficSpec('forward', where + gap, speed, kind='cyclist', lateral_m=-1.0, heedless=True) for gap in (0.0, 4.0)
    )
    changes = (LaneChange(where - 20, -0.75, 18), LaneChange(where + 70, 0, 18))
    layout = RoadLayout((Straight(240),), 1, 1, 10.0, shoulder_m=1.0)
    traffic = _oncoming(rng, float(rng.uniform(60, 110)), int(rng.integers(1, 3)))
    return Scene(layout, RouteSpec(0, changes, start_speed_mps=5.0), (*riders, *traffic))


@scenario('VehicleOpensDoorTwoWays', 'Overtaking')
def opening_door(rng: Rng) -> Scene:
    """The door of a parked car opens into the ego's lane; the way past needs a part of the oncoming one."""
    where = float(rng.uniform(65, 95))
    shift = 0.5 * LANE_WIDTH_M
    beside = -(LANE_WIDTH_M / 2 + 0.95 + float(rng.uniform(0.0, 0.2)))
    parked = tuple(StandingSpec('parked', where + gap, beside - shift) for gap in (-7.0, 0.0, 7.5))
    door = DoorSpec(where + 0.5, beside + 0.95 - shift, float(rng.uniform(30, 40)))
    layout = RoadLayout((Straight(200),), 1, 1, float(rng.uniform(8, 10)), shoulder_m=3.0)
    traffic = _oncoming(rng, float(rng.uniform(50, 100)), int(rng.integers(1, 3)))
    route = RouteSpec(0, _past_oncoming(where + 10, 20, lane=-0.5), start_speed_mps=5.0)
    return Scene(layout, route, (*parked, door, *traffic))
