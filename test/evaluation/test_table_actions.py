"""Continuous commands as the policy's 39 actions: the closest one, good enough to drive with; and advice."""

import pytest

from raw2drive_ros.cli.main import main
from raw2drive_ros.contracts.actions import ACTIONS, BRAKE_ACTION
from raw2drive_ros.contracts.public import Control
from raw2drive_ros.evaluation.driver_spec import DriverSpec
from raw2drive_ros.evaluation.drivers import make_driver
from raw2drive_ros.evaluation.episode import as_received, drive_route
from raw2drive_ros.evaluation.evaluate import evaluate
from raw2drive_ros.evaluation.table_actions import AdvisedDriver, TableActionDriver, table_action
from raw2drive_ros.simulation.environment import DrivingEnv, SimulationConfig
from raw2drive_ros.simulation.route_id import RouteId

FAST = SimulationConfig(cameras=False, bev=False, end_on_infraction=False)


@pytest.fixture
def env() -> DrivingEnv:
    env = DrivingEnv(FAST)
    env.reset(seed=0, options={'scenario': 'VanillaNonSignalizedTurn'})
    env.world.ego.speed = 6.0
    return env


@pytest.mark.parametrize(
    ('wanted', 'throttle', 'steer'),
    [
        (Control(0.8), 0.7, 0.0),
        (Control(0.4, 0.0, 0.12), 0.3, 0.1),
        (Control(0.25, 0.0, -0.62), 0.3, -0.7),
        (Control(0.0, 0.05, 0.3), 0.0, 0.3),
    ],
)
def test_the_nearest_rolling_action(env, wanted, throttle, steer) -> None:
    action = ACTIONS[table_action(env.world, wanted)]
    assert (action.throttle, action.brake, action.steer, action.reverse) == (throttle, 0.0, steer, False)


def test_only_real_braking_brakes(env) -> None:
    assert table_action(env.world, Control(0.0, 0.3)) == BRAKE_ACTION
    assert table_action(env.world, Control(0.0, 0.1)) != BRAKE_ACTION
    env.world.ego.speed = 0.0
    assert table_action(env.world, Control(0.0, 0.1)) == BRAKE_ACTION, 'standing is held by the brake'


@pytest.mark.parametrize('driver', ['rule', 'expert'])
def test_drivers_still_stop_turn_and_arrive(driver) -> None:
    for kind in ('VanillaNonSignalizedTurnEncounterStopsign', 'JunctionTurns'):
        drive = drive_route(DrivingEnv(FAST), TableActionDriver(make_driver(driver)), RouteId(kind, 0))
        assert drive.result.success, drive.result
        assert set(drive.controls) <= set(ACTIONS)


def test_bursts_of_noise_do_not_change_the_advice(env) -> None:
    table = TableActionDriver(make_driver('constant'), noise=0.5, advises=True)
    seeds = [seed for seed in range(10) if table.reset(seed) or table.chance]
    table.reset(seeds[0])
    tick, _ = env.reset_to(RouteId('VanillaNonSignalizedTurn', 0))
    burst = 0
    for _ in range(40):
        advice = table_action(env.world, make_driver('constant').make(0)(env.world))
        decision = table.control(env, as_received(_factory(), tick), tick)
        assert decision.info['advice'] == advice
        burst += decision.action != advice
        tick, *_ = env.step(decision.control)
    assert burst > 5


def test_an_adviser_does_not_change_what_the_driver_does() -> None:
    route = RouteId('VanillaNonSignalizedTurn', 3)
    alone = drive_route(DrivingEnv(FAST), make_driver('rule'), route, max_ticks=120)
    heard = []
    advised = AdvisedDriver(make_driver('rule'), make_driver('expert'))
    beside = drive_route(DrivingEnv(FAST), advised, route, lambda _, d: heard.append(d.info['advice']), max_ticks=120)
    assert alone.controls == beside.controls
    assert len(heard) == 120 and len(set(heard)) > 1


def test_an_adviser_may_be_asked_now_and_then() -> None:
    heard = []
    advised = AdvisedDriver(make_driver('rule'), make_driver('expert'), every=10)
    route = RouteId('VanillaNonSignalizedTurn', 3)
    drive_route(DrivingEnv(FAST), advised, route, lambda _, d: heard.append('advice' in d.info), max_ticks=20)
    assert heard == ([True] * 4 + [False] * 6) * 2
    with pytest.raises(ValueError, match='too often'):
        AdvisedDriver(make_driver('rule'), make_driver('expert'), every=3)


def _factory():
    from msg_adapters.factory import RosbagsFactory

    return RosbagsFactory()


def test_evaluation_through_the_table_is_known_by_its_name_and_solves_what_the_driver_does() -> None:
    spec = DriverSpec('expert', table=True)
    assert spec.identity() == 'expert table'
    result = evaluate(spec, 'x', '1', [RouteId('ParkedObstacle', 0)])
    assert [row['success'] for row in result['routes']] == [True]


@pytest.mark.parametrize('arguments', [('--driver', 'privileged'), ('--driver', 'rule', '--graph')])
def test_the_table_is_for_continuous_drivers_in_process(arguments, capsys) -> None:
    assert main(['evaluate', '--table', *arguments]) == 2
    assert '--table is for drivers of continuous commands' in capsys.readouterr().err
