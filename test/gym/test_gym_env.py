"""The gymnasium environment: what gymnasium asks of one, determinism, and what it says of its episodes."""

import subprocess
import sys
import warnings

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from gymnasium.vector import AutoresetMode

import raw2drive_ros.gym
from raw2drive_ros.contracts.actions import ACTIONS
from raw2drive_ros.contracts.errors import RouteIdError, UnknownScenarioError, UnknownSuiteError
from raw2drive_ros.contracts.public import Control
from raw2drive_ros.evaluation.suites import load_suite
from raw2drive_ros.gym.observations import ACTOR_FIELDS, VECTOR_NAMES
from raw2drive_ros.simulation.draws import TRAIN_SEED_START
from raw2drive_ros.simulation.environment import DrivingEnv, SimulationConfig
from raw2drive_ros.simulation.route_id import RouteId
from raw2drive_ros.tables.bev_channels import STATIC_CHANNELS

SMALL = {'image_size': (32, 48)}
ID = raw2drive_ros.gym.ENV_ID
BRAKE, GO = 0, 14
AUTORESET = {'next_step': AutoresetMode.NEXT_STEP, 'same_step': AutoresetMode.SAME_STEP}


def make(**kwargs):
    return gymnasium.make(ID, **kwargs)


def same(one, other) -> bool:
    if isinstance(one, dict):
        return one.keys() == other.keys() and all(same(one[key], other[key]) for key in one)
    return one.dtype == other.dtype and np.array_equal(one, other)


@pytest.mark.parametrize('action', ['discrete', 'continuous'])
@pytest.mark.parametrize('observation', ['cameras', 'bev', 'bev_visible', 'vector'])
def test_gymnasiums_own_checker_finds_nothing(observation, action) -> None:
    env = make(suite='dev10', observation=observation, action=action, **SMALL)
    with warnings.catch_warnings():
        warnings.simplefilter('error')
        check_env(env.unwrapped)


def test_the_checker_would_find_a_wrong_observation(monkeypatch) -> None:
    env = make(observation='vector').unwrapped
    monkeypatch.setattr(env.observer, 'see', lambda driving, tick: np.zeros(3, np.float32))
    with pytest.raises(AssertionError):
        check_env(env)


@pytest.mark.parametrize('observation', ['cameras', 'vector'])
def test_the_same_seed_gives_the_same_episodes(observation) -> None:
    def run(seed: int):
        env, found = make(observation=observation, **SMALL), []
        for episode in range(2):
            seen, info = env.reset(seed=seed if episode == 0 else None)
            found.append((seen, info['route'], 0.0))
            for tick in range(5):
                seen, reward, *_ = env.step((3 * tick + 7) % 39)
                found.append((seen, info['route'], reward))
        return found

    one, again, other = run(5), run(5), run(6)
    assert all(same(a, b) and (r, x) == (s, y) for (a, r, x), (b, s, y) in zip(one, again, strict=True))
    assert len({route for _, route, _ in one}) == 2
    assert {route for _, route, _ in one}.isdisjoint({route for _, route, _ in other})


@pytest.mark.parametrize('mode', ['sync', 'async', 'vector_entry_point'])
def test_many_at_once(mode) -> None:
    envs = gymnasium.make_vec(ID, 2, vectorization_mode=mode, suite='dev10', observation='vector')
    try:
        seen, infos = envs.reset(seed=3)
        rows = [seen]
        for _ in range(3):
            seen, *_, infos = envs.step(np.array([GO, BRAKE]))
            rows.append(seen)
        assert 'reward_terms' in infos
    finally:
        envs.close()
    for i, action in enumerate((GO, BRAKE)):
        alone = make(suite='dev10', observation='vector')
        expected = [alone.reset(seed=3 + i)[0], *(alone.step(action)[0] for _ in range(3))]
        assert np.array_equal([row[i] for row in rows], expected)


@pytest.mark.parametrize('autoreset', ['next_step', 'same_step'])
def test_worlds_that_step_together_return_what_each_would_alone(autoreset) -> None:
    """Bit for bit, over the ends of episodes."""
    arguments = {'observation': 'vector', 'routes': 'all'}
    alone = gymnasium.make_vec(
        ID, 3, vectorization_mode='sync', vector_kwargs={'autoreset_mode': AUTORESET[autoreset]}, **arguments
    )
    batch = gymnasium.make_vec(ID, 3, autoreset_mode=AUTORESET[autoreset], **arguments)
    assert type(batch).__name__ == 'Raw2DriveVectorEnv'
    (expected, _), (seen, _) = alone.reset(seed=1), batch.reset(seed=1)
    assert np.array_equal(seen, expected)
    rng, ends = np.random.default_rng(0), 0
    for tick in range(150):
        if tick % 5 == 0:
            actions = rng.integers(5, 25, 3)
        expected, seen = alone.step(actions), batch.step(actions)
        for one, other in zip(expected[:4], seen[:4], strict=True):
            assert np.array_equal(one, other)
        assert expected[4].keys() == seen[4].keys()
        ends += int((seen[2] | seen[3]).sum())
    assert ends >= 3


def test_what_the_cameras_do_not_show_is_not_in_the_visible_masks() -> None:
    """Of the dynamic masks; the static ones are the same."""
    everything, seen = make(observation='bev'), make(observation='bev_visible')
    route = {'route': 'ParkingCrossingPedestrian/100002/FogNoon'}
    (one, _), (other, _) = everything.reset(options=route), seen.reset(options=route)
    static, hidden = len(STATIC_CHANNELS), 0
    for _ in range(40):
        assert np.array_equal(one['bev'][:static], other['bev'][:static])
        assert (other['bev'] <= one['bev']).all()
        hidden += int((other['bev'] < one['bev']).sum())
        one, other = everything.step(GO)[0], seen.step(GO)[0]
    assert hidden > 0 and other['bev'][static:].any()
    assert seen.unwrapped.driving.visibility is not None and everything.unwrapped.driving.visibility is None


def test_steps_are_those_of_the_simulation() -> None:
    """The same masks and rewards as `DrivingEnv`; continuous actions reach it as commands."""
    env = make(observation='bev', action='continuous')
    seen, info = env.reset(options={'route': 'Accident/100000/HardRainNight'})
    plain = DrivingEnv(SimulationConfig(cameras=False))
    tick, _ = plain.reset_to(RouteId('Accident', 100000, 'HardRainNight'))
    assert info['route'] == 'Accident/100000/HardRainNight'
    for pedal, steer in ((0.5, 0.1), (-0.25, -0.2), (1.0, 0.0)):
        assert np.array_equal(seen['bev'], tick.privileged.bev)
        seen, reward, *_ = env.step(np.array([pedal, steer], np.float32))
        tick, expected, *_ = plain.step(Control(max(pedal, 0.0), max(-pedal, 0.0), float(np.float32(steer))))
        assert reward == expected


def test_the_end_of_an_episode_carries_its_result() -> None:
    env = make(observation='vector', routes='lane-following')
    env.reset(options={'route': 'LaneFollowing/100000'})
    info, ended = {}, False
    while not ended:
        assert 'result' not in info
        *_, terminated, truncated, info = env.step(GO)
        ended = terminated or truncated
    assert info['result'].id == 'LaneFollowing/100000'
    assert info['success'] is info['result'].success is False
    assert info['cause']
    with pytest.raises(gymnasium.error.ResetNeeded):
        env.unwrapped.step(GO)


def test_routes_of_a_suite_have_its_time_limit(tmp_path) -> None:
    suite = tmp_path / 'quick.json'
    suite.write_text(
        '{"format": 3, "name": "quick", "version": "1", "drives": ["event"],'
        ' "routes": {"LaneFollowing": [{"seed": 7, "weather": "FogNoon", "limit_s": [0.5]}]}}'
    )
    env = make(suite=str(suite), observation='vector')
    _, info = env.reset()
    assert info['route'] == 'LaneFollowing/7/FogNoon'
    ticks, ended = 0, False
    while not ended:
        *_, terminated, truncated, info = env.step(BRAKE)
        ticks, ended = ticks + 1, terminated or truncated
    assert ticks <= 6 and truncated and not info['success']
    assert info['result'].limit_s == 0.5


def test_training_routes_are_training_routes_with_twins_among_them() -> None:
    source = make(observation='vector', routes='all', twins=0.5).unwrapped.source
    rng = np.random.default_rng(0)
    routes = [source.draw(rng).route for _ in range(400)]
    assert min(route.seed for route in routes) >= TRAIN_SEED_START
    assert len({route.seed for route in routes}) == len(routes)
    assert len({route.type for route in routes}) > 40 and len({route.weather for route in routes}) > 5
    suite = make(observation='vector', suite='dev10', weather='FogNoon').unwrapped.source
    drawn = {suite.draw(rng).route for _ in range(300)}
    assert {(r.type, r.seed) for r in drawn} == {(r.type, r.seed) for r in load_suite('dev10').routes}
    assert {route.weather for route in drawn} == {'FogNoon'}


def test_the_vector_names_what_it_holds() -> None:
    env = make(observation='vector')
    seen, _ = env.reset(options={'route': 'ParkedObstacle/100000'})
    values = dict(zip(VECTOR_NAMES, seen.tolist(), strict=True))
    world = env.unwrapped.driving.world
    x, y = world.ego.position
    gaps = [np.hypot(*(actor.position - (x, y))) for actor in world.actors]
    nearest = world.actors[int(np.argmin(gaps))]
    assert np.hypot(values['actor_0_x'], values['actor_0_y']) * 60.0 == pytest.approx(min(gaps), rel=1e-5)
    assert values['actor_0_length'] * 15.0 == pytest.approx(nearest.LENGTH, rel=1e-5)
    assert values['speed_mps'] * 30.0 == pytest.approx(world.ego.speed, rel=1e-5)
    assert values['route_5m_x'] * 60.0 == pytest.approx(5.0, abs=0.5)
    present = sum(values[f'actor_{i}_present'] for i in range(12))
    assert present == min(12, sum(gap < 60.0 for gap in gaps)) and len(ACTOR_FIELDS) == 12


def test_a_positive_steering_action_turns_left() -> None:
    env = make(observation='vector', action='continuous')
    env.reset(options={'route': 'LaneFollowing/100000'})
    before = env.unwrapped.driving.world.ego.heading
    for _ in range(8):
        env.step(np.array([0.3, 0.4]))
    assert env.unwrapped.driving.world.ego.heading > before + 0.02


def test_render_shows_cameras_and_masks() -> None:
    env = make(observation='vector', render_mode='rgb_array')
    env.reset(seed=1)
    first = env.render()
    assert first.shape == (288, 1008, 3) and first.dtype == np.uint8
    assert first[:, :720].std() > 20.0 and first[:, 720:].std() > 20.0
    for _ in range(10):
        env.step(GO)
    assert (env.render() != first).mean() > 0.05


@pytest.mark.parametrize(
    ('kwargs', 'error', 'said'),
    [
        ({'suite': 'b2d22'}, UnknownSuiteError, 'did you mean b2d220'),
        ({'routes': 'Acident'}, UnknownScenarioError, 'did you mean Accident'),
        ({'observation': 'lidar'}, gymnasium.error.Error, 'none of cameras, bev, bev_visible, vector'),
        ({'action': 'joystick'}, gymnasium.error.Error, 'none of discrete, continuous'),
        ({'twins': 1.5}, ValueError, 'a share'),
    ],
)
def test_wrong_arguments_are_named(kwargs, error, said) -> None:
    with pytest.raises(error, match=said):
        make(**kwargs)


@pytest.mark.parametrize(
    ('kind', 'action'),
    [('discrete', 39), ('discrete', -1), ('discrete', 0.5), ('continuous', [0.1]), ('continuous', [np.nan, 0.0])],
)
def test_wrong_actions_and_options_are_named(kind, action) -> None:
    env = make(observation='vector', action=kind).unwrapped
    with pytest.raises(gymnasium.error.ResetNeeded):
        env.step(0)
    env.reset(seed=0)
    with pytest.raises(gymnasium.error.InvalidAction, match='is not in'):
        env.step(action)
    for options in ({'rute': 'Accident/1'}, {'route': 'Accident'}):
        with pytest.raises(RouteIdError):
            env.reset(options=options)


def test_all_forms_of_valid_actions_are_taken() -> None:
    env = make(observation='vector').unwrapped
    assert [env.control_of(a) for a in (3, np.int64(3), np.array(3))] == [ACTIONS[3]] * 3
    env = make(observation='vector', action='continuous').unwrapped
    assert env.control_of([2.0, -3.0]) == Control(1.0, 0.0, -1.0)


def test_registering_loads_no_simulator_and_make_needs_no_import_of_ours() -> None:
    code = (
        'import sys, gymnasium, raw2drive_ros.gym\n'
        "assert not {'highway_env', 'torch'} & sys.modules.keys()\n"
        "env = gymnasium.make('raw2drive_ros.gym:Raw2Drive-v3', observation='vector')\n"
        "env.reset(seed=0); assert 'torch' not in sys.modules\n"
    )
    done = subprocess.run([sys.executable, '-c', code], capture_output=True, text=True, timeout=600)
    assert done.returncode == 0, done.stderr
