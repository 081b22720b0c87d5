"""No test hangs on which others its worker had before, nor on how busy a computer is."""

from __future__ import annotations

import pytest
import torch
from hypothesis import HealthCheck, settings


@pytest.mark.parametrize("again", [False, True])
def test_torchs_own_random_numbers_are_the_same_for_each_test(again):
    expected = torch.rand(3, generator=torch.Generator().manual_seed(0))
    assert torch.equal(torch.rand(3), expected)


def test_examples_are_the_same_each_time_and_may_take_their_time():
    same = settings.get_profile("same")
    assert same.derandomize and same.deadline is None and HealthCheck.too_slow in same.suppress_health_check
