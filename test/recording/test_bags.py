import json
import shutil

import numpy as np
import pytest

from raw2drive_ros.contracts import topics
from raw2drive_ros.contracts.errors import BagError, BagExistsError, DiskFullError
from raw2drive_ros.evaluation.verify import recorded_proposals
from raw2drive_ros.recording import bag_writer
from raw2drive_ros.recording.bag_info import bag_info
from raw2drive_ros.recording.bag_reader import find_bags, open_bag
from raw2drive_ros.recording.bag_writer import BagWriter
from raw2drive_ros.recording.ticks import read_ticks
from raw2drive_ros.simulation.environment import DrivingEnv, SimulationConfig
from raw2drive_ros.training.config import make_config
from raw2drive_ros.training.dataset import FIRST, load_bag
from raw2drive_ros.world_model.mask_codec import MaskCodec

NANO = make_config('nano').model


def test_ticks_come_back_as_they_were_driven(bag) -> None:
    with open_bag(bag) as reader:
        ticks = list(read_ticks(reader, bag, cameras=True))
    scenario, seed = ticks[0].episode.split('/')
    env = DrivingEnv(SimulationConfig())
    first, _ = env.reset(seed=int(seed), options={'scenario': scenario})
    assert np.array_equal(ticks[0].images['front'], first.sensors.images['front'])
    assert np.array_equal(ticks[0].privileged.bev, first.privileged.bev)
    assert np.array_equal(ticks[0].route.checkpoints_m, first.route.checkpoints_m)
    assert ticks[0].transition.is_first
    stamps = [t.stamp_ns for t in ticks]
    assert stamps == sorted(set(stamps))


def test_bag_is_readable_by_the_mcap_library_alone(bag) -> None:
    from mcap.reader import make_reader

    with next(bag.glob('*.mcap')).open('rb') as stream:
        summary = make_reader(stream).get_summary()
    found = {channel.topic for channel in summary.channels.values()}
    assert {topics.BEV, topics.COMMAND, topics.image_topic('front')} <= found


def test_info_tells_provenance_rates_and_episodes(bag) -> None:
    info = bag_info(bag)
    assert info['provenance']['driver'] == 'rule'
    assert {'git', 'raw2drive_version'} <= set(info['provenance'])
    rates = {row['topic']: row['rate_hz'] for row in info['topics']}
    assert rates[topics.IMU] == pytest.approx(20, rel=0.05)
    assert rates[topics.image_topic('back')] == pytest.approx(10, rel=0.05)
    assert len(info['episodes']) == 2


def test_a_truncated_bag_is_a_clear_error(bag, tmp_path) -> None:
    broken = tmp_path / 'broken'
    shutil.copytree(bag, broken)
    file = next(broken.glob('*.mcap'))
    file.write_bytes(file.read_bytes()[: file.stat().st_size // 2])
    with pytest.raises(BagError, match='broken'):
        load_bag(broken, tmp_path / 'cache', NANO, cameras=False)
    assert list((tmp_path / 'cache').rglob('*.npy')) == []


def test_an_unclosed_bag_is_a_clear_error(bag, tmp_path) -> None:
    shutil.copytree(bag, tmp_path / 'open')
    (tmp_path / 'open' / 'metadata.yaml').unlink()
    with pytest.raises(BagError, match=r'no metadata\.yaml.*bag recover'), open_bag(tmp_path / 'open'):
        pass


def test_a_file_of_a_bag_can_be_given_instead_of_its_folder(bag, tmp_path) -> None:
    file = next(bag.glob('*.mcap'))
    assert bag_info(file)['topics'] == bag_info(bag)['topics']
    shutil.copy(file, tmp_path / 'alone.mcap')
    with pytest.raises(BagError, match=r'alone\.mcap: .*bag recover'), open_bag(tmp_path / 'alone.mcap'):
        pass


def test_metadata_that_only_the_bag_library_accepts_is_damaged(bag, tmp_path) -> None:
    # Found by fuzzing: the bag library's YAML is more lenient than ours.
    shutil.copytree(bag, tmp_path / 'odd')
    file = tmp_path / 'odd' / 'metadata.yaml'
    for damage in ('  : \n', '  - x\n'):
        file.write_text((bag / 'metadata.yaml').read_text() + damage)
        with pytest.raises(BagError, match='odd'):
            bag_info(tmp_path / 'odd')


def test_what_is_no_bag_does_not_blame_a_recorder(bag, tmp_path) -> None:
    (tmp_path / 'notes.txt').write_text('not a bag')
    (tmp_path / 'empty').mkdir()
    for path, why in (
        (tmp_path / 'notes.txt', 'not a bag'),
        (tmp_path / 'empty', 'nothing in it'),
        (bag.parent, bag.name),
    ):
        with pytest.raises(BagError, match=why) as caught, open_bag(path):
            pass
        assert 'recover' not in str(caught.value)


def test_a_bag_without_privileged_topics_names_what_is_missing(tmp_path) -> None:
    env = DrivingEnv(SimulationConfig(bev=False))
    from msg_adapters.factory import RosbagsFactory
    from raw2drive_ros.evaluation.tick_messages import TickMessages

    messages = TickMessages(RosbagsFactory(), env.rig)
    tick, _ = env.reset(seed=0)
    with BagWriter(tmp_path / 'bag') as writer:
        for topic, stamp, message in messages.cameras(tick):
            writer.write(topic, stamp, message)
    with pytest.raises(BagError, match=r'privileged stream needs /privileged/bev'):
        load_bag(tmp_path / 'bag', tmp_path / 'cache', NANO, cameras=False)


def test_a_bag_without_decisions_cannot_be_verified_and_says_so(bag) -> None:
    with pytest.raises(BagError, match='has no /control/proposed; record a drive'):
        recorded_proposals(bag)


def test_no_bags_at_all_is_a_clear_error(tmp_path) -> None:
    with pytest.raises(BagError, match='no bags found'):
        find_bags([tmp_path])
    with pytest.raises(BagError, match='no such file'):
        find_bags([tmp_path / 'nowhere'])


def test_existing_bags_are_never_overwritten(bag) -> None:
    with pytest.raises(BagExistsError, match='exists already'):
        BagWriter(bag)


def test_a_full_disk_is_refused_before_anything_is_written(tmp_path, monkeypatch) -> None:
    monkeypatch.setattr(bag_writer, 'MIN_FREE_BYTES', 10**18)
    monkeypatch.setattr(bag_writer.require_space, '__defaults__', (10**18,))
    with pytest.raises(DiskFullError, match='free some space'):
        BagWriter(tmp_path / 'bag')
    assert list(tmp_path.iterdir()) == []


def test_an_exception_while_writing_leaves_no_bag_of_that_name(tmp_path) -> None:
    with pytest.raises(RuntimeError), BagWriter(tmp_path / 'bag'):
        raise RuntimeError('recorder failed')
    assert not (tmp_path / 'bag').exists()


def test_cache_holds_the_bag_and_is_rebuilt_when_the_bag_changes(bag, tmp_path) -> None:
    copy = tmp_path / 'bag'
    shutil.copytree(bag, copy)
    arrays = load_bag(copy, tmp_path / 'cache', NANO, cameras=True)
    assert len(arrays) == sum(row['messages'] for row in bag_info(bag)['topics'] if row['topic'] == topics.BEV)
    assert (arrays.flags & FIRST).sum() == 2
    assert arrays.images.shape[1:] == (6, 96, 160, 3)
    assert arrays.action[0] == -1 and (arrays.action[1:10] >= 0).all()
    before = {p.name for p in (tmp_path / 'cache').iterdir()}
    text = (copy / 'metadata.yaml').read_text()
    (copy / 'metadata.yaml').write_text(text.replace('driver: rule', 'driver: other'))
    load_bag(copy, tmp_path / 'cache', NANO, cameras=True)
    assert {p.name for p in (tmp_path / 'cache').iterdir()} > before
    assert json.loads(next((tmp_path / 'cache').rglob('episodes.json')).read_text())


def test_mask_packing_is_lossless_and_keeps_positions() -> None:
    codec = MaskCodec(make_config('laptop').model)
    bev = np.random.default_rng(0).random((43, 128, 128)) < 0.4
    merged = codec.merge(bev)
    back = codec.to_image_order(codec.unpack(codec.pack(bev)[None]).astype(np.float32))
    assert np.array_equal(back[0], merged)
    dot = np.zeros((43, 128, 128), bool)
    dot[0, 20:24, 100:104] = True
    assert np.argwhere(codec.merge(dot)[0]).mean(axis=0) == pytest.approx((10.5, 50.5))
