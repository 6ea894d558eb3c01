"""Emergency brake: something appears or stops in front of the ego."""

from __future__ import annotations

from raw2drive_ros.simulation.actors import Script
from raw2drive_ros.simulation.layout import LANE_WIDTH_M, Curve, Junction, RoadLayout, Straight
from raw2drive_ros.simulation.scenario import (
    Rng,
    RouteSpec,
    Scene,
    StandingSpec,
    TrafficSpec,
    WalkerSpec,
    scenario,
)


@scenario('HardBreakRoute', 'EmergencyBrake')
def hard_brake(rng: Rng) -> Scene:
    """The leader brakes hard, stands, and drives on."""
    speed = float(rng.uniform(6, 10))
    trigger = float(rng.uniform(60, 90))
    leader = TrafficSpec(
        'forward',
        s_m=float(rng.uniform(22, 30)),
        speed_mps=speed,
        scripts=(
            Script(ego_at_s_m=trigger, acceleration_mps2=-float(rng.uniform(5, 8))),
            Script(time_s=float(rng.uniform(22, 28)), acceleration_mps2=2.0, until_speed_mps=-1.0),
        ),
    )
    layout = RoadLayout((Straight(120), Curve(80, float(rng.uniform(-0.5, 0.5))), Straight(80)), 1, 1, 10.0)
    return Scene(layout, RouteSpec(start_speed_mps=speed * 0.8), (leader,))


@scenario('DynamicObjectCrossing', 'EmergencyBrake')
def pedestrian_dart_out(rng: Rng) -> Scene:
    """A pedestrian walks out from behind a parked van."""
    where = float(rng.uniform(60, 100))
    side = -1.0
    van = StandingSpec('parked_van', where - 5.0, side * (LANE_WIDTH_M / 2 + 1.3))
    walker = WalkerSpec(where, side * 4.5, 18.0, float(rng.uniform(1.2, 2.2)), trigger_m=float(rng.uniform(18, 26)))
    layout = RoadLayout((Straight(150),), 1, 1, float(rng.uniform(8, 11)), shoulder_m=3.0)
    return Scene(layout, RouteSpec(start_speed_mps=5.0), (van, walker))


@scenario('ParkingCutIn', 'EmergencyBrake')
def parking_cut_in(rng: Rng) -> Scene:
    """A parked car pulls out right in front of the ego."""
    where = float(rng.uniform(60, 90))
    aside = -(LANE_WIDTH_M / 2 + 1.2)
    parked = tuple(StandingSpec('parked', where + gap, aside) for gap in (-16.0, -8.5, 20.0))
    puller = TrafficSpec(
        'forward',
        s_m=where,
        speed_mps=0.0,
        target_speed_mps=0.01,
        lateral_m=aside,
        scripts=(
            Script(ego_at_s_m=where - float(rng.uniform(20, 27)), target_speed_mps=float(rng.uniform(4, 6))),
            Script(ego_at_s_m=where - 27.0, drift_m=-aside, drift_over_m=10.0),
        ),
        heedless=True,
    )
    layout = RoadLayout((Straight(190),), 1, 1, float(rng.uniform(8, 11)), shoulder_m=3.0)
    return Scene(layout, RouteSpec(start_speed_mps=5.0), (*parked, puller))


@scenario('OppositeVehicleTakingPriority', 'EmergencyBrake', 'TrafficSign')
def priority_taken(rng: Rng) -> Scene:
    """A car from the side ignores the ego's right of way at a junction."""
    speed = float(rng.uniform(6, 9))
    source, target = (('left', 'right'), ('right', 'left'))[int(rng.integers(0, 2))]
    runner = TrafficSpec(
        (source, target),
        s_m=float(rng.uniform(10, 20)),
        speed_mps=0.0,
        target_speed_mps=0.01,
        scripts=(
            Script(
                ego_at_s_m=float(rng.uniform(28, 40)),
                target_speed_mps=speed,
                acceleration_mps2=4.0,
                until_speed_mps=-1.0,
            ),
        ),
        heedless=True,
    )
    layout = RoadLayout((Straight(70), Junction('ahead'), Straight(60)), 1, 1, 10.0)
    return Scene(layout, RouteSpec(start_speed_mps=4.0), (runner,))


@scenario('PedestrianCrossing', 'EmergencyBrake', 'TrafficSign')
def pedestrian_crossing(rng: Rng) -> Scene:
    """Pedestrians cross at a zebra crossing."""
    where = float(rng.uniform(60, 90))
    walkers = []
    for i in range(int(rng.integers(1, 4))):
        side = float(rng.choice((-1, 1)))
        start, goal = (-3.5, 20.0) if side < 0 else (7.5, -16.0)
        walkers.append(
            WalkerSpec(where + 0.9 * (i - 1), start, goal, float(rng.uniform(1.0, 1.6)), float(rng.uniform(22, 34)))
        )
    layout = RoadLayout((Straight(150),), 1, 1, float(rng.uniform(8, 11)), 2.0, zebras_m=(where,))
    return Scene(layout, RouteSpec(start_speed_mps=5.0), tuple(walkers))
