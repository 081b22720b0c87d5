import pytest
import torch

from hts.policies.networks import Population, Sizes
from hts.policies.widen import widened


@pytest.mark.parametrize("hidden", [(8, 4), (12, 9), (16, 8, 4), (16, 8, 8, 5)])
def test_a_grown_network_computes_what_the_small_one_does(hidden):
    sizes = Sizes(5, 7, 3, (8, 4))
    small = Population(sizes, 1, seed=3)
    with torch.no_grad():
        small.vectors[0].add_(0.3 * torch.randn(small.vectors[0].shape, generator=torch.Generator().manual_seed(0)))
    large = Population.from_candidates(Sizes(5, 7, 3, hidden), [widened(small.candidate(0), sizes, hidden)])
    x, y = (torch.randn(1, 50, size, generator=torch.Generator().manual_seed(size)) for size in (5, 7))
    torch.testing.assert_close(large.mean(x), small.mean(x), atol=1e-5, rtol=1e-5)
    torch.testing.assert_close(large.value(y), small.value(y), atol=1e-5, rtol=1e-5)
    assert torch.equal(large.log_std(), small.log_std())


def test_a_network_cannot_shrink():
    sizes = Sizes(5, 7, 3, (8, 4))
    with pytest.raises(ValueError, match="cannot hold"):
        widened(Population(sizes, 1).candidate(0), sizes, (8, 3))
