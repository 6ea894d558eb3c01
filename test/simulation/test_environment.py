import numpy as np
import pytest

from raw2drive_ros.contracts.actions import ACTIONS
from raw2drive_ros.contracts.errors import UnknownScenarioError
from raw2drive_ros.contracts.public import Control
from raw2drive_ros.evaluation.world_drivers import rule_driver
from raw2drive_ros.simulation.environment import DrivingEnv, SimulationConfig
from raw2drive_ros.simulation.scenario import load_scenarios

FAST = SimulationConfig(cameras=False, bev=False)
ABILITIES = ('Merging', 'Overtaking', 'EmergencyBrake', 'GiveWay', 'TrafficSign')


def drive(env: DrivingEnv, control: Control, ticks: int):
    tick = None
    for _ in range(ticks):
        tick, *_ = env.step(control)
    return tick


def test_same_seed_gives_the_same_episode_to_the_bit() -> None:
    episodes = []
    for _ in range(2):
        env = DrivingEnv(SimulationConfig(imu_noise=(0.05, 0.01)))
        tick, _ = env.reset(seed=11, options={'scenario': 'MergerIntoSlowTraffic'})
        found = []
        for action in (15, 15, 5, 12, 0, 26):
            tick, reward, *_ = env.step(ACTIONS[action])
            found.append(
                (tick.sensors.images['front'].tobytes(), tick.privileged.bev.tobytes(), reward, tick.imu_samples)
            )
        episodes.append(found)
    assert episodes[0] == episodes[1]


def test_another_seed_gives_another_episode() -> None:
    env = DrivingEnv(FAST)
    routes = []
    for seed in (1, 2):
        tick, _ = env.reset(seed=seed)
        routes.append(tick.route.checkpoints_m)
    assert routes[0].shape != routes[1].shape or not np.array_equal(*routes)


def test_positive_steer_turns_left() -> None:
    env = DrivingEnv(FAST)
    first, _ = env.reset(seed=0)
    last = drive(env, Control(0.5, 0.0, 0.3), 15)
    assert last.sensors.odometry.y_m > first.sensors.odometry.y_m + 0.2
    assert last.sensors.odometry.yaw_rad > first.sensors.odometry.yaw_rad
    assert last.sensors.imu.angular_velocity_radps[2] > 0
    assert last.sensors.imu.specific_force_mps2[1] > 0, 'centripetal force points to the left'


def test_braking_ends_at_standstill_and_does_not_reverse() -> None:
    env = DrivingEnv(FAST)
    env.reset(seed=0)
    drive(env, Control(0.7), 20)
    assert env.world.ego.speed > 4
    speeds = []
    for _ in range(40):
        env.step(Control(0.0, 1.0))
        speeds.append(env.world.ego.speed)
    assert speeds[-1] == 0.0
    assert min(speeds) >= 0.0


def test_reverse_drives_backwards() -> None:
    env = DrivingEnv(FAST)
    first, _ = env.reset(seed=0)
    last = drive(env, Control(0.5, 0.0, 0.0, reverse=True), 15)
    assert last.sensors.odometry.x_m < first.sensors.odometry.x_m
    assert last.sensors.odometry.speed_mps < 0


def test_imu_at_rest_reads_gravity_upwards() -> None:
    env = DrivingEnv(FAST)
    tick, _ = env.reset(seed=0)
    assert tick.sensors.imu.specific_force_mps2 == pytest.approx((0, 0, 9.81))


def test_imu_runs_at_20_hz_and_all_stamps_of_a_tick_agree() -> None:
    env = DrivingEnv(SimulationConfig())
    first, _ = env.reset(seed=0)
    tick, *_ = env.step(Control(0.3))
    stamps = [s.stamp_ns for s in tick.imu_samples]
    assert stamps == [first.stamp_ns + 50_000_000, first.stamp_ns + 100_000_000]
    assert tick.sensors.stamp_ns == tick.privileged.stamp_ns == tick.transition.stamp_ns == stamps[-1]


def test_reward_of_ideal_driving_is_one_plus_the_metres_driven() -> None:
    env = DrivingEnv(FAST)
    env.reset(seed=0)
    drive(env, Control(0.3), 5)
    env.world.ego.speed = 0.8 * env.world.speed_limit_at(env.world.route_s_m)
    env.world.ego.throttle = 0.15
    tick, reward, *_ = env.step(Control(0.15))
    terms = tick.transition.reward_terms
    assert reward == pytest.approx(sum(terms.values()))
    assert terms['speed'] > 0.93
    assert terms['travel'] == pytest.approx(env.world.ego.speed * 0.1, rel=0.1)
    assert terms['deviation'] == pytest.approx(0.0, abs=0.02)
    assert terms['steer'] == 0.0


def test_collision_ends_the_episode_with_minus_one_minus_speed() -> None:
    env = DrivingEnv(FAST)
    env.reset(seed=0, options={'scenario': 'ConstructionObstacle'})
    for _ in range(400):
        _, reward, terminated, _, info = env.step(Control(0.35))
        if terminated:
            break
    assert info['cause'].startswith('collision')
    assert reward == pytest.approx(-1.0 - env.world.contacts[0].ego_speed_mps)
    assert env.world.ego.speed < env.world.contacts[0].ego_speed_mps


def test_goal_is_a_truncation_with_reward_one() -> None:
    env = DrivingEnv(FAST)
    tick, _ = env.reset(seed=0)
    driver = rule_driver()
    driver.reset(0)
    while not env.done:
        tick, reward, terminated, truncated, info = env.step(driver.control(env, tick.sensors, tick).control)
    assert info['cause'] == 'route_end'
    assert reward == 1.0
    assert truncated and not terminated
    assert tick.transition.is_last and not tick.transition.is_terminal


def test_step_after_the_end_is_an_error() -> None:
    env = DrivingEnv(FAST)
    with pytest.raises(RuntimeError, match='call reset'):
        env.step(Control())


def test_unknown_scenario_lists_the_known_ones() -> None:
    with pytest.raises(UnknownScenarioError, match='LaneFollowing'):
        DrivingEnv(FAST).reset(options={'scenario': 'Nope'})


def test_each_ability_has_two_scenario_types() -> None:
    scenarios = load_scenarios().values()
    for ability in ABILITIES:
        assert sum(ability in s.abilities for s in scenarios) >= 2, ability


@pytest.mark.parametrize('name', sorted(load_scenarios()))
def test_scenario_runs_and_earns_reward(name: str) -> None:
    env = DrivingEnv(SimulationConfig(cameras=False, end_on_infraction=False))
    tick, _ = env.reset(seed=1, options={'scenario': name})
    driver = rule_driver()
    driver.reset(1)
    rewards = []
    while not env.done and len(rewards) < 300:
        tick, reward, *_ = env.step(driver.control(env, tick.sensors, tick).control)
        rewards.append(reward)
        tick.privileged.validate()
    driven_m = env.criteria.best_s_m - env.world.scene.route.start_s_m
    assert driven_m > 30.0
    # Waiting for a gap in fast traffic earns nothing or less; driving on afterwards more than makes up for it.
    assert np.mean(rewards) > 0.05


def test_running_a_red_light_is_an_infraction() -> None:
    env = DrivingEnv(SimulationConfig(cameras=False, bev=False, end_on_infraction=False))
    env.reset(seed=2, options={'scenario': 'VanillaSignalizedTurnEncounterRedLight'})
    while not env.done and 'red_light' not in env.criteria.events and env.world.time_s < 20:
        env.step(Control(0.35))
    assert env.criteria.events.get('red_light') == 1


def test_running_a_stop_sign_is_an_infraction_and_stopping_is_not() -> None:
    env = DrivingEnv(SimulationConfig(cameras=False, bev=False, end_on_infraction=False))
    env.reset(seed=2, options={'scenario': 'VanillaNonSignalizedTurnEncounterStopsign'})
    while not env.done and 'stop_sign' not in env.criteria.events and env.world.time_s < 20:
        env.step(Control(0.35))
    assert env.criteria.events.get('stop_sign') == 1
    tick, _ = env.reset(seed=2, options={'scenario': 'VanillaNonSignalizedTurnEncounterStopsign'})
    driver = rule_driver()
    driver.reset(0)
    while not env.done:
        tick, *_ = env.step(driver.control(env, tick.sensors, tick).control)
    assert env.criteria.events == {}


def test_a_coarse_fork_stays_near_the_fine_one() -> None:
    """Two physics steps in one go: what drivers that look ahead may trade for time."""
    env = DrivingEnv(SimulationConfig(cameras=False, bev=False))
    env.reset(seed=1, options={'scenario': 'SignalizedJunctionLeftTurn'})
    fine, coarse = env.world.fork(), env.world.fork(stride=2)
    for _ in range(40):
        for _ in range(2):
            fine.step(Control(0.4, 0.0, 0.05))
        coarse.step(Control(0.4, 0.0, 0.05))
    assert coarse.time_s == fine.time_s
    assert abs(coarse.ego.speed - fine.ego.speed) < 0.1
    assert float(np.abs(coarse.ego.position - fine.ego.position).max()) < 0.5
    # Traffic that is due between two steps of the coarse fork enters one step later there.
    places = [{actor.number: actor.position for actor in fork.actors} for fork in (fine, coarse)]
    both = places[0].keys() & places[1].keys()
    assert len(both) >= max(map(len, places)) - 1
    assert max(float(np.abs(places[0][number] - places[1][number]).max()) for number in both) < 1.0
    assert env.world.time_s == 0.0
