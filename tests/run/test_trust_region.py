"""How far candidates may go next, by how well promises were kept."""

from __future__ import annotations

import json
import math

import numpy as np
import pytest

from hts.config import TrustRegionConfig
from hts.run.trust_region import (
    Tried,
    agreement,
    by_all,
    next_scale,
    scaled,
    tried_elites,
)

CONFIG = TrustRegionConfig(enabled=True)
C = (1.0,)


def elite(predicted, measured, half=0.01, kl=1.0, bound=1.0, fell=False, name="00-00"):
    return Tried(name, predicted, measured, half, kl, bound, fell)


def test_kept_promises_widen_the_bound_and_broken_ones_narrow_it():
    kept = [elite(0.20, 0.19), elite(0.10, 0.095), elite(0.15, 0.14)]
    assert next_scale(1.0, kept, CONFIG, C)[0] == 4.0
    mostly = [elite(0.20, 0.144), elite(0.10, 0.072), elite(0.15, 0.108)]
    assert next_scale(1.0, mostly, CONFIG, C)[0] == 2.0
    two = [elite(0.08, 0.083), elite(0.14, 0.18)]  # two say enough where promises are usually kept to some 15 %
    assert next_scale(1.0, two, CONFIG, C)[0] == 4.0
    broken = [elite(0.20, 0.02), elite(0.10, 0.01), elite(0.15, 0.01)]
    assert next_scale(2.0, broken, CONFIG, C)[0] == 1.0


def test_what_cannot_be_told_changes_nothing():
    scattered = [elite(0.20, 0.30), elite(0.10, -0.05), elite(0.15, 0.05)]
    assert next_scale(1.0, scattered, CONFIG, C)[0] == 1.0
    noisy = [elite(0.05, 0.05, half=0.2), elite(0.05, 0.05, half=0.2)]
    assert next_scale(1.0, noisy, CONFIG, C)[0] == 1.0
    assert next_scale(1.0, [], CONFIG, C) == (1.0, "nothing to judge by")


def test_a_fall_narrows_the_bound_whatever_was_saved():
    assert next_scale(1.0, [elite(0.2, 0.2), elite(0.2, 0.2, fell=True)], CONFIG, C)[0] == 0.5


@pytest.mark.parametrize("bounds", [(16.0,), (3.0, 10.0), (16.0, math.inf), (50.0,), (0.01,)])
def test_a_fall_narrows_every_bound_however_far_they_had_grown(bounds):
    kept, fell = [elite(0.20, 0.19, kl=c, bound=c) for c in bounds], [elite(0.2, 0.2, fell=True)]
    scale = 1.0
    for _ in range(4):
        scale, _ = next_scale(scale, kept, CONFIG, bounds)
    widest = scaled(bounds, scale, CONFIG)
    narrowed = scaled(bounds, next_scale(scale, fell, CONFIG, bounds)[0], CONFIG)
    for c, before, after in zip(bounds, widest, narrowed, strict=True):
        assert math.isinf(c) or after == max(CONFIG.least, before / 2)


def test_a_bound_at_its_lower_limit_grows_at_once_when_promises_are_kept():
    scale, bounds = 1.0, (0.2,)
    for _ in range(6):
        scale, _ = next_scale(scale, [elite(0.2, 0.0, fell=True)], CONFIG, bounds)
    assert scaled(bounds, scale, CONFIG) == (CONFIG.least,)
    scale, _ = next_scale(scale, [elite(0.2, 0.19)] * 3, CONFIG, bounds)
    assert scaled(bounds, scale, CONFIG) == (pytest.approx(4 * CONFIG.least),)


def test_a_bound_that_held_nobody_back_is_not_widened():
    slack = [elite(0.20, 0.20, kl=0.2), elite(0.10, 0.10, kl=0.3), elite(0.1, 0.1, kl=3.0, bound=math.inf)]
    assert next_scale(1.0, slack, CONFIG, C)[0] == 1.0


def test_bounds_stay_within_limits_and_infinity_stays():
    config = TrustRegionConfig(enabled=True, least=0.1, most=8.0)
    assert scaled((0.2, 1.0, 5.0, math.inf), 2.0, config) == (0.4, 2.0, 8.0, math.inf)
    assert scaled((0.2, 1.0), 0.1, config) == (0.1, 0.1)
    assert scaled((50.0,), 2.0, TrustRegionConfig()) == (50.0,)


def share_held(kept, scatter, count, trials):
    """How often the interval holds the truth, where elites keep so much of their promise but for a scatter, as a share
    of it; each is measured with an error of 0.01."""
    rng, hits = np.random.default_rng(0), 0
    for _ in range(trials):
        promised = rng.uniform(0.1, 0.3, count)
        measured = promised * (kept + scatter * rng.standard_normal(count)) + 0.01 * rng.standard_normal(count)
        low, high = agreement([elite(p, m, half=1.96 * 0.01) for p, m in zip(promised, measured, strict=True)]).interval
        hits += low <= kept <= high
    return hits / trials


@pytest.mark.parametrize(
    ("scatter", "count", "least"), [(0.0, 3, 0.97), (0.15, 2, 0.93), (0.15, 5, 0.93), (0.3, 6, 0.86)]
)
def test_the_interval_of_rho_holds_the_truth_as_often_as_it_says(scatter, count, least):
    """Where elites scatter twice as much as the prior says, an interval called 95 % holds it in 89 of 100 cases."""
    assert share_held(0.8, scatter, count, trials=400) >= least


@pytest.mark.parametrize(
    ("scatter", "count", "holds"),
    [(0.15, 2, 0.98), (0.15, 3, 0.98), (0.15, 6, 0.97), (0.4, 2, 0.77), (0.4, 3, 0.82), (0.4, 6, 0.87)],
)
def test_the_interval_of_rho_is_as_honest_as_its_prior(scatter, count, holds):
    """The prior says 0.15. These are the figures of docs/decisions.md."""
    assert share_held(0.9, scatter, count, trials=2000) == pytest.approx(holds, abs=0.02)


def test_elites_that_were_to_save_nothing_and_lost_much_narrow_the_bound():
    lost = [elite(-0.01, -0.30, half=0.02)] * 3
    assert agreement(lost).interval is None  # of a ratio nothing can be said
    why = "none was predicted in sum, and measured ones are below the predicted ones"
    assert next_scale(1.0, lost, CONFIG, C) == (0.5, why)
    mixed = [elite(0.20, -0.30, half=0.02), elite(-0.21, -0.30, half=0.02)]
    assert next_scale(1.0, mixed, CONFIG, C) == (0.5, why)
    assert next_scale(1.0, [elite(0.0, -0.1, half=0.02)], CONFIG, C)[0] == 0.5


@pytest.mark.parametrize(
    "tried", [[elite(-0.10, -0.10)] * 3, [elite(-0.01, 0.10)] * 3, [elite(0.20, 0.02), elite(-0.25, 0.0)]]
)
def test_elites_that_were_to_save_nothing_and_kept_to_it_or_did_better_move_no_bound(tried):
    assert next_scale(1.0, tried, CONFIG, C) == (1.0, "nothing to judge by")


def test_a_bound_that_grows_says_whether_the_prediction_held_or_was_surpassed():
    held, surpassed = [elite(0.10, 0.10)] * 3, [elite(0.10, 0.30)] * 3
    assert next_scale(1.0, held, CONFIG, C) == (4.0, "the prediction held, and the bound held candidates back")
    assert next_scale(1.0, surpassed, CONFIG, C) == (
        4.0,
        "more was saved than predicted, and the bound held candidates back",
    )


def entry(improvement, width=0.02):
    return {"improvement": improvement, "improvement_ci95": [improvement - width, improvement + width]}


def test_elites_are_read_from_a_run():
    candidates = {
        name: {
            "kl": 0.9,
            "kl_bound": 1.0,
            "predicted": {"power": {"0.5": {"improvement": 0.2}, "0.8": {"improvement": 0.1}}},
        }
        for name in ("a", "b", "c", "d", "e", "f")
    }
    candidates["d"]["predicted"] = {}
    candidates["f"] |= {"kl": None, "kl_bound": None}  # as JSON has NaN and infinity
    results = {
        "a": {"real": {"power": {"0.8": entry(0.08)}}, "tested": {"fell": False}},
        "b": {"real": None, "refused": "it fell", "refusal": {"falls": 2, "speed": 0.8}},
        "c": {"real": None, "refused": "it walked too slowly", "refusal": {"falls": 0, "speed": 0.8}},
        "d": {"real": {"power": {"0.8": entry(0.08)}}, "tested": {"fell": False}},
        "e": {"real": None, "refused": "the reference policy cannot be held"},
        "f": {"real": None, "refused": "the reference policy cannot be held", "refused_falls": {"0.5": 1}},
    }
    candidates, results = (json.loads(json.dumps(one, allow_nan=False)) for one in (candidates, results))
    first, second, third, last = tried_elites("power", candidates, results)
    assert (last.id, last.fell, last.kl_bound, last.active) == ("f", True, math.inf, False)
    assert next_scale(1.0, [first, last], CONFIG, C) == (0.5, "an elite fell")
    assert (first.id, first.predicted, first.measured) == ("a", 0.1, 0.08)
    assert first.half_width == pytest.approx(0.02)
    assert (second.id, second.measured, second.fell) == ("b", 0.0, True)
    assert (third.id, third.measured, third.fell) == ("c", 0.0, False) and third.predicted == pytest.approx(0.15)
    assert first.active


def test_what_an_elite_kept_is_the_mean_over_speeds_and_its_error_that_of_a_mean():
    candidate = made({"power": 1.0}) | {
        "predicted": {"power": {"0.5": {"improvement": 0.1}, "0.8": {"improvement": 0.4}}}
    }
    real = {"real": {"power": {"0.5": entry(0.2, width=0.03), "0.8": entry(0.3, width=0.04)}}}
    (tried,) = tried_elites("power", {"a": candidate}, {"a": real})
    assert (tried.predicted, tried.measured) == pytest.approx((0.25, 0.25))
    assert tried.half_width == pytest.approx(math.hypot(0.03, 0.04) / 2)


def test_the_interval_of_rho_is_as_on_paper():
    """Two elites of 0.2 and 0.1 that kept 0.12 and 0.09, each with an error of 0.01: both miss rho by 0.02. With the
    prior of four at 15 %, scatter² is (4 · 0.15² · 0.05 + 2 · 2 · 0.02²) / 5 = 0.00122, with both errors 0.00142; t of
    5 degrees is 2.571, and 2.571 · √0.00142 / 0.3 = 0.323."""
    found = agreement([elite(0.2, 0.12, half=1.96 * 0.01), elite(0.1, 0.09, half=1.96 * 0.01)])
    assert found.rho == pytest.approx(0.7) and found.interval == pytest.approx((0.7 - 0.323, 0.7 + 0.323), abs=5e-4)


def made(weights, **predicted):
    """A candidate of one speed: λ of each objective, and what was promised of it."""
    promises = {name: {"0.8": {"improvement": value}} for name, value in predicted.items()}
    return {"kl": 0.9, "kl_bound": 1.0, "weights": weights, "predicted": promises}


def found(**measured):
    return {"real": {name: {"0.8": entry(value)} for name, value in measured.items()}, "tested": {"fell": False}}


def test_a_fall_narrows_the_bounds_also_where_nothing_was_promised():
    fell = {"real": {"power": {"0.8": entry(0.1)}}, "tested": {"fell": True}}
    (tried,) = tried_elites("power", {"a": made({"power": 1.0})}, {"a": fell})
    assert (tried.predicted, tried.measured, tried.fell) == (0.0, 0.0, True)
    assert next_scale(1.0, [tried], CONFIG, C) == (0.5, "an elite fell")


def test_what_was_measured_without_an_interval_is_not_taken_for_exact():
    bare = {"improvement": 0.2, "improvement_ci95": None}
    candidates = {"a": made({"power": 1.0}, power=0.2)}
    lone = {"real": {"power": {"0.8": bare}}, "tested": {"fell": False}}
    assert tried_elites("power", candidates, {"a": lone}) == []
    candidates["a"]["predicted"]["power"]["0.5"] = {"improvement": 0.1}
    both = {"real": {"power": {"0.8": bare, "0.5": entry(0.08)}}, "tested": {"fell": False}}
    (tried,) = tried_elites("power", candidates, {"a": both})
    assert (tried.predicted, tried.measured) == (0.1, 0.08) and tried.half_width == pytest.approx(0.02)


def test_who_promised_a_loss_and_was_refused_speaks_for_no_promise():
    refused = {"real": None, "refused": "it walked too slowly", "refusal": {"falls": 0, "speed": 0.8}}
    (tried,) = tried_elites("power", {"a": made({"power": 1.0}, power=-0.1)}, {"a": refused})
    assert tried.predicted == tried.measured == pytest.approx(-0.1)


def test_of_several_objectives_each_judges_its_own_candidates_and_the_most_cautious_counts():
    candidates = {
        "a": made({"power": 1.0, "noise": 0.0}, power=0.2, noise=-1.0),
        "b": made({"power": 1.0, "noise": 0.0}, power=0.2, noise=-1.0),
        "c": made({"power": 0.0, "noise": 1.0}, power=-0.1, noise=5.0),
        "d": made({"power": 0.0, "noise": 1.0}, power=-0.1, noise=5.0),
    }
    kept = {"a": found(power=0.2, noise=0.0), "b": found(power=0.2, noise=0.0)}
    both = ["power", "noise"]
    alone = by_all(1.0, ["power"], candidates, kept, CONFIG, C)
    assert by_all(1.0, both, candidates, kept, CONFIG, C) == alone and alone[0] == 2.0  # noise has nobody to judge by
    good = kept | {"c": found(power=-0.04, noise=5.0), "d": found(power=-0.04, noise=5.0)}
    assert by_all(1.0, both, candidates, good, CONFIG, C)[0] == 2.0
    bad = kept | {"c": found(power=-0.04, noise=0.1), "d": found(power=-0.04, noise=0.1)}
    scale, why, agreed = by_all(1.0, both, candidates, bad, CONFIG, C)
    assert (scale, why) == (0.5, "measured improvements are under 0.5 of the predicted ones")
    assert agreed.rho == pytest.approx(0.02)
    assert by_all(1.0, both, candidates, {}, CONFIG, C)[:2] == (1.0, "nothing to judge by")
