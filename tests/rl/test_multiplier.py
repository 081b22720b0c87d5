"""A mean that is to be zero: the price that is found for it."""

from __future__ import annotations

import pytest
import torch

from hts.rl.multiplier import EqualityMultiplier


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
    errors = follow(multiplier, pull, 300)
    assert errors[:, [0, 2]].abs().amax(0).min() > 0.005  # it was pulled away at first
    assert errors[-1].abs().max() < 2e-4
    assert torch.allclose(multiplier.value, -pull, atol=0.05)
    assert multiplier.value[1] == 0.0


def test_a_strong_pull_is_answered_the_sooner():
    slow, fast = (follow(EqualityMultiplier(0.02, 1), torch.tensor([-8.0]), 60, s)[-1].abs() for s in (1.0, 4.0))
    assert fast < 0.3 * slow


def test_one_bad_batch_cannot_spend_the_price():
    multiplier = EqualityMultiplier(0.02, rate=0.1, gain=0.5)
    multiplier.update(torch.tensor(50.0))
    assert multiplier.value == pytest.approx(-1.2)  # (0.1 + 0.5) x 2


def test_it_is_added_to_each_candidates_own_errors():
    multiplier = EqualityMultiplier(1.0, 2)
    multiplier.value = torch.tensor([2.0, -1.0])
    assert torch.equal(multiplier(torch.ones(2, 3, 4))[:, 0, 0], multiplier.value)


def test_a_scale_must_be_positive():
    with pytest.raises(ValueError, match="scale is 0"):
        EqualityMultiplier(0.0)
