"""Continuous commands through the policy's 39 actions: what is asked for is what happens, on average."""

import pytest

from raw2drive_ros.actions import ACTIONS, BRAKE_ACTION
from raw2drive_ros.contract import Control
from raw2drive_ros.evaluation.drivers import make_driver
from raw2drive_ros.evaluation.episode import drive_route
from raw2drive_ros.evaluation.table_actions import TableActions
from raw2drive_ros.simulation.environment import DrivingEnv, SimulationConfig
from raw2drive_ros.simulation.route_id import RouteId

FAST = SimulationConfig(cameras=False, bev=False, end_on_infraction=False)


@pytest.mark.parametrize(
    'wanted', [Control(0.0, 0.35), Control(0.45), Control(0.15, 0.0, 0.15), Control(0.0, 0.2, 0.4)]
)
def test_a_second_of_table_actions_gives_what_was_asked_for(wanted) -> None:
    env = DrivingEnv(FAST)
    env.reset(seed=0, options={'scenario': 'VanillaNonSignalizedTurn'})
    table = TableActions(make_driver('rule'))
    table.reset(0)
    env.world.ego.speed = 6.0
    chosen = [ACTIONS[table.choose(env.world, wanted)] for _ in range(40)]
    pedal = sum(c.throttle * 5.0 - c.brake * 8.0 for c in chosen) / 40
    assert pedal == pytest.approx(wanted.throttle * 5.0 - wanted.brake * 8.0, abs=0.45)
    assert sum(c.steer for c in chosen) / 40 == pytest.approx(wanted.steer, abs=0.06)
    assert not any(c.reverse for c in chosen)


def test_standing_still_is_one_action() -> None:
    env = DrivingEnv(FAST)
    env.reset(seed=0, options={'scenario': 'VanillaNonSignalizedTurn'})
    env.world.ego.speed = 0.0
    table = TableActions(make_driver('rule'))
    table.reset(0)
    assert {table.choose(env.world, Control(0.0, 0.3)) for _ in range(5)} == {BRAKE_ACTION}


def test_the_rule_driver_still_stops_turns_and_arrives() -> None:
    for kind in ('VanillaNonSignalizedTurnEncounterStopsign', 'JunctionTurns'):
        drive = drive_route(DrivingEnv(FAST), TableActions(make_driver('rule')), RouteId(kind, 0))
        assert drive.result.success, drive.result
        assert set(drive.controls) <= set(ACTIONS)
