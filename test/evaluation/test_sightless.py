"""Sightless drivers: they drive what they are told, see nothing, and quick drives have the verdict of real ones."""

import json
import math

import numpy as np
import paired_types
import pytest
from paired_types import EMPTY, WALKER

from raw2drive_ros.contracts.errors import ConfigError
from raw2drive_ros.evaluation import cheats
from raw2drive_ros.evaluation.cheats import (
    FAMILIES,
    SIGHTLESS,
    Choice,
    Tuned,
    decider,
    load_tuned,
    save_tuned,
    sightless_driver,
)
from raw2drive_ros.evaluation.drivers import DRIVERS, make_driver
from raw2drive_ros.evaluation.episode import drive_route
from raw2drive_ros.evaluation.memoriser import MemoryDriver, Recorded, Replay, nearest, stands_of
from raw2drive_ros.evaluation.quick_drive import quick_drive, sensorless_env
from raw2drive_ros.evaluation.reference import ReferenceRunner, References
from raw2drive_ros.evaluation.sightless import Profile, ProfileDriver, Stop, least_s, turns_m
from raw2drive_ros.simulation.draws import Draw
from raw2drive_ros.simulation.route_id import RouteId
from raw2drive_ros.simulation.scenario import get_scenario
from raw2drive_ros.simulation.world import World
from raw2drive_ros.tables.rates import SUBSTEPS


@pytest.fixture(autouse=True)
def _paired(monkeypatch) -> None:
    paired_types.register(monkeypatch)


def world_of(kind, seed=0, *, twin=False) -> World:
    return World(get_scenario(kind), Draw(kind, seed, event=not twin))


def trace(world, control, seconds) -> np.ndarray:
    """(N, 4): time, arc length, lateral offset, speed; a decision apart."""
    rows = []
    for _ in range(int(seconds * 10)):
        command = control(world)
        for _ in range(SUBSTEPS):
            world.step(command)
        rows.append((world.time_s, world.route_s_m, world.route_lateral_m, world.ego.speed))
    return np.array(rows)


def test_a_profile_waits_stops_and_slows_down_where_it_says() -> None:
    profile = Profile(8.0, wait_s=3.0, stops=(Stop(0.5, 4.0),), slow=(0.6, 0.8, 2.0))
    world = world_of(EMPTY)
    goal, start = world.goal_s_m, world.scene.route.start_s_m
    driven = trace(world, ProfileDriver(profile).control, 40.0)
    assert driven[driven[:, 0] < 3.0, 3].max() == 0.0
    standing = driven[(driven[:, 3] < 0.2) & (driven[:, 0] > 5.0) & (driven[:, 1] < goal - 20)]
    place = start + 0.5 * (goal - start)
    assert np.abs(standing[:, 1] - place).max() < 2.5
    assert 3.8 < standing[-1, 0] - standing[0, 0] < 6.0
    slow = driven[(driven[:, 1] > start + 0.68 * (goal - start)) & (driven[:, 1] < start + 0.78 * (goal - start))]
    assert slow[:, 3].max() < 3.0
    assert driven[:, 3].max() > 6.0


def test_a_profile_takes_no_less_than_its_least_time() -> None:
    for profile in (Profile(), Profile(3.0), Profile(share=1.3, wait_s=6.0), Profile(stops=(Stop(0.3, 5.0),))):
        verdict = quick_drive(sensorless_env(), decider(profile, ()), RouteId(EMPTY, 0), math.inf)
        assert verdict.success
        assert least_s(profile, world_of(EMPTY)) <= verdict.seconds


def test_straddlers_drive_beside_the_route() -> None:
    for name, side in (('straddle_left', 2.15), ('straddle_right', -2.15)):
        way = next(FAMILIES[name].ways())
        driven = trace(world_of(EMPTY), decider(way, ()), 12.0)
        assert abs(driven[60:100, 2].mean() - side) < 0.1


def test_blind_stops_before_turns() -> None:
    world = world_of('JunctionTurns', 1)
    turns = turns_m(world.route, world.route_s_m, world.goal_s_m)
    assert turns
    assert turns_m(world_of(EMPTY).route, 0.0, 100.0) == []
    driven = trace(world, ProfileDriver(Profile(turn_stop_s=3.0)).control, 25.0)
    standing = driven[(driven[:, 3] < 0.2) & (driven[:, 0] > 3.0)]
    assert np.abs(turns[0] - standing[0, 1] - 8.0) < 2.5


@pytest.mark.parametrize('name', sorted(set(FAMILIES) - {'creep', 'memoriser'}))
def test_the_blind_do_not_see_the_walker(name) -> None:
    """Their commands are those of a world without actors, step by step."""
    way = list(FAMILIES[name].ways())[1]
    seen, empty = world_of(WALKER), world_of(WALKER)
    empty.actors.clear()
    empty.refresh()
    assert np.array_equal(trace(seen, decider(way, ()), 15.0), trace(empty, decider(way, ()), 15.0))


def test_creep_feels_seven_metres_ahead_and_no_further() -> None:
    from raw2drive_ros.simulation.actors import StandingObject

    way = Profile(3.0, sensor=True)
    commands = {}
    for ahead in (6.0, 12.0):
        world = world_of(EMPTY)
        trace(world, decider(way, ()), 5.0)
        x, y, yaw = world.route.pose(world.front_s_m + ahead)
        world.actors.append(StandingObject(x, y, yaw, 'barrier'))
        world.refresh()
        commands[ahead] = decider(way, ())(world)
    assert commands[6.0].brake > commands[12.0].brake == 0.0
    assert quick_drive(sensorless_env(), decider(way, ()), RouteId(WALKER, 0), math.inf).success
    blind = quick_drive(sensorless_env(), decider(Profile(3.0), ()), RouteId(WALKER, 0), math.inf)
    assert blind.cause == 'collision_pedestrian'


@pytest.mark.parametrize(
    ('kind', 'way'),
    [
        ('Accident', Profile(3.0)),
        ('T_Junction', Profile(wait_s=10.0)),
        ('EnterActorFlow', Profile(4.0, sensor=True)),
        ('HardBreakRoute', Profile(2.0)),
        (WALKER, Profile(6.0, sensor=True)),
        (EMPTY, Profile(offset_m=2.15)),
    ],
)
def test_a_quick_drive_has_the_verdict_of_a_real_one(kind, way) -> None:
    env = sensorless_env()
    quick = quick_drive(env, decider(way, ()), RouteId(kind, 0))
    name = 'creep' if way.sensor else 'profile'
    driver = sightless_driver(name, Tuned({name: {kind: Choice(name, way)}}))
    real = drive_route(env, driver, RouteId(kind, 0)).result
    assert quick.success == real.success
    assert quick.seconds <= real.duration_s
    if not quick.success:
        assert quick.cause in real.infractions


def test_a_quick_drive_ends_when_it_has_failed() -> None:
    env = sensorless_env()
    late = quick_drive(env, decider(Profile(1.0), ()), RouteId(EMPTY, 0), 10.0)
    assert (late.success, late.cause) == (False, 'timeout')
    assert 10.0 < late.seconds < 10.3


def recorded(kind, seed) -> list[Recorded]:
    runner = ReferenceRunner(References('rule', ''))
    return [runner.drive(RouteId(kind, seed, twin=twin)).memory for twin in (False, True)]


def test_a_memory_is_repeated_by_clock_and_by_place() -> None:
    memories = recorded(WALKER, 100_000)
    memory = memories[0]
    # The drive through the same scene: as if the seeds were different.
    same = Recorded(memory.type, 5, memory.twin, memory.parameters, memory.shape, memory.moments)
    for clock, most_m in ((True, 1.0), (False, 8.0)):
        driver = MemoryDriver([same], Replay(clock=clock))
        world = world_of(WALKER, 100_000)
        driven = trace(world, driver.control, float(memory.moments[-1, 0]))
        ways = np.interp(driven[:, 0], memory.moments[:, 0], memory.moments[:, 1])
        assert np.abs(driven[:, 1] - world.scene.route.start_s_m - ways).max() < most_m


def test_the_nearest_scene_of_another_seed_is_remembered() -> None:
    memories = recorded(WALKER, 100_000) + recorded(WALKER, 100_001)
    world = world_of(WALKER, 100_000)
    assert nearest(world, memories, Replay()).seed == 100_001
    assert nearest(world, memories, Replay(twin=True)).twin
    assert nearest(world_of(EMPTY), memories, Replay()) is None
    standing = MemoryDriver(memories, Replay())
    assert trace(world_of(EMPTY), standing.control, 3.0)[:, 3].max() == 0.0
    near, far = memories[0], memories[2]
    moved = Recorded(WALKER, 7, twin=False, parameters=near.parameters, shape=near.shape, moments=near.moments)
    assert nearest(world, [far, moved], Replay()) is moved


def test_stands_are_found_in_a_recorded_drive() -> None:
    rows = [
        (0.0, 0.0, 0.0, 0.0),
        (0.5, 1.0, 0.0, 4.0),
        (1.0, 3.0, 0.0, 0.1),
        (1.5, 3.1, 0.0, 0.0),
        (2.0, 5.0, 0.0, 3.0),
    ]
    assert stands_of(np.array(rows)) == [(3.0, 1.0)]


def test_choices_and_memories_survive_their_files(tmp_path) -> None:
    ways = {
        'profile': Profile(4.0, stops=(Stop(0.3, 2.0), Stop(0.5, 1.0)), slow=(0.1, 0.2, 3.0), offset_m=-1.0),
        'creep': Profile(5.0, wait_s=2.0, sensor=True),
        'memoriser': Replay(twin=True, clock=False),
    }
    choices = {name: {WALKER: Choice(name, way, 2, 5)} for name, way in ways.items()}
    choices['script'] = {WALKER: choices['memoriser'][WALKER]}
    memories = tuple(recorded(WALKER, 100_000))
    save_tuned(tmp_path, Tuned(choices, memories))
    read = load_tuned(tmp_path)
    assert read.choices == choices
    assert read.choice('script', WALKER).way == ways['memoriser']
    # What nobody has tuned drives the family's first way.
    assert read.choice('crawl', WALKER).way == next(FAMILIES['crawl'].ways())
    assert [(m.seed, m.twin, m.parameters) for m in read.memories] == [(m.seed, m.twin, m.parameters) for m in memories]
    assert np.abs(read.memories[0].moments - memories[0].moments).max() <= 0.051


@pytest.mark.parametrize(
    ('choices', 'reason'),
    [
        ({'wait': {'X': {'family': 'blind', 'way': {}, 'won': 0, 'of': 0}}}, 'family'),
        ({'wait': {'X': {'family': 'wait', 'way': {'pace': 1}, 'won': 0, 'of': 0}}}, 'pace'),
        ({'wait': {'X': {'family': 'wait', 'way': {'wait_s': 'x'}, 'won': 0, 'of': 0}}}, 'wait_s|convert'),
        ({'memoriser': {'X': {'family': 'memoriser', 'way': {'clock': 1}, 'won': 0, 'of': 0}}}, 'clock'),
        ({'wait': {'X': {'family': 'wait'}}}, 'way'),
        ({'wait': []}, 'not choices'),
        ([], 'not choices'),
    ],
)
def test_broken_choices_are_one_line(tmp_path, choices, reason) -> None:
    (tmp_path / 'choices.json').write_text(json.dumps(choices))
    (tmp_path / 'memories.json').write_text('{}')
    with pytest.raises(ConfigError, match=reason) as caught:
        load_tuned(tmp_path)
    assert '\n' not in str(caught.value)


def test_every_sightless_driver_is_in_the_registry(monkeypatch) -> None:
    monkeypatch.setattr(cheats, 'tuned_folder', lambda: cheats.Path('/nowhere'))
    cheats.shipped.cache_clear()
    for name in SIGHTLESS:
        assert DRIVERS[name].about.startswith('cheat: ')
        driver = make_driver(name)
        assert not driver.needs_cameras
        assert not driver.needs_bev
        drive = drive_route(sensorless_env(), driver, RouteId(EMPTY, 0), max_ticks=5)
        assert len(drive.controls) == 5
    cheats.shipped.cache_clear()
    assert {name for name, entry in DRIVERS.items() if entry.about.startswith('cheat: ')} == set(SIGHTLESS)
