"""Ability GiveWay: the ego has to leave room for other vehicles."""

from __future__ import annotations

from raw2drive_ros.simulation.actors import PathVehicle
from raw2drive_ros.simulation.draws import Rng
from raw2drive_ros.simulation.flows import arriving, group_times
from raw2drive_ros.simulation.layout import Curve, RoadLayout, Straight
from raw2drive_ros.simulation.scenario import LaneChange, RouteSpec, Scene, TrafficSpec, scenario
from raw2drive_ros.simulation.scripts import Script
from raw2drive_ros.simulation.world import World


@scenario('InvadingTurn', 'GiveWay')
def invading_turn(rng: Rng) -> Scene:
    """Oncoming cars drift over the centre line in a curve."""
    angle = float(rng.uniform(0.5, 0.9)) * float(rng.choice((-1, 1)))
    drift = -float(rng.uniform(1.65, 1.95))
    oncoming = tuple(
        TrafficSpec(
            'backward',
            float(s),
            speed_mps=float(rng.uniform(5, 7)),
            scripts=(Script(ego_within_m=45, drift_m=-drift, drift_over_m=15.0),),
            ignores_traffic=True,
        )
        for s in (10, 45)
    )
    layout = RoadLayout((Straight(60), Curve(50, angle), Straight(70)), 1, 1, 9.0, shoulder_m=1.5)
    return Scene(layout, RouteSpec(start_speed_mps=5.0), oncoming)


def emergency_vehicle_is_past(world: World) -> str | None:
    """Infraction `yield_emergency` where the drive ends with the emergency vehicle still behind the ego, else None."""
    if world.goal_s_m - world.route_s_m > 11.0:
        return None
    for actor in world.actors:
        if isinstance(actor, PathVehicle) and actor.kind == 'emergency':
            behind = world.route.project(float(actor.position[0]), float(actor.position[1]))[0]
            if behind < world.route_s_m:
                return 'yield_emergency'
    return None


@scenario('YieldToEmergencyVehicle', 'GiveWay', rule=emergency_vehicle_is_past)
def emergency_vehicle(rng: Rng) -> Scene:
    """An emergency vehicle approaches from behind in the ego's lane: the ego has to change lanes into traffic."""
    vehicle = TrafficSpec(
        'forward', s_m=0.5, speed_mps=0.0, lane=0, target_speed_mps=float(rng.uniform(13, 15)), kind='emergency'
    )
    layout = RoadLayout((Straight(260),), 2, 0, float(rng.uniform(8, 10)))
    times = group_times(rng, float(rng.uniform(2, 4)), float(rng.uniform(9, 13)), (1.7, 2.2), (5.0, 6.5))
    others = arriving(times, 'forward', 60.0, float(rng.uniform(6, 7.5)), lane=1, has_priority=False)
    detour = (LaneChange(float(rng.uniform(45, 65)), 1, 28),)
    return Scene(layout, RouteSpec(0, detour=detour, start_s_m=30.0, start_speed_mps=5.0), (vehicle, *others))
