"""A mean that is to be zero, or to stay below a number: the price that is found for it."""

from __future__ import annotations

import pytest
import torch
from tensordict import TensorDict

from hts.rl.multiplier import (
    LARGEST_ERROR,
    LARGEST_PRICE,
    EqualityMultiplier,
    LagrangeMultiplier,
    UpperMultiplier,
)


def follow(multiplier: EqualityMultiplier, pull: torch.Tensor, updates: int, strength: float = 1.0) -> torch.Tensor:
    """Errors of a learner that moves 0.2 of the way per batch to where reward and price pull it; [updates, P]."""
    error = torch.zeros_like(pull)
    rows = []
    for _ in range(updates):
        wanted = 0.01 * (pull + multiplier.update(error, strength))
        error = error + 0.2 * (wanted - error)
        rows.append(error)
    return torch.stack(rows)


def test_the_price_cancels_what_pulls_the_mean_away_whatever_its_sign():
    pull = torch.tensor([-2.0, 0.0, 4.0])
    multiplier = EqualityMultiplier(0.02, 3)
    errors = follow(multiplier, pull, 500)
    assert errors[:, [0, 2]].abs().amax(0).min() > 0.005  # it was pulled away at first
    assert errors[-1].abs().max() < 2e-4
    assert torch.allclose(multiplier.value, -pull, atol=0.05)
    assert multiplier.value[1] == 0.0


def test_a_strong_pull_is_answered_the_sooner():
    slow, fast = (follow(EqualityMultiplier(0.02, 1), torch.tensor([-8.0]), 60, s)[-1].abs() for s in (1.0, 4.0))
    assert fast < 0.3 * slow


def swung(multiplier: EqualityMultiplier, batches: int = 156) -> float:
    """Largest error of the last 30 batches of a learner that answers a price three batches later, the slower the
    closer it is to what it wants, and never by more than 0.006 a batch; each batch shows its error with noise."""
    random, error, prices, rows = torch.Generator().manual_seed(0), 0.0, [0.0] * 3, []
    for _ in range(batches):
        seen = torch.tensor(error) + 0.02 * torch.randn((), generator=random)
        prices.append(float(multiplier.update(seen, 6.0)))
        pull = prices.pop(0) - 20.0
        error += 0.006 * pull / (abs(pull) + 50.0)
        rows.append(abs(error))
    return max(rows[-30:])


def test_a_learner_of_limited_speed_is_not_swung_about():
    assert swung(EqualityMultiplier(0.02)) < 0.02
    assert swung(EqualityMultiplier(0.02, rate=0.1, gain=0.2)) > 0.04  # too little damping for so much integral


def test_one_bad_batch_cannot_spend_the_price():
    multiplier = EqualityMultiplier(0.02, rate=0.1, gain=0.5)
    multiplier.update(torch.tensor(50.0))
    assert multiplier.value == pytest.approx(-0.6 * LARGEST_ERROR)  # (0.1 + 0.5) of it


def test_one_batch_is_believed_in_part():
    multiplier = EqualityMultiplier(0.02, rate=0.0, gain=1.0, smoothing=0.25)
    first, second = (float(multiplier.update(torch.tensor(mean))) for mean in (0.02, 0.0))
    assert first == pytest.approx(-0.25) and second == pytest.approx(-0.1875)


def test_it_is_added_to_each_candidates_own_errors():
    multiplier = EqualityMultiplier(1.0, 2)
    multiplier.value = torch.tensor([2.0, -1.0])
    assert torch.equal(multiplier(torch.ones(2, 3, 4))[:, 0, 0], multiplier.value)


def test_a_scale_must_be_positive():
    with pytest.raises(ValueError, match="scale is 0"):
        EqualityMultiplier(0.0)


def kept(pull: float, updates: int = 500) -> tuple[list[float], list[float]]:
    """Means and prices of a learner that begins at 0.1, is pulled to 0.1 + 0.1 pull and is to stay below 0.3."""
    multiplier, x = UpperMultiplier(0.3), torch.tensor(0.1)
    means, prices = [], []
    for _ in range(updates):
        wanted = 0.1 + 0.1 * (pull + multiplier.update(x))
        x = x + 0.2 * (wanted - x)
        means.append(float(x))
        prices.append(float(multiplier.value))
    return means, prices


def test_a_mean_that_stays_below_its_limit_costs_nothing_and_one_above_is_kept_there():
    means, prices = kept(1.0)
    assert max(means) < 0.3 and set(prices) == {0.0}
    means, prices = kept(4.0)
    assert max(means) > 0.3 and means[-1] == pytest.approx(0.3, abs=0.003)
    assert prices[-1] == pytest.approx(-2.0, abs=0.05) and max(prices) == 0.0


def test_after_it_was_above_the_price_goes_back_to_nothing():
    multiplier = UpperMultiplier(0.3, 2)
    for _ in range(40):
        multiplier.update(torch.tensor([0.6, 0.1]))
    assert multiplier.value[0] < -4.0 and multiplier.value[1] == 0.0
    for _ in range(120):
        multiplier.update(torch.tensor([0.1, 0.1]))
    assert (multiplier.value == 0.0).all() and (multiplier.integral == 0.0).all()


def test_a_limit_that_cannot_be_kept_has_a_largest_price():
    multiplier = UpperMultiplier(0.3)
    for _ in range(500):
        multiplier.update(torch.tensor(1.0), 2.0)
    assert float(multiplier.value) == -2.0 * LARGEST_PRICE


def test_a_limit_must_be_positive():
    with pytest.raises(ValueError, match="limit is 0"):
        UpperMultiplier(0.0)


# ----------------------------------------------------------------------------------------------- of a bound on the KL


def test_a_multiplier_of_zero_adds_nothing_be_the_kl_infinite():
    multiplier = LagrangeMultiplier(torch.tensor([float("inf"), 0.5]))
    kl = torch.full((2,), float("inf"), requires_grad=True)
    added = multiplier(kl)
    assert added.tolist() == [0.0, 0.0]
    assert torch.autograd.grad(added.sum(), kl)[0].tolist() == [0.0, 0.0]
    assert multiplier.update(kl.detach()).tolist() == pytest.approx([0.0, 0.1])  # 0.05 x 2, the largest excess
    assert multiplier(torch.tensor([float("inf"), 3.0])).tolist() == pytest.approx([0.0, 0.3])


def test_a_kl_that_is_no_number_is_refused_and_changes_nothing():
    multiplier = LagrangeMultiplier(torch.tensor([0.5, 0.5]))
    multiplier.update(torch.tensor([1.0, 1.0]))
    with pytest.raises(ValueError, match=r"kl is \[1.0, nan\]: the policy, its reference or a state is not finite"):
        multiplier.update(torch.tensor([1.0, float("nan")]))
    assert multiplier.value.tolist() == pytest.approx([0.05, 0.05])


@pytest.mark.parametrize(("bounds", "kl"), [(0.5, [0.1, 2.0]), (0.5, [0.6]), ([0.5, 0.5], 3.0)])
def test_a_kl_of_another_shape_than_its_bounds_is_refused(bounds, kl):
    with pytest.raises(ValueError, match=r"kl has the shape \(.*\), kl_bound \(.*\); expected the same"):
        LagrangeMultiplier(torch.tensor(bounds)).update(torch.tensor(kl))


@pytest.mark.parametrize("given", ["a", None, TensorDict({"kl": torch.tensor(0.1)})])
def test_what_is_no_number_is_no_kl(given):
    multiplier = LagrangeMultiplier(0.5)
    with pytest.raises(TypeError, match=rf"^kl is a {type(given).__name__}; expected a tensor .*kl_to_reference"):
        multiplier.update(given)
    assert not multiplier.updated and float(multiplier.update(1.0)) == pytest.approx(0.05)
