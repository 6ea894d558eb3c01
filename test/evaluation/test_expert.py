"""The honest expert: it uses what was seen and nothing else, says why, and drives well."""

import math

import numpy as np
import pytest

from raw2drive_ros.evaluation.drivers import make_driver
from raw2drive_ros.evaluation.episode import drive_route
from raw2drive_ros.evaluation.expert import Expert, SteeringPush
from raw2drive_ros.evaluation.expert_belief import MEMORY_S, Belief
from raw2drive_ros.evaluation.expert_map import LaneMap, RouteFrame
from raw2drive_ros.evaluation.expert_prediction import forecast, hypotheses
from raw2drive_ros.evaluation.expert_rules import right_of_way
from raw2drive_ros.simulation.actors import PathVehicle
from raw2drive_ros.simulation.draws import Draw
from raw2drive_ros.simulation.environment import DrivingEnv, SimulationConfig
from raw2drive_ros.simulation.lanes import ArcLane
from raw2drive_ros.simulation.route_id import RouteId
from raw2drive_ros.simulation.scenario import get_scenario
from raw2drive_ros.simulation.world import World
from raw2drive_ros.tables.rates import SUBSTEPS

FAST = SimulationConfig(cameras=False, bev=False, end_on_infraction=False)


class Everything:
    """Sees all actors but those of some kinds."""

    def __init__(self, *hidden: str) -> None:
        self.hidden = hidden

    def seconds_since_seen(self, actor) -> float:
        return math.inf if actor.kind in self.hidden else 0.0

    def light_seen_s(self, index: int) -> float:
        return math.inf if 'light' in self.hidden else 0.0

    def sign_seen_s(self, index: int) -> float:
        return math.inf if 'sign' in self.hidden else 0.0


def world_of(kind: str, seed: int = 0) -> World:
    return World(get_scenario(kind), Draw(kind, seed))


def advance(world: World, expert: Expert, sight, ticks: int) -> list[str]:
    reasons = []
    for _ in range(ticks):
        control, why = expert.control(world, sight)
        reasons.append(why)
        for _ in range(SUBSTEPS):
            world.step(control)
    return reasons


def without_future(world: World) -> World:
    """A copy of the world whose actors look the same and want something else."""
    fork = world.fork()
    for actor in fork.actors:
        if isinstance(actor, PathVehicle):
            actor.scripts, actor.steered, actor.target_speed = [], None, 33.0
            actor.path, actor.s_m, actor.ignores_traffic = fork.route, 0.0, True
    fork.pending, fork.waiting = [], []
    return fork


@pytest.mark.parametrize('kind', ['HighwayCutIn', 'NonSignalizedJunctionLeftTurn', 'AccidentTwoWays', 'ParkingCutIn'])
def test_what_others_want_does_not_change_what_it_does(kind) -> None:
    world, expert = world_of(kind), Expert()
    for _ in range(8):
        advance(world, expert, Everything(), 7)
        blind_to_plans, same = Expert(), Expert()
        assert blind_to_plans.control(without_future(world), Everything()) == same.control(world.fork(), Everything())


def test_who_was_never_seen_does_not_exist() -> None:
    world, expert, hidden = world_of('ParkedObstacle'), Expert(), Everything('car', 'parked', 'parked_van')
    advance(world, expert, hidden, 70)
    assert world.actors and not expert.belief.tracks
    assert expert.control(world.fork(), hidden)[1] == 'free road'
    assert Expert().control(world, Everything())[1] != 'free road'


def test_what_was_seen_is_remembered_for_two_seconds() -> None:
    world, belief = world_of('HardBreakRoute'), Belief()
    belief.update(world, Everything())
    (track,) = belief.tracks.values()
    x, speed = track.x, track.speed
    while world.time_s < MEMORY_S - 0.05:
        for _ in range(SUBSTEPS):
            world.step(world.ego.command)
        belief.update(world, Everything('car'))
    assert belief.tracks and track.x == pytest.approx(x + speed * world.time_s, abs=0.2), 'it goes on as it was'
    for _ in range(2 * SUBSTEPS):
        world.step(world.ego.command)
    belief.update(world, Everything('car'))
    assert not belief.tracks


def test_a_light_that_was_not_seen_does_not_stop_it_and_one_that_is_red_does() -> None:
    for sight, stands in ((Everything(), True), (Everything('light'), False)):
        world, expert = world_of('VanillaSignalizedTurnEncounterRedLight'), Expert()
        world.actors.clear()
        world.refresh()
        reasons = advance(world, expert, sight, 110)
        assert ('red light' in reasons) == stands
        assert (world.ego.speed < 0.3) == stands


@pytest.mark.parametrize(
    ('kind', 'why'),
    [
        ('VanillaNonSignalizedTurnEncounterStopsign', 'stop sign'),
        ('HardBreakRoute', 'follow car'),
        ('ParkedObstacle', 'parked'),
        ('NonSignalizedJunctionLeftTurn', 'car'),
        ('PedestrianCrossing', 'walker'),
    ],
)
def test_it_says_why(kind, why) -> None:
    reasons: list[str] = []
    drive = drive_route(
        DrivingEnv(FAST), make_driver('expert'), RouteId(kind, 0), lambda _, d: reasons.append(d.info['reason'])
    )
    assert drive.result.success, drive.result
    assert any(why in reason for reason in reasons)
    assert all(reason and reason.isprintable() and len(reason) < 200 for reason in reasons)


def test_two_drives_are_the_same_to_the_last_bit() -> None:
    route = RouteId('SequentialLaneChange', 1)
    first, second = (drive_route(DrivingEnv(FAST), make_driver('expert'), route, max_ticks=150) for _ in range(2))
    assert first.controls == second.controls


def test_it_waits_well_short_of_a_wreck_for_oncoming_cars() -> None:
    """Otherwise it could not steer out."""
    world, expert = world_of('ParkedObstacleTwoWays', 2), Expert()
    wreck = next(a for a in world.actors if a.kind.startswith('parked'))
    rear = world.route.project(*map(float, wreck.position))[0] - wreck.LENGTH / 2
    closest = math.inf
    while world.route_s_m < rear + 20.0 and world.time_s < 60.0:
        advance(world, expert, Everything(), 1)
        if world.ego.speed < 0.2 and world.front_s_m < rear:
            closest = min(closest, rear - world.front_s_m)
    assert world.route_s_m > rear + 20.0
    assert closest > 6.0


def test_it_finds_out_what_pushes_the_steering() -> None:
    world, push = world_of('VanillaNonSignalizedTurn'), SteeringPush()
    for tick in range(30):
        world.ego.command = type(world.ego.command)(0.2, 0.0, 0.1 * math.sin(tick))
        world.ego.steer_push = 0.25 if tick >= 10 else 0.0
        for _ in range(SUBSTEPS):
            world.ego.step(0.05)
        found = push.estimate(world)
        assert found == pytest.approx(0.25 if tick >= 10 else 0.0, abs=1e-6)


def test_it_is_brisk_on_a_free_road() -> None:
    drive = drive_route(DrivingEnv(FAST), make_driver('expert'), RouteId('VanillaSignalizedTurnEncounterGreenLight', 0))
    world = world_of('VanillaSignalizedTurnEncounterGreenLight')
    distance = world.goal_s_m - 10.0 - world.scene.route.start_s_m
    assert drive.result.success
    at_limits = float(np.sum(0.5 / world.speed_limits[: int(2 * (distance + 6.0))]))
    assert drive.result.duration_s < 1.25 * at_limits


@pytest.mark.parametrize('curvature', [0.05, 0.0, -0.05])
def test_a_place_on_a_lane_is_found_again_whichever_way_it_bends(curvature) -> None:
    lane = ArcLane((3.0, 4.0), 0.7, 25.0, curvature, 3.5, 10.0)
    for place in ((2.0, 1.0), (20.0, -1.5)):
        assert lane.local_coordinates(lane.pose(*place)[:2]) == pytest.approx(place)


def test_cars_follow_their_lanes_as_their_indicators_say() -> None:
    world, belief = world_of('NonSignalizedJunctionLeftTurn'), Belief()
    belief.update(world, Everything())
    lanes, frame = LaneMap(world), RouteFrame(world.route, world.route_s_m, 60.0, 140.0)
    rules = right_of_way(world, lanes, belief, world.front_s_m)
    nearest = min(belief.tracks.values(), key=lambda t: abs(t.x - 85.0))
    goes = {}
    for indicator in ('', 'left', 'right'):
        nearest.indicator = indicator
        view = forecast(hypotheses(belief, lanes, rules, 12.0, (60.0, 0.0)), frame, 0.4 * np.arange(40))
        row = next(i for i, h in enumerate(view.hypotheses) if h.track is nearest)
        goes[indicator] = math.remainder(float(view.yaw[row, -1]) - nearest.yaw, 2.0 * math.pi)
    assert goes[''] == pytest.approx(0.0, abs=0.1)
    assert goes['left'] == pytest.approx(math.pi / 2, abs=0.2)
    assert goes['right'] == pytest.approx(-math.pi / 2, abs=0.2)
