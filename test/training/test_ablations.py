"""Every ablation switch changes its own loss and no other; a switch that no code reads fails here."""

import json
import math

import pytest
import torch

from raw2drive_ros.contracts.errors import CheckpointError, ConfigError
from raw2drive_ros.recording.bag_reader import find_bags
from raw2drive_ros.training.config import RunConfig, TrainConfig, make_config, overridden, read_run_config
from raw2drive_ros.training.dataset import load_bags, rig_of
from raw2drive_ros.training.guidance import observe_pair
from raw2drive_ros.training.privileged import PrivilegedTrainer
from raw2drive_ros.training.raw import RawTrainer
from raw2drive_ros.training.replay import Replay
from raw2drive_ros.world_model.mask_codec import MaskCodec
from raw2drive_ros.world_model.teacher import load_teacher

HEADS = {'raw_heads': ('reward', 'continue')}
STEPS = 3


@pytest.fixture(scope='module')
def batch(workspace, bags):
    config = make_config('nano')
    loaded = load_bags(find_bags([bags]), workspace / 'cache', config.model, cameras=True)
    return Replay(loaded, MaskCodec(config.model), 6, 0.3, 0).sample(2, images=True)


@pytest.fixture(scope='module')
def raw_metrics(batch, teacher_run, bag):
    """overrides -> the metrics of each of `STEPS` steps on one batch, from one seed."""
    known: dict[str, list[dict[str, float]]] = {}

    def of(overrides) -> list[dict[str, float]]:
        if repr(overrides) not in known:
            config = make_config('nano', {'warmup': 1, 'policy_after': 0, 'policy_every': 1} | overrides)
            trainer = RawTrainer(config, load_teacher(teacher_run), rig_of(bag), 10)
            known[repr(overrides)] = [trainer.step(batch) for _ in range(STEPS)]
        return known[repr(overrides)]

    return of


# switch: (what it is compared with, the metric that it changes, at which step, metrics of step 0 that stay)
MODEL = ('loss/masks', 'loss/ego', 'loss/dyn', 'loss/rep', 'loss/align_encoder', 'loss/align_stoch', 'loss/align_deter')
AT_ONCE, LATER = 0, STEPS - 1
SWITCHES = [
    ({'sample_source': 'privileged'}, {}, 'loss/masks', AT_ONCE, ('loss/align_encoder',)),
    ({'sample_source': 'independent'}, {}, 'loss/align_deter', AT_ONCE, ('loss/align_encoder',)),
    (
        {'sample_source': 'independent'},
        {'sample_source': 'privileged'},
        'loss/align_deter',
        AT_ONCE,
        ('loss/align_encoder',),
    ),
    ({'share_rssm': 'none'}, {}, 'loss/dyn', AT_ONCE, ('loss/align_encoder',)),
    ({'share_rssm': 'tied'}, {}, 'loss/dyn', LATER, MODEL),
    ({'share_decoder': 'none'}, {}, 'loss/masks', AT_ONCE, ('loss/dyn', 'loss/rep', 'loss/align_deter')),
    ({'share_decoder': 'tied'}, {}, 'loss/masks', LATER, MODEL),
    ({'align_space': False}, {}, 'loss/align_encoder', AT_ONCE, ('loss/align_stoch', 'loss/align_deter')),
    ({'align_time': False}, {}, 'loss/align_encoder', AT_ONCE, ('loss/align_stoch', 'loss/align_deter')),
    ({'weight_encoder': 0.0}, {}, 'loss/align_encoder', LATER, MODEL),
    ({'weight_stoch': 0.0}, {}, 'loss/align_stoch', LATER, MODEL),
    ({'weight_deter': 0.0}, {}, 'loss/align_deter', LATER, MODEL),
    (HEADS | {'head_guidance': False}, HEADS, 'policy/reward', AT_ONCE, MODEL),
    ({'policy_init': 'fresh'}, {}, 'policy/entropy', AT_ONCE, MODEL),
    ({'distill': 0.0, 'distill_end': 0.0}, {}, 'loss/distill', LATER, MODEL),
]


@pytest.mark.parametrize(('switch', 'base', 'changed', 'when', 'same'), SWITCHES)
def test_a_stage_2_switch_changes_its_loss_and_no_other(raw_metrics, switch, base, changed, when, same) -> None:
    with_it, without = raw_metrics(switch), raw_metrics(base)
    assert all(math.isfinite(value) for step in with_it for value in step.values())
    assert with_it[when][changed] != without[when][changed]
    assert {name: with_it[0][name] for name in same} == {name: without[0][name] for name in same}


def test_raw_heads_bring_their_losses_and_frozen_policies_none(raw_metrics) -> None:
    plain, headed, frozen = raw_metrics({})[0], raw_metrics(HEADS)[0], raw_metrics({'policy_init': 'frozen'})[0]
    assert set(headed) - set(plain) == {'loss/reward', 'loss/continue'}
    assert set(raw_metrics({'raw_heads': ('reward',)})[0]) - set(plain) == {'loss/reward'}
    assert not any(name.startswith('policy/') or name in ('loss/actor', 'loss/distill') for name in frozen)


@pytest.mark.parametrize(
    ('switch', 'changed', 'when'),
    [
        ({'free_nats': 50.0}, 'loss/dyn', AT_ONCE),
        ({'mask_weights': {'road': 5.0}}, 'loss/masks', AT_ONCE),
        ({'decode_share': 0.5}, 'loss/masks', AT_ONCE),
        ({'weight_pred': 0.0}, 'loss/masks', LATER),
        ({'weight_reward': 0.0}, 'loss/reward', LATER),
        ({'weight_dyn': 0.0}, 'loss/dyn', LATER),
        ({'weight_rep': 0.0}, 'loss/rep', LATER),
        ({'entropy': 1.0}, 'loss/actor', AT_ONCE),
        ({'gamma': 0.5}, 'policy/return', AT_ONCE),
        ({'lambda_': 0.0}, 'policy/return', AT_ONCE),
        ({'horizon': 2}, 'policy/return', AT_ONCE),
        ({'slow_weight': 0.0}, 'loss/critic', AT_ONCE),
        ({'reset_policy_at': 2}, 'policy/entropy', 1),
    ],
)
def test_a_stage_1_switch_changes_its_loss(batch, switch, changed, when) -> None:
    def metrics(overrides) -> list[dict[str, float]]:
        settings = {'warmup': 1, 'policy_after': 0, 'policy_every': 1, 'free_nats': 0.1, 'model_lr': 3e-3}
        trainer = PrivilegedTrainer(make_config('nano', settings | overrides))
        return [trainer.step(batch) for _ in range(STEPS)]

    assert metrics(switch)[when][changed] != metrics({})[when][changed]


@pytest.mark.parametrize('heads', [(), ('reward',), ('continue',)])
def test_without_head_guidance_the_raw_model_needs_both_heads(heads) -> None:
    with pytest.raises(ConfigError, match=r'head_guidance=false needs raw_heads=\[reward,continue\]'):
        make_config('nano', {'head_guidance': False, 'raw_heads': heads})


def test_the_old_switch_share_means_rssm_and_decoder() -> None:
    assert (TrainConfig(share='tied').share_rssm, TrainConfig(share='tied').share_decoder) == ('tied', 'tied')
    stored = make_config('nano').model_dump(mode='json')
    stored['train'] = {k: v for k, v in stored['train'].items() if not k.startswith('share_')} | {'share': 'none'}
    assert RunConfig(**stored).train.share_decoder == 'none'
    with pytest.raises(ConfigError, match='share_rssm'):
        make_config('nano', {'share': 'everything'})


def agreement(rssm, source, seed) -> tuple[float, float]:
    """(share of groups in which both streams drew the same class, share expected of two unrelated draws)."""
    torch.manual_seed(seed)
    c, b, t = rssm.config, 16, 8
    embed = torch.randn(b, t, c.grid_features * c.grid**2 + c.vector_features)
    actions = torch.zeros(b, t, rssm.input_action.linear.weight.shape[-1])
    first = torch.zeros(b, t, dtype=torch.bool)
    uniforms = [torch.rand(b, t, c.stoch) for _ in range(2)]
    own = uniforms[1] if source == 'independent' else None
    with torch.no_grad():
        pair = observe_pair(rssm, rssm, embed, embed, actions, first, uniforms[0], source, raw_uniform=own)
    # The first step alone: later ones have different states, and so different posteriors.
    chosen = [s.stoch[:, 0].unflatten(-1, (c.stoch, c.classes)).argmax(-1) for s in (pair.raw, pair.privileged)]
    expected = pair.raw_post[:, 0].exp().square().sum(-1).mean()
    return float((chosen[0] == chosen[1]).float().mean()), float(expected)


def test_independent_sampling_is_independent(teacher_run) -> None:
    rssm = load_teacher(teacher_run).model.rssm
    found = [agreement(rssm, 'independent', seed) for seed in range(20)]
    same, expected = (sum(values) / len(values) for values in zip(*found, strict=True))
    assert same == pytest.approx(expected, abs=0.03)
    assert expected < 0.7, 'posteriors that are certain would agree anyway'
    assert agreement(rssm, 'raw', 0)[0] == 1.0
    with pytest.raises(ValueError, match='uniforms of its own'):
        observe_pair(rssm, rssm, *[torch.zeros(1, 1, 1)] * 4, torch.zeros(1, 1, 1), 'independent')


def stored_run(tmp_path, **train):
    """A run folder whose configuration has other `train` fields than today's defaults."""
    body = make_config('nano').model_dump(mode='json')
    body['train'] |= train
    (tmp_path / 'config.json').write_text(json.dumps({'config': body}))
    return tmp_path


def test_an_old_run_without_heads_is_read_as_what_it_did(tmp_path) -> None:
    assert read_run_config(stored_run(tmp_path, head_guidance=False, raw_heads=['reward'])).train.head_guidance
    assert not read_run_config(stored_run(tmp_path, head_guidance=False, **HEADS)).train.head_guidance
    with pytest.raises(CheckpointError, match=r'train\.gamma') as error:
        read_run_config(stored_run(tmp_path, gamma='much'))
    assert len(str(error.value).splitlines()) == 1


def test_what_is_said_of_one_part_counts_beside_share() -> None:
    both = make_config('nano', {'share': 'tied', 'share_decoder': 'none'}).train
    assert (both.share_rssm, both.share_decoder) == ('tied', 'none')
    later = overridden(make_config('nano', {'share_rssm': 'none'}), {'share': 'tied'}).train
    assert (later.share_rssm, later.share_decoder) == ('tied', 'tied')
