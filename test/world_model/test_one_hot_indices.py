"""One-hot vectors stored as indices give the same numbers as dense products, in imagination too."""

import copy

import pytest
import torch

from raw2drive_ros.contracts.actions import ACTION_COUNT
from raw2drive_ros.training.config import make_config
from raw2drive_ros.training.imagination import imagine, policy_losses, start_noise
from raw2drive_ros.training.parallel import ALONE
from raw2drive_ros.world_model import rssm as rssm_module
from raw2drive_ros.world_model.actor_critic import Policy
from raw2drive_ros.world_model.distributions import sample_classes, sample_one_hot
from raw2drive_ros.world_model.heads import ContinueHead, TwoHotHead
from raw2drive_ros.world_model.layers import Linear
from raw2drive_ros.world_model.one_hot_indices import OneHotIndices, SparseFeature, stack, worthwhile
from raw2drive_ros.world_model.rssm import Rssm, State

GROUPS, CLASSES, DETER = 6, 16, 12


def draw(*shape: int) -> torch.Tensor:
    """(..., S*K) one-hot groups."""
    logits = torch.randn(*shape, GROUPS, CLASSES)
    return sample_one_hot(torch.log_softmax(logits, -1), torch.rand(*shape, GROUPS)).flatten(-2)


@pytest.mark.parametrize('shape', [(5,), (3, 4), (2, 3, 4)])
def test_a_linear_map_and_its_gradient_are_those_of_the_dense_product(shape) -> None:
    torch.manual_seed(0)
    one_hot, deter = draw(*shape), torch.randn(*shape, DETER)
    for dense, sparse in (
        (one_hot, OneHotIndices.of(one_hot, CLASSES)),
        (torch.cat([deter, one_hot], -1), SparseFeature(deter, OneHotIndices.of(one_hot, CLASSES))),
    ):
        layer = Linear(dense.shape[-1], 7)
        torch.nn.init.normal_(layer.bias)
        results = []
        for x in (dense, sparse):
            layer.zero_grad()
            y = layer(x)
            y.square().sum().backward()
            results.append((y.detach(), layer.weight.grad.clone(), layer.bias.grad.clone()))
        for one, other in zip(*results, strict=True):
            torch.testing.assert_close(one, other, rtol=1e-5, atol=1e-5)


def test_stacked_and_sliced_like_tensors() -> None:
    torch.manual_seed(1)
    parts = [(torch.randn(4, DETER), draw(4)) for _ in range(3)]
    dense = stack([torch.cat(part, -1) for part in parts])
    sparse = stack([SparseFeature(deter, OneHotIndices.of(stoch, CLASSES)) for deter, stoch in parts])
    layer = Linear(DETER + GROUPS * CLASSES, 5)
    for where in (slice(None), slice(1, None), slice(None, -1), 0):
        torch.testing.assert_close(layer(dense[where]), layer(sparse[where]))


def test_the_same_uniforms_draw_the_same_classes() -> None:
    torch.manual_seed(2)
    log_probs = torch.log_softmax(4.0 * torch.randn(500, CLASSES), -1)
    uniform = torch.rand(500)
    uniform[:3] = torch.tensor([0.0, 0.5, 1.0 - 2**-24])
    assert torch.equal(sample_classes(log_probs, uniform), sample_one_hot(log_probs, uniform).argmax(-1))


def test_imagination_with_indices_is_that_with_dense_samples(monkeypatch) -> None:
    config = make_config('nano')
    c, t = config.model.model_copy(update={'stoch': GROUPS, 'classes': CLASSES}), config.train
    torch.manual_seed(3)
    rssm, guide = Rssm(c, 24, ACTION_COUNT), Rssm(c, 24, ACTION_COUNT)
    policy, reward, cont = Policy(c, ACTION_COUNT), TwoHotHead(c, 1), ContinueHead(c)
    for head in (policy.actor.net[-1], policy.critic.fast.net[-1], reward.net[-1]):
        torch.nn.init.normal_(head.weight)
    start = State(torch.randn(5, c.deter), draw(5))
    found = []
    assert worthwhile(CLASSES)
    for sparse in (True, False):
        monkeypatch.setattr(rssm_module, 'worthwhile', lambda classes, sparse=sparse: sparse)
        noise = start_noise(5, ALONE, torch.Generator().manual_seed(4))
        other = (guide, torch.zeros(5, c.deter))
        rollout = imagine(rssm, policy.actor, start, reward, cont, 6, noise, other, shared_sample=False)
        assert isinstance(rollout.features, SparseFeature) is sparse
        assert isinstance(rollout.teacher, SparseFeature) is sparse
        # The return scale of the policy moves with every loss.
        learner = copy.deepcopy(policy)
        actor, critic, _ = policy_losses(learner, rollout, t)
        (actor + critic).backward()
        gradients = [p.grad for p in learner.parameters() if p.grad is not None]
        found.append((rollout.actions, rollout.rewards, rollout.conts, actor.detach(), critic.detach(), *gradients))
    for one, other in zip(*found, strict=True):
        torch.testing.assert_close(one, other, rtol=2e-4, atol=1e-4)
    assert found[0][0].sum() == 5 * 6


def test_the_core_is_one_map_on_its_own_block_and_the_shared_inputs() -> None:
    c = make_config('nano').model
    torch.manual_seed(5)
    rssm = Rssm(c, 24, ACTION_COUNT)
    torch.nn.init.normal_(rssm.core_hidden.bias)
    maps, deter, inputs = rssm.plain_maps(), torch.randn(3, c.deter), torch.randn(3, 3 * c.hidden)
    blocks = deter.view(3, c.blocks, -1).transpose(0, 1)
    plain = rssm.core_hidden(torch.cat([blocks, inputs.expand(c.blocks, -1, -1)], -1)).transpose(0, 1).flatten(1)
    split = maps.core_shared(inputs) + maps.core_own(blocks).transpose(0, 1).flatten(1)
    torch.testing.assert_close(split, plain)
