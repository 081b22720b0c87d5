"""Prices of what is held: found at the end of a training, and where the next one begins."""

from __future__ import annotations

import pytest
import torch

from hts.rl.multiplier import EqualityMultiplier, UpperMultiplier
from hts.training.held import Holding, begun_at, found_prices
from hts.training.trainer import STRENGTH

HELD = Holding({"error": 0.1}, {"missed": 0.2})


def row(error: float, missed: float, strength: float) -> dict[str, float]:
    return {"held/error_multiplier": error, "held/missed_multiplier": missed, STRENGTH: strength}


def test_a_price_is_the_mean_of_the_last_quarter_per_strength():
    history = [row(100.0, -100.0, 1.0)] * 6 + [row(4.0, -2.0, 2.0), row(8.0, 0.0, 2.0)]
    assert found_prices(history, HELD) == {"error": pytest.approx(3.0), "missed": pytest.approx(-0.5)}


def test_a_history_of_before_strengths_were_kept_has_no_prices():
    assert found_prices([row(1.0, 0.0, 1.0), {"held/error_multiplier": 1.0, "held/missed_multiplier": 0.0}], HELD) == {}


def test_nothing_held_has_no_price():
    assert found_prices([{}], Holding({}, {})) == {}


def test_each_candidate_begins_where_its_anchor_ended_and_others_at_nothing():
    begun = begun_at([{"prices": {"error": 3.0}}, {}, {"prices": {"error": -1.0, "missed": -0.5}}], HELD)
    assert begun["error"].tolist() == [3.0, 0.0, -1.0] and begun["missed"].tolist() == [0.0, 0.0, -0.5]


@pytest.mark.parametrize("kind", [EqualityMultiplier, UpperMultiplier])
def test_a_balance_that_was_found_stays(kind):
    multiplier = kind(0.1, 2)
    multiplier.begin(torch.tensor([-3.0, -1.0]))
    at_balance = torch.full((2,), getattr(multiplier, "limit", 0.0))
    assert multiplier.update(at_balance).tolist() == [-3.0, -1.0]


def test_a_price_is_never_what_another_made_it():
    start = torch.tensor([1.0])
    multiplier = EqualityMultiplier(0.1, 1)
    multiplier.begin(start)
    multiplier.update(torch.tensor([0.5]))
    assert start.tolist() == [1.0]
