"""Overtaking: something blocks the lane, and another lane leads past it."""

from __future__ import annotations

from raw2drive_ros.simulation.layout import RoadLayout, Straight
from raw2drive_ros.simulation.scenario import (
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
