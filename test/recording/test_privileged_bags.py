"""Bags with actors, signals and masks of what was seen: written, read on demand, examined, trained on; and old bags."""

import dataclasses
import shutil
from pathlib import Path

import numpy as np
import pytest
import torch
from pydantic import ValidationError

from msg_adapters.factory import RosbagsFactory
from msg_adapters.privileged import advice_to_message, signals_to_message
from raw2drive_ros.cli.main import main
from raw2drive_ros.contracts import topics
from raw2drive_ros.contracts.actions import ACTION_COUNT
from raw2drive_ros.contracts.errors import BagError, ContractError
from raw2drive_ros.contracts.privileged import Advice
from raw2drive_ros.contracts.public import Control
from raw2drive_ros.driving.bundle import load_bundle, save_bundle
from raw2drive_ros.evaluation.episode import as_received, drive_route
from raw2drive_ros.evaluation.privileged_driver import PrivilegedDriver
from raw2drive_ros.evaluation.tick_messages import TickMessages
from raw2drive_ros.recording.bag_doctor import examine
from raw2drive_ros.recording.bag_edit import cut, merge
from raw2drive_ros.recording.bag_info import bag_info
from raw2drive_ros.recording.bag_reader import open_bag
from raw2drive_ros.recording.bag_writer import BagWriter
from raw2drive_ros.recording.ticks import EXTRAS, TickCounts, read_advice, read_ticks
from raw2drive_ros.report.dream import reasons_of, ticks_around
from raw2drive_ros.settings import default_bundle, default_teacher
from raw2drive_ros.simulation.bev import BevRenderer
from raw2drive_ros.simulation.camera_rig import camera_rig
from raw2drive_ros.simulation.environment import DrivingEnv, SimulationConfig
from raw2drive_ros.simulation.privileged_view import PrivilegedView
from raw2drive_ros.simulation.route_id import RouteId
from raw2drive_ros.tables.vector_layout import (
    BASIC_EGO_FIELDS,
    EGO_FIELDS,
    PRIVILEGED_FIELDS,
    SIGNAL_FIELDS,
    VECTOR_SIZE,
)
from raw2drive_ros.training.config import make_config
from raw2drive_ros.training.dataset import load_bag
from raw2drive_ros.training.privileged import PrivilegedTrainer
from raw2drive_ros.training.replay import Replay
from raw2drive_ros.training.run import train
from raw2drive_ros.world_model.actor_critic import Actor
from raw2drive_ros.world_model.config import ModelConfig
from raw2drive_ros.world_model.mask_codec import MaskCodec
from raw2drive_ros.world_model.privileged_inputs import extra_topics, masks_of, vector_of
from raw2drive_ros.world_model.streams import RawWorldModel
from raw2drive_ros.world_model.teacher import load_teacher, save_teacher

OLD_BAG = Path(__file__).resolve().parents[2] / 'bags' / 'rule_190000'
TICKS = 40
NANO = make_config('nano').model
RICH = NANO.model_copy(update={'ego_fields': PRIVILEGED_FIELDS, 'masks': 'visible'})
REASON = 'give way: cyclist 3'


class SharpEyes:
    """Sees every cyclist, light and sign, and nothing else."""

    def pixels(self, actor):
        return np.arange(6)

    def seconds_since_seen(self, actor) -> float:
        return 0.0 if actor.kind == 'cyclist' else np.inf

    def signal_pixels(self):
        return np.ones((20, 6), int)

    def light_seen_s(self, index: int) -> float:
        return 0.0

    def sign_seen_s(self, index: int) -> float:
        return 0.0


def view_of(env: DrivingEnv) -> PrivilegedView:
    """Another one than the environment's own, for another visibility."""
    return PrivilegedView(env.world, BevRenderer(env.world))


def write(path: Path, lost: str = '', every: int = 1, start_s: int = 0) -> list:
    """A bag of TICKS ticks without cameras; returns the privileged frames. lost: a topic, in every `every`th tick."""
    env = DrivingEnv(SimulationConfig(cameras=False))
    env.clock_ns += start_s * 1_000_000_000
    messages, frames = TickMessages(RosbagsFactory(), env.rig), []
    tick, _ = env.reset(seed=1, options={'scenario': 'HazardAtSideLane'})
    view = view_of(env)
    with BagWriter(path, {'driver': 'rule'}) as bag:
        bag.write(*messages.route(tick))
        for number in range(TICKS):
            frame = view.frame(tick.stamp_ns, SharpEyes())
            frames.append(frame)
            tick = dataclasses.replace(tick, privileged=frame)
            for source in (messages.motion(tick), messages.privileged(tick, 'HazardAtSideLane/1')):
                for topic, stamp, message in source:
                    if topic != lost or number % every:
                        bag.write(topic, stamp, message)
            advice = Advice(tick.stamp_ns, 4, REASON if number % 2 else '')
            bag.write(topics.ADVICE, tick.stamp_ns, advice_to_message(bag.factory, advice))
            tick, *_ = env.step(Control(throttle=0.4))
    return frames


@pytest.fixture(scope='module')
def written(tmp_path_factory) -> tuple[Path, list]:
    path = tmp_path_factory.mktemp('privileged') / 'bag'
    return path, write(path)


def ticks_of(bag: Path, extras=(), counts: TickCounts | None = None) -> list:
    with open_bag(bag) as reader:
        return list(read_ticks(reader, bag, cameras=False, extras=extras, counts=counts))


def test_everything_comes_back_for_who_asks(written) -> None:
    bag, frames = written
    ticks = ticks_of(bag, EXTRAS)
    assert len(ticks) == TICKS
    for tick, frame in zip(ticks, frames, strict=True):
        found = tick.privileged.validate()
        assert np.array_equal(found.bev, frame.bev) and np.array_equal(found.bev_visible, frame.bev_visible)
        assert found.actors.tobytes() == frame.actors.tobytes()
        assert np.array_equal(found.signals, frame.signals) and np.array_equal(found.ego, frame.ego)
    assert len(ticks[0].privileged.actors) > 2 and ticks[0].privileged.bev_visible.sum() < ticks[0].privileged.bev.sum()


def test_who_does_not_ask_reads_the_same_ticks_as_before(written) -> None:
    ticks = ticks_of(written[0])
    assert len(ticks) == TICKS and all(tick.privileged.actors is None for tick in ticks)
    only = ticks_of(written[0], (topics.SIGNALS,))
    assert all(tick.privileged.bev_visible is None and tick.privileged.signals is not None for tick in only)


def test_info_doctor_cut_and_merge_know_the_topics(written, tmp_path, capsys) -> None:
    bag, _ = written
    rows = {row['topic']: row for row in bag_info(bag)['topics']}
    assert [rows[name]['messages'] for name in EXTRAS] == [TICKS] * 3
    assert rows[topics.ACTORS]['rate_hz'] == pytest.approx(10.0)
    assert not [c for c in examine(bag) if 'privileged' in c.text]
    assert main(['bag', 'info', str(bag)]) == 0
    assert '/privileged/actors' in capsys.readouterr().out
    cut(bag, tmp_path / 'part', 1.0, 2.0)
    merge([bag, tmp_path / 'part'], tmp_path / 'whole')
    assert len(ticks_of(tmp_path / 'whole', EXTRAS)) == TICKS
    assert topics.ACTORS in {row['topic'] for row in bag_info(tmp_path / 'part')['topics']}


@pytest.mark.parametrize('lost', EXTRAS)
def test_lost_messages_cost_ticks_only_those_who_need_them(tmp_path, lost) -> None:
    write(tmp_path / 'bag', lost, 4)
    counts = TickCounts()
    assert len(ticks_of(tmp_path / 'bag')) == TICKS
    assert len(ticks_of(tmp_path / 'bag', (lost,), counts)) == TICKS * 3 // 4
    assert counts.incomplete == TICKS // 4 and counts.cuts > 0
    (said,) = [c for c in examine(tmp_path / 'bag') if 'privileged' in c.text]
    assert (said.severity, said.text) == ('warning', f'{lost}: 30 messages for 40 of /privileged/bev')


def test_broken_messages_are_refused_counted_and_named_by_the_doctor(written, tmp_path) -> None:
    with BagWriter(tmp_path / 'bag') as broken, open_bag(written[0]) as reader:
        for connection, stamp, data in reader.messages():
            message = broken.factory.deserialize(data, connection.msgtype)
            if connection.topic == topics.ACTORS and stamp % 1_000_000_000 == 0:
                message.width = 3 * message.width + 1
            if connection.topic == topics.SIGNALS and stamp % 1_000_000_000 == 0:
                wrong = np.full(len(SIGNAL_FIELDS), np.nan, np.float32)
                message = signals_to_message(broken.factory, wrong, stamp)
            broken.write(connection.topic, stamp, message)
    counts = TickCounts()
    with pytest.raises(BagError, match='make a bag unusable'):
        ticks_of(tmp_path / 'bag', EXTRAS, counts)
    assert counts.verdicts.refused == {topics.ACTORS: 4, topics.SIGNALS: 4} and counts.ticks == TICKS - 4
    said = [c.text for c in examine(tmp_path / 'bag') if 'refused' in c.text and c.severity == 'warning']
    assert len(said) == 2 and 'bytes for' in said[0] and 'not finite' in said[1]
    assert len(ticks_of(tmp_path / 'bag')) == TICKS


def test_the_arrays_of_training_are_what_the_configuration_names(written, tmp_path) -> None:
    bag, frames = written
    rich, plain = (load_bag(bag, tmp_path / 'cache', config, cameras=False) for config in (RICH, NANO))
    assert rich.ego.shape == (TICKS, len(PRIVILEGED_FIELDS)) and plain.ego.shape == (TICKS, 5)
    assert np.array_equal(rich.ego, [np.concatenate([f.ego, f.signals]) for f in frames])
    assert np.array_equal(plain.ego, rich.ego[:, :5])
    codec = MaskCodec(NANO)
    assert np.array_equal(rich.masks, [codec.pack(f.bev_visible) for f in frames])
    assert np.array_equal(plain.masks, [codec.pack(f.bev) for f in frames])
    assert not np.array_equal(plain.masks, rich.masks)
    picked = NANO.model_copy(update={'ego_fields': ('light_red', 'heading_error_rad')})
    assert extra_topics(picked) == (topics.SIGNALS,)
    assert np.array_equal(load_bag(bag, tmp_path / 'cache', picked, cameras=False).ego, rich.ego[:, [10, 6]])
    assert (rich.advice == 4).all()


def test_reasons_come_with_the_advice(written) -> None:
    bag, frames = written
    with open_bag(bag) as reader:
        advised = read_advice(reader, RosbagsFactory())
    first, second = (frame.stamp_ns for frame in frames[:2])
    assert (advised[first], advised[second]) == (Advice(first, 4), Advice(second, 4, REASON))
    ticks, begins = ticks_around(bag, 1.0, 1.0, RICH)
    assert reasons_of(bag, ticks)[begins : begins + 2] == ['', REASON]


def test_a_model_that_reads_everything_is_trained_saved_and_drives(written, tmp_path) -> None:
    config = make_config('nano', {'warmup': 1}).model_copy(update={'model': RICH})
    bags = [load_bag(written[0], tmp_path / 'cache', RICH, cameras=False)]
    trainer = PrivilegedTrainer(config)
    replay = Replay(bags, MaskCodec(RICH), 8, 0.0, 0)
    losses = [trainer.step(replay.sample(4))['loss/ego'] for _ in range(30)]
    assert losses[-1] < 0.7 * losses[0], 'the decoder learns the signals and the ego vector'
    body = config.model_dump(mode='json')
    save_teacher(tmp_path / 'teacher', trainer.teacher(), body, {})
    assert load_teacher(tmp_path / 'teacher').config == RICH
    driver = PrivilegedDriver(tmp_path / 'teacher')
    driver.reset(0)
    env = DrivingEnv(SimulationConfig(cameras=False))
    first, _ = env.reset(seed=1, options={'scenario': 'HazardAtSideLane'})
    tick = dataclasses.replace(first, privileged=view_of(env).frame(first.stamp_ns, SharpEyes()))
    assert 0 <= driver.control(env, as_received(RosbagsFactory(), tick), tick).action < ACTION_COUNT
    blind = dataclasses.replace(first, privileged=view_of(env).frame(first.stamp_ns))
    with pytest.raises(ContractError, match='the model reads'):
        driver.control(env, as_received(RosbagsFactory(), blind), blind)


def test_a_raw_bundle_remembers_the_fields_that_its_decoder_reconstructs(tmp_path) -> None:
    model = RawWorldModel(RICH, camera_rig(), VECTOR_SIZE, RICH.ego_size, ACTION_COUNT)
    save_bundle(tmp_path / 'bundle', RICH, camera_rig(), model, Actor(RICH, ACTION_COUNT), {})
    loaded = load_bundle(tmp_path / 'bundle')
    assert loaded.config == RICH
    assert loaded.model.decoder.ego(torch.zeros(1, RICH.feature_size)).shape == (1, len(PRIVILEGED_FIELDS))


@pytest.mark.parametrize(
    ('fields', 'why'),
    [(['speed_mps', 'velocity'], 'unknown ego_fields: velocity'), (['brake', 'brake'], 'twice'), ([], 'one')],
)
def test_fields_that_no_frame_has_are_a_clear_error(fields, why) -> None:
    with pytest.raises(ValidationError, match=why):
        ModelConfig(**NANO.model_dump() | {'ego_fields': fields})


# -- bags and models of before ------------------------------------------------------------------------


def test_an_old_bag_has_five_fields_and_is_fit_for_use() -> None:
    ticks = ticks_of(OLD_BAG)
    assert ticks and all(tick.privileged.validate().ego.shape == (5,) for tick in ticks)
    assert np.array_equal(vector_of(ticks[0].privileged, NANO), ticks[0].privileged.ego)
    said = [c for c in examine(OLD_BAG) if 'privileged' in c.text]
    assert [(c.severity, 'older simulator' in c.text) for c in said] == [('note', True)]


def test_an_old_bag_trains_the_models_that_it_can_and_says_why_not_the_others(tmp_path) -> None:
    settings = {'threads': 1, 'log_every': 1, 'picture_every': 100, 'checkpoint_every': 2}
    train('privileged', tmp_path / 'run', [OLD_BAG], tmp_path / 'cache', 2, 'nano', settings)
    assert load_teacher(tmp_path / 'run').config.ego_fields == BASIC_EGO_FIELDS
    with pytest.raises(BagError, match=r'needs /privileged/bev_visible, /privileged/signals, which this bag does not'):
        load_bag(OLD_BAG, tmp_path / 'cache', RICH, cameras=False)
    longer = NANO.model_copy(update={'ego_fields': EGO_FIELDS})
    with pytest.raises(BagError, match=r'reads lateral_offset_m, heading_error_rad: .*collect anew'):
        load_bag(OLD_BAG, tmp_path / 'cache', longer, cameras=False)
    with pytest.raises(BagError, match='this model needs /privileged/bev_visible'):
        ticks_around(OLD_BAG, 1.0, 1.0, RICH)


def test_old_and_new_bags_merge_and_each_model_takes_what_it_can(tmp_path) -> None:
    write(tmp_path / 'later', start_s=5000)
    merged = merge([OLD_BAG, tmp_path / 'later'], tmp_path / 'both')
    assert merged.counts[topics.ACTORS] == TICKS
    every, rich = ticks_of(tmp_path / 'both'), ticks_of(tmp_path / 'both', EXTRAS)
    assert (len(rich), len(every)) == (TICKS, TICKS + len(ticks_of(OLD_BAG)))
    assert {len(tick.privileged.ego) for tick in every} == {5, 7} and {len(t.privileged.ego) for t in rich} == {7}


@pytest.mark.parametrize('load', [lambda: load_teacher(default_teacher()), lambda: load_bundle(default_bundle())])
def test_the_shipped_weights_read_the_five_fields(load) -> None:
    loaded = load()
    assert loaded.config.ego_fields == BASIC_EGO_FIELDS and loaded.config.masks == 'all'
    assert loaded.model.decoder.ego(torch.zeros(1, loaded.config.feature_size)).shape == (1, 5)


def test_the_shipped_teacher_drives_in_a_simulator_with_the_longer_vector() -> None:
    driver = PrivilegedDriver(default_teacher())
    route = RouteId('LaneFollowing', 190001)
    drive = drive_route(DrivingEnv(SimulationConfig(cameras=False)), driver, route, max_ticks=30)
    assert len(drive.controls) == 30 and any(control.throttle > 0 for control in drive.controls)


def test_frames_that_lack_what_a_model_reads_are_a_clear_error(written) -> None:
    frame = ticks_of(written[0])[0].privileged
    with pytest.raises(ContractError, match=r'reads light_none, .*older simulator'):
        vector_of(frame, RICH)
    with pytest.raises(ContractError, match='no /privileged/bev_visible'):
        masks_of(frame, RICH)


def test_another_type_on_a_new_topic_is_named(written, tmp_path) -> None:
    shutil.copytree(written[0], tmp_path / 'bag')
    for file in (tmp_path / 'bag').iterdir():
        data = file.read_bytes()
        if file.suffix == '.yaml':
            file.write_bytes(data.replace(b'sensor_msgs/msg/PointCloud2', b'sensor_msgs/msg/PointCloud3'))
    said = ' '.join(c.text for c in examine(tmp_path / 'bag'))
    assert 'PointCloud3' in said
