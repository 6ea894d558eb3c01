import math

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from raw2drive_ros.world_model.actor_critic import ReturnScale, lambda_returns
from raw2drive_ros.world_model.distributions import (
    categorical_kl,
    make_bins,
    mask_loss,
    mixed_log_probs,
    sample_one_hot,
    straight_through,
    symexp,
    symlog,
    two_hot,
    two_hot_mean,
)

BINS = make_bins(255)


@given(st.floats(-1e6, 1e6))
def test_two_hot_of_x_decodes_to_x(x) -> None:
    target = torch.tensor([x], dtype=torch.float32)
    weights = two_hot(target, BINS)
    assert float(weights.sum()) == pytest.approx(1.0)
    assert float((weights * BINS).sum()) == pytest.approx(float(target), rel=1e-4, abs=1e-5)
    assert int((weights > 0).sum()) <= 2


def test_bins_are_antisymmetric_and_zero_logits_mean_zero() -> None:
    assert torch.equal(BINS, -BINS.flip(0))
    assert float(two_hot_mean(torch.zeros(255), BINS)) == 0.0


@given(st.floats(-1e4, 1e4))
def test_symlog_and_symexp_are_inverse(x) -> None:
    value = torch.tensor(x, dtype=torch.float64)
    assert float(symexp(symlog(value))) == pytest.approx(x, rel=1e-9, abs=1e-9)


def test_samples_follow_the_probabilities() -> None:
    logits = torch.log(torch.tensor([0.1, 0.2, 0.7]))
    log_probs = mixed_log_probs(logits.expand(20_000, 3), 0.0)
    generator = torch.Generator().manual_seed(0)
    share = sample_one_hot(log_probs, torch.rand(20_000, generator=generator)).mean(0)
    assert torch.allclose(share, torch.tensor([0.1, 0.2, 0.7]), atol=0.02)


def test_a_uniform_just_below_one_still_gives_one_class() -> None:
    log_probs = mixed_log_probs(torch.randn(100, 16), 0.01)
    sample = sample_one_hot(log_probs, torch.full((100,), 1.0 - 1e-7))
    assert torch.equal(sample.sum(-1), torch.ones(100))


def test_straight_through_has_the_value_of_the_sample_and_the_gradient_of_the_probabilities() -> None:
    logits = torch.randn(4, 8, requires_grad=True)
    log_probs = mixed_log_probs(logits, 0.0)
    sample = straight_through(sample_one_hot(log_probs, torch.rand(4)), log_probs)
    assert torch.equal(sample.detach().round(), sample.detach())
    (sample[:, 0].sum()).backward()
    expected = torch.autograd.grad(torch.softmax(logits, -1)[:, 0].sum(), logits)[0]
    assert torch.allclose(logits.grad, expected, atol=1e-6)


def test_kl_is_zero_for_equal_and_matches_torch() -> None:
    a, b = (mixed_log_probs(torch.randn(5, 4, 8), 0.01) for _ in range(2))
    assert torch.allclose(categorical_kl(a, a), torch.zeros(5), atol=1e-6)
    reference = torch.distributions.kl_divergence(
        torch.distributions.Categorical(logits=a), torch.distributions.Categorical(logits=b)
    ).sum(-1)
    assert torch.allclose(categorical_kl(a, b), reference, atol=1e-5)


def test_mask_loss_is_binary_cross_entropy() -> None:
    logits, masks = torch.randn(3, 2, 4, 4) * 3, (torch.rand(3, 2, 4, 4) < 0.5).float()
    reference = torch.nn.functional.binary_cross_entropy_with_logits(logits, masks, reduction='none')
    assert torch.allclose(mask_loss(logits, masks), reference.sum((1, 2, 3)), rtol=1e-4)


def test_mask_loss_has_the_gradient_of_binary_cross_entropy_at_any_logit() -> None:
    logits = (torch.randn(2, 3, 4, 4) * 20).requires_grad_()
    masks, weight = (torch.rand(2, 3, 4, 4) < 0.5).float(), torch.tensor([0.5, 2.0])
    loss = mask_loss(logits, masks)
    assert torch.isfinite(loss).all()
    (found,) = torch.autograd.grad((loss * weight).sum(), logits)
    reference = torch.nn.functional.binary_cross_entropy_with_logits(logits, masks, reduction='none').sum((1, 2, 3))
    (wanted,) = torch.autograd.grad((reference * weight).sum(), logits)
    assert torch.allclose(found, wanted, atol=1e-6)


def test_lambda_returns_by_hand() -> None:
    rewards = torch.tensor([[1.0], [2.0]])
    discounts = torch.tensor([[0.9], [0.5]])
    values = torch.tensor([[7.0], [3.0], [4.0]])
    last = 2.0 + 0.5 * 4.0
    first = 1.0 + 0.9 * (0.05 * 3.0 + 0.95 * last)
    assert torch.allclose(lambda_returns(rewards, discounts, values, 0.95), torch.tensor([[first], [last]]))


def test_a_terminal_step_cuts_the_return() -> None:
    returns = lambda_returns(torch.tensor([[-6.0]]), torch.tensor([[0.0]]), torch.tensor([[0.0], [100.0]]), 0.95)
    assert float(returns[0, 0]) == -6.0


def test_return_scale_is_never_below_one_and_grows() -> None:
    scale = ReturnScale(0.5)
    assert float(scale.follow(scale.spread(torch.zeros(100)))) == 1.0
    for _ in range(20):
        value = float(scale.follow(scale.spread(torch.linspace(0, 100, 1000))))
    assert value == pytest.approx(90, abs=1.5)
    assert math.isfinite(value)
