"""Ability EmergencyBrake: something appears or stops in front of the ego."""

from __future__ import annotations

from raw2drive_ros.simulation.draws import Draw, Rng
from raw2drive_ros.simulation.layout import LANE_WIDTH_M, Curve, Junction, RoadLayout, Straight, turn_length_m
from raw2drive_ros.simulation.scenario import (
    DisturbanceSpec,
    LightSpec,
    RouteSpec,
    Scene,
    StandingSpec,
    TrafficSpec,
    WalkerSpec,
    scenario,
)
from raw2drive_ros.simulation.scenarios.parts import approach, background, layout, parked_row, road_length_m
from raw2drive_ros.simulation.scripts import Pacing, Script


@scenario('HardBreakRoute', 'EmergencyBrake')
def hard_brake(rng: Rng) -> Scene:
    """The leading vehicle brakes hard, stops, and drives on."""
    speed = float(rng.uniform(6, 10))
    trigger = float(rng.uniform(60, 90))
    leader = TrafficSpec(
        'forward',
        s_m=float(rng.uniform(22, 30)),
        speed_mps=speed,
        scripts=(
            Script(ego_at_s_m=trigger, acceleration_mps2=-float(rng.uniform(6, 8)), lasts_s=float(rng.uniform(6, 10))),
        ),
        pacing=Pacing(float(rng.uniform(11, 15)), trigger),
    )
    layout = RoadLayout((Straight(120), Curve(80, float(rng.uniform(-0.5, 0.5))), Straight(80)), 1, 1, 10.0)
    return Scene(layout, RouteSpec(start_speed_mps=speed * 0.8), (leader,))


@scenario('DynamicObjectCrossing', 'EmergencyBrake')
def pedestrian_dart_out(draw: Draw) -> Scene:
    """A pedestrian walks out from behind a parked van."""
    where = draw.uniform('event_s_m', 110.0, 240.0, key=True)
    pieces = (*approach(draw, where - 50.0), Straight(190.0))
    road = layout(draw, pieces, (1, 1), (11.0, 14.0), (2.6, 3.2))
    where = road_length_m(pieces[:-1], road, 0) + 50.0
    beside = -(road.lane_width_m / 2 + road.shoulder_m - 1.35)
    van = StandingSpec('parked_van', where - draw.uniform('van_gap_m', 4.2, 5.4), beside)
    speed = draw.uniform('walker_mps', 1.6, 2.6, key=True)
    start = beside - draw.uniform('start_m', 1.6, 2.2)
    delay = draw.uniform('delay_s', 0.3, 0.45)
    walker = WalkerSpec(where, start, 20.0, speed, delay, happens=draw.event)
    row = parked_row(draw, 'row', where - 60.0, where + 60.0, beside, (where - 12.0, where + 8.0))
    route = RouteSpec(start_speed_mps=9.0)
    return Scene(
        road,
        route,
        (van, walker, *row),
        background=background(draw, parked=False),
        event_s_m=(where - 40.0, where + 8.0),
    )


@scenario('ParkingCutIn', 'EmergencyBrake')
def parking_cut_in(rng: Rng) -> Scene:
    """A parked car pulls out right in front of the ego."""
    where = float(rng.uniform(60, 90))
    aside = -(LANE_WIDTH_M / 2 + 1.2)
    parked = tuple(StandingSpec('parked', where + gap, aside) for gap in (-16.0, -8.5, 20.0))
    due = (where, float(rng.uniform(1.9, 2.4)))
    puller = TrafficSpec(
        'forward',
        s_m=where,
        speed_mps=0.0,
        target_speed_mps=0.01,
        lateral_m=aside,
        scripts=(
            Script(ego_due=due, target_speed_mps=float(rng.uniform(4, 6))),
            Script(ego_due=due, drift_m=-aside, drift_over_m=7.0),
        ),
        ignores_traffic=True,
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
                ego_at_s_m=float(rng.uniform(16, 28)),
                target_speed_mps=speed,
            ),
        ),
        ignores_traffic=True,
        meets_ego=True,
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
            WalkerSpec(where + 0.9 * (i - 1), start, goal, float(rng.uniform(1.0, 1.6)), float(rng.uniform(0.3, 1.2)))
        )
    layout = RoadLayout((Straight(150),), 1, 1, float(rng.uniform(8, 11)), 2.0, zebras_m=(where,))
    return Scene(layout, RouteSpec(start_speed_mps=5.0), tuple(walkers))


@scenario('ParkingCrossingPedestrian', 'EmergencyBrake')
def parking_crossing_pedestrian(rng: Rng) -> Scene:
    """A pedestrian steps out from between two parked cars."""
    where = float(rng.uniform(60, 95))
    aside = -(LANE_WIDTH_M / 2 + 1.2)
    row = tuple(StandingSpec('parked', where + gap, aside) for gap in (-17.5, -10.5, -3.4, 4.2, 11.5))
    walker = WalkerSpec(where, -4.2, 18.0, float(rng.uniform(1.2, 2.0)), float(rng.uniform(0.3, 0.9)))
    layout = RoadLayout((Straight(150),), 1, 1, float(rng.uniform(8, 11)), shoulder_m=3.0)
    return Scene(layout, RouteSpec(start_speed_mps=5.0), (*row, walker))


@scenario('StaticCutIn', 'EmergencyBrake')
def static_cut_in(rng: Rng) -> Scene:
    """The right lane is a queue of standing cars; one of them cuts into the ego's lane."""
    where = float(rng.uniform(60, 90))
    queue = tuple(StandingSpec('parked', where + gap, -LANE_WIDTH_M) for gap in (-22.0, -14.5, 14.0, 21.5, 29.0))
    due = (where, float(rng.uniform(1.9, 2.4)))
    cutter = TrafficSpec(
        'forward',
        s_m=where,
        speed_mps=0.0,
        lane=1,
        target_speed_mps=0.01,
        scripts=(
            Script(ego_due=due, target_speed_mps=float(rng.uniform(4, 6))),
            Script(ego_due=due, drift_m=LANE_WIDTH_M, drift_over_m=8.0),
        ),
        ignores_traffic=True,
    )
    layout = RoadLayout((Straight(200),), 2, 0, float(rng.uniform(8, 11)))
    return Scene(layout, RouteSpec(0, start_speed_mps=6.0), (*queue, cutter))


@scenario('BlockedIntersection', 'EmergencyBrake', 'TrafficSign')
def blocked_intersection(rng: Rng) -> Scene:
    """A car stands just after the turn, out of sight, and drives on after a while."""
    turn = str(rng.choice(('left', 'right')))
    straight = float(rng.uniform(45, 65))
    exit_m = straight + turn_length_m(turn)
    blocker = TrafficSpec(
        'forward',
        s_m=exit_m + float(rng.uniform(4, 9)),
        speed_mps=0.0,
        target_speed_mps=0.01,
        kind=str(rng.choice(('car', 'van'))),
        scripts=(Script(ego_at_s_m=straight - 12, delay_s=float(rng.uniform(6, 11)), target_speed_mps=8.0),),
    )
    layout = RoadLayout((Straight(straight), Junction(turn), Straight(70)), 1, 1, 9.0)
    return Scene(layout, RouteSpec(start_speed_mps=4.0), (blocker,))


@scenario('OppositeVehicleRunningRedLight', 'EmergencyBrake', 'TrafficSign')
def red_light_runner(rng: Rng) -> Scene:
    """The ego has green; a car from the side runs its red light."""
    straight = float(rng.uniform(60, 75))
    source, target = (('left', 'right'), ('right', 'left'))[int(rng.integers(0, 2))]
    runner = TrafficSpec(
        (source, target),
        s_m=float(rng.uniform(8, 18)),
        speed_mps=0.0,
        target_speed_mps=0.01,
        scripts=(
            Script(
                ego_at_s_m=straight - float(rng.uniform(42, 54)),
                target_speed_mps=float(rng.uniform(6, 9)),
            ),
        ),
        ignores_traffic=True,
        meets_ego=True,
    )
    layout = RoadLayout((Straight(straight), Junction('ahead', control='light'), Straight(60)), 1, 1, 10.0)
    return Scene(layout, RouteSpec(start_speed_mps=4.0), (runner,), (LightSpec(0, (('green', 120.0),)),))


def _after_turn(rng: Rng, kind: str, speed_mps: tuple[float, float]) -> Scene:
    turn = str(rng.choice(('left', 'right')))
    straight = float(rng.uniform(45, 60))
    where = straight + turn_length_m(turn) + float(rng.uniform(5, 9))
    side = float(rng.choice((-1, 1)))
    start, goal = (-4.5, 16.0) if side < 0 else (8.0, -14.0)
    crosser = WalkerSpec(where, start, goal, float(rng.uniform(*speed_mps)), float(rng.uniform(0.1, 0.5)), kind)
    layout = RoadLayout((Straight(straight), Junction(turn), Straight(60)), 1, 1, 9.0, shoulder_m=1.0)
    return Scene(layout, RouteSpec(start_speed_mps=4.0), (crosser,))


@scenario('VehicleTurningRoute', 'EmergencyBrake', 'TrafficSign')
def cyclist_after_turn(rng: Rng) -> Scene:
    """A cyclist crosses the road that the ego turns into."""
    return _after_turn(rng, 'cyclist', (2.5, 4.0))


@scenario('VehicleTurningRoutePedestrian', 'EmergencyBrake', 'TrafficSign')
def pedestrian_after_turn(rng: Rng) -> Scene:
    """A pedestrian crosses the road that the ego turns into."""
    return _after_turn(rng, 'walker', (1.1, 1.8))


@scenario('ControlLoss', 'EmergencyBrake')
def control_loss(rng: Rng) -> Scene:
    """Patches of bad road between cones: steering is pushed to and fro and the tyres lose grip."""
    first = float(rng.uniform(38, 48))
    patches, cones = [], []
    for i in range(3):
        start, length = first + 45.0 * i, float(rng.uniform(20, 26))
        push = float(rng.uniform(0.3, 0.4)) * float(rng.choice((-1, 1)))
        patches.append(DisturbanceSpec(start, length, push, float(rng.uniform(0.3, 0.6)), float(rng.uniform(1.1, 1.5))))
        cones += [StandingSpec('cone', start + 4.0 * j, side * 2.1) for j in range(7) for side in (-1, 1)]
    curve = Curve(float(rng.uniform(60, 90)), float(rng.uniform(-0.6, 0.6)))
    layout = RoadLayout((Straight(80), curve, Straight(90)), 1, 1, float(rng.uniform(8, 11)), shoulder_m=1.0)
    return Scene(layout, RouteSpec(start_speed_mps=5.0), tuple(cones), disturbances=tuple(patches))
