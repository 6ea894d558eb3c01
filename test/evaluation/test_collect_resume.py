"""A collection that was interrupted at any moment goes on and ends with the messages of an uninterrupted one."""

import dataclasses
import json
import shutil
from pathlib import Path

import pytest

from raw2drive_ros.cli.main import main
from raw2drive_ros.contracts.errors import BagExistsError
from raw2drive_ros.evaluation.collect import CollectConfig, collect
from raw2drive_ros.evaluation.collection_journal import open_journal
from raw2drive_ros.evaluation.world_drivers import rule_driver
from raw2drive_ros.recording.bag_reader import find_bags, open_bag

CONFIG = CollectConfig(
    ('LaneFollowing', 'HardBreakRoute'),
    ticks=36,
    episode_ticks=6,
    bag_ticks=12,
    image_size=(64, 96),
    weathers=('ClearNoon', 'HardRainNight'),
    vary=True,
)
PROVENANCE = {'driver': 'rule'}
# Two episodes a bag, three bags; the last tick of an episode asks for none.
PER_BAG, DECISIONS = 10, 30


class Stopping:
    """The rule driver with bursts of noise; raises `error` at its decision number `at`, counted over all episodes."""

    needs_cameras = needs_bev = False

    def __init__(self, at: int = -1, error: BaseException | None = None) -> None:
        self.inner, self.left, self.error = rule_driver(0.3), at, error

    def reset(self, seed: int) -> None:
        self.inner.reset(seed)

    def control(self, env, frame, tick):
        self.left -= 1
        if self.left == 0 and self.error is not None:
            raise self.error
        return self.inner.control(env, frame, tick)


def gather(folder: Path, driver: Stopping, config: CollectConfig = CONFIG) -> int:
    """Collect; the number of decisions that were asked for."""
    before = driver.left
    for _ in collect(folder, config, driver, PROVENANCE):
        pass
    return before - driver.left


def messages(folder: Path) -> dict[str, list[tuple[str, int, bytes]]]:
    found = {}
    for path in find_bags([folder]):
        with open_bag(path) as reader:
            found[path.name] = [(c.topic, stamp, bytes(data)) for c, stamp, data in reader.messages()]
    return found


@pytest.fixture(scope='module')
def whole(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp('whole')
    gather(folder, Stopping())
    assert len(find_bags([folder])) == 3
    return folder


@pytest.mark.parametrize('error', [KeyboardInterrupt(), RuntimeError('as a kill leaves it')])
@pytest.mark.parametrize('at', [1, 9, 15, 30])
def test_the_bags_are_those_of_an_uninterrupted_collection(whole, tmp_path, error, at) -> None:
    with pytest.raises(type(error)):
        gather(tmp_path, Stopping(at, error))
    resumed = Stopping()
    asked = gather(tmp_path, resumed)
    # Only what the interrupted bag held is driven again.
    assert asked == DECISIONS - PER_BAG * ((at - 1) // PER_BAG)
    assert messages(tmp_path) == messages(whole)
    assert not list(tmp_path.rglob('*.partial'))


def test_a_finished_collection_is_not_driven_again_and_a_lost_bag_is(whole, tmp_path) -> None:
    shutil.copytree(whole, tmp_path / 'copy')
    assert gather(tmp_path / 'copy', Stopping()) == 0
    second = sorted(messages(whole))[1]
    shutil.rmtree(tmp_path / 'copy' / second)
    assert gather(tmp_path / 'copy', Stopping()) == PER_BAG
    assert messages(tmp_path / 'copy') == messages(whole)


def test_a_note_that_a_kill_cut_off_costs_one_bag(whole, tmp_path) -> None:
    shutil.copytree(whole, tmp_path / 'copy')
    journal = next((tmp_path / 'copy').glob('.*.collection.jsonl'))
    text = journal.read_text()
    journal.write_text(text[: text.rstrip().rfind('{') + 9])
    assert gather(tmp_path / 'copy', Stopping()) == PER_BAG
    assert messages(tmp_path / 'copy') == messages(whole)


def test_another_collection_with_the_same_bags_is_refused(whole) -> None:
    before = messages(whole)
    for other, what in (
        (dataclasses.replace(CONFIG, ticks=90), 'ticks 36'),
        (dataclasses.replace(CONFIG, vary=False), 'vary True'),
    ):
        with pytest.raises(BagExistsError, match=f'{what} then, .* now: give another --out or --seed'):
            gather(whole, Stopping(), other)
    with pytest.raises(BagExistsError, match="identity '' then, 'rule x' now"):
        next(collect(whole, CONFIG, Stopping(), PROVENANCE, 'rule x'))
    assert messages(whole) == before


def test_bags_without_notes_are_never_touched(whole, tmp_path) -> None:
    """Those of version 0.2, or somebody else's of that name."""
    shutil.copytree(whole, tmp_path / 'copy')
    next((tmp_path / 'copy').glob('.*.collection.jsonl')).unlink()
    for _ in range(2):
        with pytest.raises(BagExistsError, match='exists already'):
            gather(tmp_path / 'copy', Stopping())
    assert messages(tmp_path / 'copy') == messages(whole)


def test_two_processes_do_not_collect_the_same_bags(tmp_path) -> None:
    with (
        open_journal(tmp_path, 'rule_100000', {}),
        pytest.raises(BagExistsError, match='another process is collecting'),
        open_journal(tmp_path, 'rule_100000', {}),
    ):
        pass


def test_notes_of_bags_that_are_gone_are_no_obstacle(whole, tmp_path) -> None:
    shutil.copytree(whole, tmp_path / 'copy')
    for path in find_bags([tmp_path / 'copy']):
        shutil.rmtree(path)
    other = dataclasses.replace(CONFIG, ticks=20, cameras=False)
    assert gather(tmp_path / 'copy', Stopping(), other) > 0
    assert gather(tmp_path / 'copy', Stopping(), other) == 0


def test_the_command_says_how_to_go_on_and_goes_on(tmp_path, capsys, monkeypatch) -> None:
    from raw2drive_ros.evaluation import drivers

    words = ['collect', '--ticks', '50', '--episode-ticks', '20', '--no-cameras', '--out', str(tmp_path / 'bags')]
    entry = drivers.DRIVERS['rule']
    stopping = drivers.DriverEntry(lambda options: Stopping(30, KeyboardInterrupt()), 'stops', reads=('noise',))
    monkeypatch.setitem(drivers.DRIVERS, 'rule', stopping)
    assert main(words) == 130
    assert 'of 50 ticks are driven; the same command goes on' in capsys.readouterr().err
    monkeypatch.setitem(drivers.DRIVERS, 'rule', entry)
    assert main(words) == 0
    assert '1 bags in' in capsys.readouterr().out
    notes = next((tmp_path / 'bags').glob('.*.collection.jsonl')).read_text().splitlines()
    assert json.loads(notes[-1]) == {'bag': 'rule_100000', 'episodes': 3, 'ticks': 60, 'clock_ns': 6_900_000_000}
