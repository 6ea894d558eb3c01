"""What the collector drives, and what ends its episodes."""

from collections import Counter

import paired_types
import pytest

from raw2drive_ros.cli.main import main
from raw2drive_ros.contracts.public import Control, Decision
from raw2drive_ros.evaluation.collect import CollectConfig, collect, episode_route
from raw2drive_ros.evaluation.world_drivers import WorldDriver
from raw2drive_ros.recording.bag_reader import find_bags, open_bag
from raw2drive_ros.recording.ticks import read_ticks
from raw2drive_ros.simulation.draws import TRAIN_SEED_START
from raw2drive_ros.simulation.route_id import RouteId
from raw2drive_ros.simulation.weather import WEATHER_NAMES

# As many as there are types, and a multiple of the number of weathers.
TYPES = tuple(f'Type{number}' for number in range(46))


def _episodes(folder, **options) -> list[int]:
    """Ticks of each episode of a driver that brakes for ever."""
    config = CollectConfig(('VanillaNonSignalizedTurn',), ticks=100, cameras=False, **options)
    for _ in collect(folder, config, WorldDriver(lambda seed: lambda world: Control(0.0, 1.0)), {'driver': 'none'}):
        pass
    lengths: list[int] = []
    for path in find_bags([folder]):
        with open_bag(path) as reader:
            for tick in read_ticks(reader, path, cameras=False):
                if tick.transition.is_first:
                    lengths.append(0)
                lengths[-1] += 1
                assert not tick.transition.is_terminal
    return lengths


def test_an_episode_is_cut_after_its_ticks(tmp_path) -> None:
    assert _episodes(tmp_path, episode_ticks=50) == [50, 50]


def test_an_episode_is_cut_when_the_car_stands(tmp_path) -> None:
    lengths = _episodes(tmp_path, episode_ticks=90, stand_ticks=20)
    assert len(lengths) > 2
    # It brakes to a stop first, from at most 10 m/s.
    assert all(20 <= length <= 40 for length in lengths)


def drawn(seed: int, episodes: int, types: tuple[str, ...] = TYPES) -> list[RouteId]:
    config = CollectConfig(types, ticks=0, seed=seed, weathers=WEATHER_NAMES)
    return [episode_route(config, number) for number in range(episodes)]


def test_every_type_and_every_weather_is_driven_equally_often() -> None:
    routes = drawn(0, 2 * len(TYPES))
    assert Counter(route.type for route in routes) == dict.fromkeys(TYPES, 2)
    assert Counter(route.weather for route in routes) == dict.fromkeys(WEATHER_NAMES, 4)
    thrice = drawn(0, 8, ('A', 'A', 'A', 'B'))
    assert Counter(route.type for route in thrice) == {'A': 6, 'B': 2}


def test_type_and_weather_do_not_decide_on_each_other() -> None:
    for seed in range(3):
        pairs = {(route.type, route.weather) for route in drawn(seed, 10 * len(TYPES))}
        # Each type gets ten of 23 weathers, drawn independently: fewer than five different ones would be no accident.
        assert min(Counter(kind for kind, _ in pairs).values()) >= 5
        assert min(Counter(weather for _, weather in pairs).values()) >= 10
    firsts = [{route.type: route.weather for route in drawn(seed, len(TYPES))} for seed in range(3)]
    for one, other in ((0, 1), (0, 2), (1, 2)):
        assert sum(firsts[one][kind] == firsts[other][kind] for kind in TYPES) < len(TYPES) // 4


def test_every_type_meets_every_weather_over_several_collections() -> None:
    pairs = {(route.type, route.weather) for seed in range(12) for route in drawn(seed, 1000)}
    assert len(pairs) == len(TYPES) * len(WEATHER_NAMES)


def test_short_collections_reach_every_type_between_them() -> None:
    assert {route.type for seed in range(40) for route in drawn(seed, 8)} == set(TYPES)
    assert [route.type for route in drawn(0, 46)] != [route.type for route in drawn(1, 46)]


def test_an_episode_is_known_by_its_number_alone() -> None:
    config = CollectConfig(TYPES, ticks=0, seed=3, weathers=WEATHER_NAMES)
    assert episode_route(config, 777) == drawn(3, 800)[777] == episode_route(config, 777)
    one = CollectConfig(('Accident',), ticks=0, seed=3)
    assert episode_route(one, 7) == RouteId('Accident', TRAIN_SEED_START + 30_007)


def test_a_third_of_the_episodes_of_paired_types_are_twins(monkeypatch, tmp_path, capsys) -> None:
    paired_types.register(monkeypatch)
    types = (paired_types.WALKER, paired_types.EMPTY, 'LaneFollowing')

    def twins(share: float) -> list[RouteId]:
        config = CollectConfig(types, ticks=0, seed=1, weathers=WEATHER_NAMES, twins=share)
        return [route for route in (episode_route(config, number) for number in range(900)) if route.twin]

    found = twins(1 / 3)
    counts = Counter(route.type for route in found)
    assert set(counts) == {paired_types.WALKER, paired_types.EMPTY}
    assert all(70 < count < 130 for count in counts.values())
    assert len({route.weather for route in found}) == len(WEATHER_NAMES)
    assert (len(twins(0.0)), len(twins(1.0))) == (0, 600)
    assert main(['collect', '--twins', '1.5', '--out', str(tmp_path / 'bags')]) == 2
    assert '--twins 1.5' in capsys.readouterr().err
    with pytest.raises(ValueError, match='twins 2'):
        CollectConfig(types, ticks=0, twins=2.0)


@pytest.mark.parametrize('bag_ticks', [1, 7, 1000])
def test_the_routes_are_the_same_whatever_the_size_of_a_bag(tmp_path, bag_ticks) -> None:
    driven: list[RouteId] = []

    class Braking:
        needs_cameras = needs_bev = False

        def reset(self, seed: int) -> None:
            driven.append(RouteId('', seed))

        def control(self, env, frame, tick) -> Decision:
            driven[-1] = env.route_id
            return Decision(frame.stamp_ns, Control(0.0, 1.0))

    config = CollectConfig(
        ('VanillaNonSignalizedTurn', 'HardBreakRoute', 'T_Junction'),
        ticks=15,
        seed=2,
        cameras=False,
        episode_ticks=3,
        bag_ticks=bag_ticks,
        weathers=WEATHER_NAMES,
    )
    for _ in collect(tmp_path, config, Braking(), {}):
        pass
    assert driven == [episode_route(config, number) for number in range(5)]
    assert len(find_bags([tmp_path])) == {1: 5, 7: 2, 1000: 1}[bag_ticks]


def test_a_negative_seed_is_refused(tmp_path, capsys) -> None:
    with pytest.raises(ValueError, match='seed -1'):
        CollectConfig(TYPES, ticks=1, seed=-1)
    assert main(['collect', '--seed', '-1', '--out', str(tmp_path / 'bags')]) == 2
    assert '--seed -1: give 0 or more' in capsys.readouterr().err
    assert not (tmp_path / 'bags').exists()
