"""A convolution as slices and products is torch's own convolution."""

from __future__ import annotations

import pytest
import torch

from hts.measurement.convolution import as_products


@pytest.mark.parametrize(
    ("size", "weight", "how"),
    [
        ((5,), (4, 6, 3), {}),
        ((9,), (4, 6, 3), {"dilation": [4]}),
        ((9,), (4, 6, 2), {"stride": [3], "padding": [2]}),
        ((9,), (6, 1, 2), {"groups": 6}),
        ((9,), (8, 3, 2), {"groups": 2, "stride": [2], "dilation": [2], "padding": [1]}),
        ((7, 8), (4, 6, 3, 2), {"stride": [1, 2], "padding": [1, 0], "dilation": [1, 2]}),
        ((4, 5, 3), (2, 6, 2, 2, 1), {"padding": [0, 1, 0]}),
    ],
)
@pytest.mark.parametrize("biased", [True, False])
def test_it_gives_what_torch_gives(size, weight, how, biased):
    random = torch.Generator().manual_seed(0)
    inputs, kernel = torch.randn(3, 6, *size, generator=random), torch.randn(weight, generator=random)
    bias = torch.randn(weight[0], generator=random) if biased else None
    one = {"stride": [1] * len(size), "padding": [0] * len(size), "dilation": [1] * len(size), "groups": 1, **how}
    given = (one["stride"], one["padding"], one["dilation"], False, [0] * len(size), one["groups"])
    wanted = torch.ops.aten.convolution.default(inputs, kernel, bias, *given)
    torch.testing.assert_close(as_products(inputs, kernel, bias, *given), wanted, rtol=1e-5, atol=1e-5)


def test_a_sum_of_three_neighbours_by_hand():
    inputs, ones = torch.tensor([[[1.0, 2.0, 3.0, 4.0]]]), torch.ones(1, 1, 3)
    found = as_products(inputs, ones, torch.tensor([10.0]), [1], [0], [1], False, [0], 1)
    assert found.tolist() == [[[16.0, 19.0]]]  # 10 + 1 + 2 + 3, 10 + 2 + 3 + 4


def test_a_transposed_one_is_left_as_it_is():
    found = as_products(torch.ones(1, 1, 4), torch.ones(1, 1, 3), None, [1], [0], [1], True, [0], 1)
    assert found is NotImplemented
