"""What ends an episode of the collector."""

from raw2drive_ros.contract import Control
from raw2drive_ros.evaluation.collect import CollectConfig, collect
from raw2drive_ros.evaluation.world_drivers import WorldDriver
from raw2drive_ros.recording.bag_reader import find_bags, open_bag, read_ticks


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
