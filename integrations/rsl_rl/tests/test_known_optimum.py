"""Inside rsl_rl's own runner the bound is met from below and spent where it pays, without any projection."""

from __future__ import annotations

import functools
import tempfile
from pathlib import Path

import pytest

pytestmark = pytest.mark.slow

BATCHES, BOUNDS = 90, (0.05, 0.2, 1.0)


@functools.cache
def trained(bound: float, batches: int = BATCHES, multiplier_rate: float = 0.05, rate: float = 1e-3):
    """KL / c and return / optimum after training, with a learning rate that falls along a line."""
    from slope import anchor_file, anchored, measured

    with tempfile.TemporaryDirectory() as folder:
        runner = anchored(anchor_file(Path(folder)), bound, multiplier_rate=multiplier_rate)
    for batch in range(batches):
        for group in runner.alg.optimizer.param_groups:
            group["lr"] = rate * max(0.05, 1.0 - batch / batches)
        runner.learn(1)
    return measured(runner, bound)


@pytest.mark.parametrize("bound", BOUNDS)
def test_the_kl_ends_at_the_bound_without_any_projection(bound):
    share = trained(bound)[0]
    assert 0.9 <= share <= 1.05, f"c = {bound}: KL is {share:.3f} c"


@pytest.mark.parametrize("bound", BOUNDS)
def test_the_return_is_the_best_that_the_bound_allows(bound):
    share = trained(bound)[1]
    assert 0.98 <= share <= 1.02, f"c = {bound}: return is {share:.3f} of the optimum"


def test_a_multiplier_that_stands_still_and_a_policy_that_learns_nothing_are_both_seen():
    assert trained(0.05, 25, multiplier_rate=0.0)[0] > 1.05
    kl, paid = trained(0.05, 2, rate=0.0)
    assert kl < 0.9 and paid < 0.98
