"""Both stages overfit one batch and resume exactly; stage 2 does not change the teacher."""

import copy
import json
import math

import pytest
import torch

from raw2drive_ros.contracts.errors import CheckpointError, ConfigError
from raw2drive_ros.evaluation.collect import CollectConfig, collect
from raw2drive_ros.evaluation.table_actions import TableActionDriver
from raw2drive_ros.evaluation.world_drivers import rule_driver
from raw2drive_ros.recording.bag_reader import find_bags
from raw2drive_ros.training.config import make_config
from raw2drive_ros.training.dataset import load_bags, rig_of
from raw2drive_ros.training.imagination import imagine, start_noise
from raw2drive_ros.training.optimiser import decay_factor
from raw2drive_ros.training.parallel import ALONE
from raw2drive_ros.training.privileged import PrivilegedTrainer
from raw2drive_ros.training.raw import RawTrainer
from raw2drive_ros.training.replay import Replay
from raw2drive_ros.training.run import RunFolder, train
from raw2drive_ros.world_model.mask_codec import MaskCodec
from raw2drive_ros.world_model.rssm import State
from raw2drive_ros.world_model.run_files import newest_checkpoint
from raw2drive_ros.world_model.teacher import load_teacher

NANO = {'threads': 1, 'log_every': 5, 'picture_every': 100, 'checkpoint_every': 5}


@pytest.fixture(scope='module')
def replay(workspace, bags) -> Replay:
    config = make_config('nano')
    loaded = load_bags(find_bags([bags]), workspace / 'cache', config.model, cameras=True)
    return Replay(loaded, MaskCodec(config.model), 6, 0.3, 0)


def test_stage_1_overfits_one_batch(replay) -> None:
    trainer = PrivilegedTrainer(make_config('nano', {'warmup': 10, 'policy_after': 10_000}))
    batch = replay.sample(2)
    first = {k: float(v.detach().mean()) for k, v in trainer.model_losses(batch)[0].items()}
    for _ in range(250):
        trainer.step(batch)
    last = {k: float(v.detach().mean()) for k, v in trainer.model_losses(batch)[0].items()}
    assert last['masks'] < 0.1 * first['masks']
    assert last['reward'] < 0.5 * first['reward']
    assert last['dyn'] >= 1.0, 'free nats are the floor'


def test_stage_2_overfits_one_batch_and_aligns_every_state(replay, teacher_run, bag) -> None:
    teacher = load_teacher(teacher_run)
    config = make_config('nano', {'warmup': 10, 'policy_after': 10_000})
    trainer = RawTrainer(config, teacher, rig_of(bag), 100)
    batch = replay.sample(2, images=True)
    first = {k: float(v.detach().mean()) for k, v in trainer.model_losses(batch)[0].items()}
    for _ in range(200):
        trainer.step(batch)
    last = {k: float(v.detach().mean()) for k, v in trainer.model_losses(batch)[0].items()}
    assert last['masks'] < 0.3 * first['masks']
    assert last['align_encoder'] < 0.3 * first['align_encoder']
    assert last['align_stoch'] < 0.5 * first['align_stoch']


def test_stage_2_never_changes_the_teacher(replay, teacher_run, bag) -> None:
    teacher = load_teacher(teacher_run)
    before = copy.deepcopy(teacher.model.state_dict()) | copy.deepcopy(teacher.policy.state_dict())
    trainer = RawTrainer(make_config('nano'), teacher, rig_of(bag), 100)
    for _ in range(3):
        trainer.step(replay.sample(2, images=True))
    after = teacher.model.state_dict() | teacher.policy.state_dict()
    assert all(torch.equal(before[k], after[k]) for k in before)
    assert all(p.grad is None for p in teacher.model.parameters())


def test_the_raw_stream_starts_as_the_privileged_one(replay, teacher_run, bag) -> None:
    teacher = load_teacher(teacher_run)
    trainer = RawTrainer(make_config('nano'), teacher, rig_of(bag), 100)
    for ours, theirs in (
        (trainer.model.rssm, teacher.model.rssm),
        (trainer.model.decoder, teacher.model.decoder),
        (trainer.policy.actor, teacher.policy.actor),
    ):
        assert all(torch.equal(a, b) for a, b in zip(ours.parameters(), theirs.parameters(), strict=True))
    assert trainer.model.reward is None and trainer.model.cont is None


def _noise():
    return start_noise(4, ALONE, torch.Generator().manual_seed(1))


def test_head_guidance_reads_the_privileged_features(replay, teacher_run, bag) -> None:
    """With equal weights and one shared sample both rollouts are equal; own deter states make them differ."""
    teacher = load_teacher(teacher_run)
    trainer = RawTrainer(make_config('nano'), teacher, rig_of(bag), 100)
    deter = torch.randn(4, trainer.config.model.deter)
    start = State(deter, torch.zeros(4, trainer.config.model.stoch_size))
    arguments = (trainer.model.rssm, trainer.policy.actor, start, teacher.model.reward, teacher.model.cont, 3)
    same = imagine(*arguments, _noise(), (teacher.model.rssm, deter))
    assert torch.equal(same.features, same.teacher)
    other = imagine(
        *arguments, start_noise(4, ALONE, torch.Generator().manual_seed(1)), (teacher.model.rssm, deter + 1.0)
    )
    assert torch.equal(same.features, other.features)
    assert not torch.equal(same.teacher, other.teacher)
    assert torch.equal(
        same.features[..., trainer.config.model.deter :], other.teacher[..., trainer.config.model.deter :]
    )


@pytest.mark.parametrize(('killed_at', 'left'), [(10, '00000005'), (5, None)])
def test_a_killed_run_resumes_to_the_same_weights(workspace, bags, tmp_path, killed_at, left) -> None:
    def dies(step: int, metrics: dict[str, float]) -> None:
        if step == killed_at:
            # After the log line of this step, before its checkpoint: five steps are lost.
            raise KeyboardInterrupt

    arguments = [bags], workspace / 'cache', 15, 'nano', NANO
    whole = train('privileged', tmp_path / 'whole', *arguments)
    with pytest.raises(KeyboardInterrupt):
        train('privileged', tmp_path / 'parts', *arguments, report=dies)
    newest = newest_checkpoint(tmp_path / 'parts' / 'checkpoints')
    assert (newest and newest.name) == left
    with (tmp_path / 'parts' / 'metrics.jsonl').open('a') as file:
        file.write('{"step": 11, "tim')
    parts = train('privileged', tmp_path / 'parts', *arguments)
    for name, module in whole.modules().items():
        other = parts.modules()[name].state_dict()
        for key, value in module.state_dict().items():
            assert torch.equal(value, other[key]), f'{name}/{key}'
    logged, expected = (
        [json.loads(line) | {'time': 0, 'time/step_s': 0} for line in (tmp_path / run / 'metrics.jsonl').open()]
        for run in ('parts', 'whole')
    )
    assert logged == expected


def test_a_run_folder_holds_config_metrics_pictures_checkpoint(teacher_run) -> None:
    assert (teacher_run / 'config.json').is_file()
    assert (teacher_run / 'metrics.jsonl').is_file()
    assert list((teacher_run / 'pictures').glob('*.png'))
    assert list((teacher_run / 'tensorboard').iterdir())
    assert newest_checkpoint(teacher_run / 'checkpoints').name == '00000010'


def test_stage_2_without_a_teacher_is_a_clear_error(workspace, bags, tmp_path) -> None:
    with pytest.raises(CheckpointError, match='not a training run'):
        train('raw', tmp_path / 'run', [bags], workspace / 'cache', 1, 'nano', NANO, tmp_path / 'nowhere')


def test_the_learning_rate_is_constant_and_then_falls_linearly() -> None:
    factors = [decay_factor(step, 100, 0.4, 0.1) for step in (0, 60, 80, 100, 150)]
    assert factors == pytest.approx([1.0, 1.0, 0.55, 0.1, 0.1])
    assert decay_factor(100, 100, 0.0, 0.1) == 1.0


def test_a_factor_of_zero_moves_no_weight(replay) -> None:
    trainer = PrivilegedTrainer(make_config('nano'))
    before = copy.deepcopy(trainer.model.state_dict())
    trainer.step(replay.sample(2), factor=0.0)
    assert all(torch.equal(before[k], v) for k, v in trainer.model.state_dict().items())


def test_wrong_field_is_named() -> None:
    with pytest.raises(ConfigError, match='learning_rate'):
        make_config('nano', {'learning_rate': 1})
    with pytest.raises(ConfigError, match='known: laptop, laptop_flat, nano, paper'):
        make_config('huge')


def test_paper_preset_keeps_43_classes_and_takes_a_step_of_both_stages(tmp_path) -> None:
    """The paper's sizes (150 million weights in stage 1) on the smallest possible batch."""
    config = make_config('paper', {'threads': 1, 'starts': 2, 'horizon': 2})
    model = config.model
    assert len(model.mask_classes) == 43
    assert (model.deter, model.stoch, model.grid) == (6144, 32, 16)
    collecting = CollectConfig(('LaneFollowing',), ticks=3, episode_ticks=3, image_size=model.image_size)
    for _ in collect(tmp_path / 'bags', collecting, rule_driver(), {'driver': 'rule'}):
        pass
    bags = load_bags(find_bags([tmp_path / 'bags']), tmp_path / 'cache', model, cameras=True)
    batch = Replay(bags, MaskCodec(model), 2, 0.0, 0).sample(1, images=True)
    teacher = PrivilegedTrainer(config)
    raw = RawTrainer(config, teacher.teacher(), rig_of(bags[0].path), 1)
    for trainer in (raw, teacher):
        before = next(trainer.model.decoder.parameters()).detach().clone()
        teacher.model.requires_grad_(trainer is teacher)
        teacher.policy.requires_grad_(trainer is teacher)
        metrics = trainer.step(batch)
        assert all(math.isfinite(value) for value in metrics.values()), metrics
        assert not torch.equal(before, next(trainer.model.decoder.parameters()))


def test_two_trainers_cannot_share_a_run_folder(bags, workspace, tmp_path) -> None:
    run = tmp_path / 'run'
    with RunFolder(run).alone(), pytest.raises(CheckpointError, match='another process is training there'):
        train('privileged', run, [bags], workspace / 'cache', 1, 'nano', NANO)
    train('privileged', run, [bags], workspace / 'cache', 1, 'nano', NANO)


def test_imitation_raises_the_likelihood_of_what_the_expert_did(workspace, tmp_path) -> None:
    """Only bags of the driver `expert` count: those of `rule` hold the same drives under another name."""
    config = CollectConfig(('LaneFollowing',), ticks=120, episode_ticks=60, cameras=False)
    losses = {}
    for name in ('expert', 'rule'):
        for _ in collect(tmp_path / name, config, TableActionDriver(rule_driver()), {'driver': name}):
            pass
        options = NANO | {'imitate': 1.0, 'log_every': 10, 'policy_lr': 3e-3}
        train('privileged', tmp_path / f'run_{name}', [tmp_path / name], workspace / 'cache', 60, 'nano', options)
        lines = (tmp_path / f'run_{name}' / 'metrics.jsonl').read_text().splitlines()
        losses[name] = [json.loads(line).get('loss/imitation') for line in lines]
    assert losses['expert'][-1] < 0.9 * losses['expert'][0]
    assert losses['rule'] == [None] * 6
