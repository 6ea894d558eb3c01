"""Shared samples of rollout guidance; the recurrent model: resets, gradients, deferred weight gradients."""

import copy

import pytest
import torch

from raw2drive_ros.contracts.actions import ACTION_COUNT
from raw2drive_ros.training.config import make_config
from raw2drive_ros.training.guidance import observe_pair
from raw2drive_ros.world_model.deferred import DeferredLinear
from raw2drive_ros.world_model.rssm import Rssm

CONFIG = make_config('nano').model
EMBED = 24


def pair_of(source: str, length: int = 40):
    torch.manual_seed(0)
    privileged = Rssm(CONFIG, EMBED, ACTION_COUNT)
    raw = copy.deepcopy(privileged)
    embed = torch.randn(3, length, EMBED)
    actions = torch.nn.functional.one_hot(torch.randint(0, ACTION_COUNT, (3, length)), ACTION_COUNT).float()
    first = torch.zeros(3, length, dtype=torch.bool)
    first[:, 0] = True
    first[1, 7] = True
    uniform = torch.rand(3, length, CONFIG.stoch)
    own = torch.rand(3, length, CONFIG.stoch) if source == 'independent' else None
    return (
        observe_pair(raw, privileged, embed, embed, actions, first, uniform, source, raw_uniform=own),
        raw,
        embed,
        actions,
        first,
        uniform,
    )


def test_equal_weights_and_one_shared_sample_give_bit_equal_states() -> None:
    pair, *_ = pair_of('raw')
    assert torch.equal(pair.raw.deter, pair.privileged.deter)
    assert torch.equal(pair.raw_post, pair.privileged_post)


def test_independent_samples_drift_apart_over_time() -> None:
    pair, *_ = pair_of('independent')
    gap = (pair.raw.deter - pair.privileged.deter).detach().square().mean(-1)[[0, 2]].mean(0)
    assert float(gap[0]) == 0.0
    assert float(gap[2:6].mean()) > 0
    assert float(gap[20:].mean()) > float(gap[1:4].mean())


def test_pair_equals_the_single_stream() -> None:
    pair, raw, embed, actions, first, uniform = pair_of('raw')
    states, post = raw.observe(embed, actions, first, uniform)
    assert torch.allclose(states.deter, pair.raw.deter, atol=1e-6)
    assert torch.allclose(post, pair.raw_post, atol=1e-5)


def test_no_gradient_reaches_the_privileged_stream() -> None:
    torch.manual_seed(0)
    privileged, raw = Rssm(CONFIG, EMBED, ACTION_COUNT), Rssm(CONFIG, EMBED, ACTION_COUNT)
    embed = torch.randn(2, 5, EMBED)
    actions = torch.zeros(2, 5, ACTION_COUNT)
    first = torch.zeros(2, 5, dtype=torch.bool)
    pair = observe_pair(raw, privileged, embed, embed, actions, first, torch.rand(2, 5, CONFIG.stoch))
    (pair.raw.deter.sum() + pair.privileged.deter.sum() + pair.raw_post.sum() + pair.privileged_post.sum()).backward()
    assert all(p.grad is None for p in privileged.parameters())
    assert any(p.grad is not None and p.grad.abs().sum() > 0 for p in raw.parameters())


def test_a_first_step_forgets_everything_before_it() -> None:
    torch.manual_seed(0)
    rssm = Rssm(CONFIG, EMBED, ACTION_COUNT)
    embed = torch.randn(1, 6, EMBED)
    actions = torch.nn.functional.one_hot(torch.randint(0, ACTION_COUNT, (1, 6)), ACTION_COUNT).float()
    first = torch.tensor([[True, False, False, True, False, False]])
    uniform = torch.rand(1, 6, CONFIG.stoch)
    whole, _ = rssm.observe(embed, actions, first, uniform)
    tail, _ = rssm.observe(embed[:, 3:], actions[:, 3:], first[:, 3:], uniform[:, 3:])
    assert torch.allclose(whole.deter[:, 3:], tail.deter, atol=1e-6)


def test_deferred_weight_gradients_are_those_of_plain_autograd(monkeypatch) -> None:
    """The same loss through both, in double precision; every parameter of the recurrent model gets its gradient."""
    torch.manual_seed(0)
    rssm = Rssm(CONFIG, EMBED, ACTION_COUNT).double()
    embed = torch.randn(3, 9, EMBED, dtype=torch.float64)
    actions = torch.nn.functional.one_hot(torch.randint(0, ACTION_COUNT, (3, 9)), ACTION_COUNT).double()
    first = torch.zeros(3, 9, dtype=torch.bool)
    first[:, 0] = first[2, 4] = True
    uniform = torch.rand(3, 9, CONFIG.stoch)

    def gradients() -> dict[str, torch.Tensor]:
        rssm.zero_grad()
        states, post = rssm.observe(embed, actions, first, uniform)
        (states.feature.square().sum() + post.exp().square().sum() + rssm.prior(states.deter).sum()).backward()
        return {name: p.grad.clone() for name, p in rssm.named_parameters()}

    deferred = gradients()
    monkeypatch.setattr(Rssm, 'maps', Rssm.plain_maps)
    plain = gradients()
    assert set(deferred) == set(plain) == {name for name, _ in rssm.named_parameters()}
    for name, gradient in plain.items():
        assert gradient.abs().sum() > 0, name
        assert torch.allclose(deferred[name], gradient, rtol=1e-9, atol=1e-10), name


def test_a_loop_whose_first_step_feeds_nothing_is_refused() -> None:
    loop = DeferredLinear(torch.randn(4, 4, requires_grad=True), torch.zeros(4, requires_grad=True))
    a, b = loop(torch.randn(2, 4, requires_grad=True)), loop(torch.randn(2, 4, requires_grad=True))
    with pytest.raises(RuntimeError, match='first step'):
        a.sum().backward()
    assert b.shape == (2, 4)
