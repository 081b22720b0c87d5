"""The page's table of distributions: for each of them the KL is what its row says."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
import tensordict.nn as tensordict_nn
import torch
from torch import distributions as D
from torchrl import modules

from hts.rl import distribution_kl
from hts.rl.entropy import entropy_of

PAGE = Path(__file__).parents[2] / "docs" / "rl.md"
KINDS = {
    "Normal": lambda x: D.Normal(x, x),
    "Laplace": lambda x: D.Laplace(x, x),
    "Beta": lambda x: D.Beta(x, 1.5),
    "Gamma": lambda x: D.Gamma(x, 1.5),
    "Dirichlet": D.Dirichlet,
    "Gumbel": lambda x: D.Gumbel(x, x),
    "ContinuousBernoulli": lambda x: D.ContinuousBernoulli(logits=x),
    "MultivariateNormal": lambda x: D.MultivariateNormal(x, torch.eye(2)),
    "LowRankMultivariateNormal": lambda x: D.LowRankMultivariateNormal(x, torch.ones(2, 1), x),
    "Bernoulli": lambda x: D.Bernoulli(logits=x),
    "Binomial": lambda x: D.Binomial(3, logits=x),
    "Poisson": D.Poisson,
    "Geometric": lambda x: D.Geometric(logits=x),
    "Categorical": lambda x: D.Categorical(logits=x),
    "OneHotCategorical": lambda x: D.OneHotCategorical(logits=x),
    "MaskedCategorical": lambda x: modules.MaskedCategorical(logits=x, mask=x > 0),
    "MaskedOneHotCategorical": lambda x: modules.MaskedOneHotCategorical(logits=x, mask=x > 0),
    "Ordinal": lambda x: modules.Ordinal(scores=x),
    "OneHotOrdinal": lambda x: modules.OneHotOrdinal(scores=x),
    "TanhNormal": lambda x: modules.TanhNormal(x, x),
    "LogNormal": lambda x: D.LogNormal(x, x),
    "LogisticNormal": lambda x: D.LogisticNormal(x, x),
    "TransformedDistribution": lambda x: D.TransformedDistribution(D.Beta(x, 1.5), [D.AffineTransform(-1.0, 2.0)]),
    "TruncatedNormal": lambda x: modules.TruncatedNormal(x, x),
    "StudentT": lambda x: D.StudentT(4.0, x, x),
    "Kumaraswamy": lambda x: D.Kumaraswamy(x, x),
    "Weibull": lambda x: D.Weibull(x, x),
    "RelaxedBernoulli": lambda x: D.RelaxedBernoulli(torch.tensor(0.7), logits=x),
    "RelaxedOneHotCategorical": lambda x: D.RelaxedOneHotCategorical(torch.tensor(0.7), logits=x),
    "MixtureSameFamily": lambda x: D.MixtureSameFamily(D.Categorical(logits=x), D.Normal(x, x)),
    "VonMises": lambda x: D.VonMises(x, x),
    "Multinomial": lambda x: D.Multinomial(3, logits=x),
    "NegativeBinomial": lambda x: D.NegativeBinomial(3, logits=x),
}


def given_by_the_policy(x: torch.Tensor) -> D.Distribution:
    return D.TransformedDistribution(D.Normal(torch.zeros_like(x), 1.0), [D.AffineTransform(x, x)])


def rows() -> list[list[str]]:
    """The names of each row's distributions, from the page."""
    section = PAGE.read_text().split("### Which distributions")[1].split("\n#")[0]
    lines = [line for line in section.splitlines() if line.startswith("| `")]
    return [re.findall(r"`(\w+)`", line.split("|")[1]) for line in lines]


def kl_twice(make) -> tuple[torch.Tensor, torch.Tensor]:
    first, second = torch.tensor([[0.6, 0.9]] * 4), torch.tensor([[0.8, 0.7]] * 4)
    policy, reference = make(first), make(second)
    return distribution_kl(policy, reference), distribution_kl(policy, reference)


def test_the_page_names_what_is_tested_here():
    named = [name for row in rows() for name in row]
    assert len(rows()) == 4 and set(named) == set(KINDS)


@pytest.mark.parametrize("name", KINDS)
def test_the_kl_is_a_formula_an_estimate_or_refused_as_the_page_says(name):
    torch.manual_seed(0)
    row = next(index for index, names in enumerate(rows()) if name in names)
    if row == 3:
        with pytest.raises(NotImplementedError, match=rf"no formula of KL\({name} .*has no rsample"):
            kl_twice(KINDS[name])
        return
    one, again = kl_twice(KINDS[name])
    assert one.isfinite().all() and one.any() and torch.equal(one, again) == (row < 2)
    if name != "Poisson":
        policy = KINDS[name](torch.full((4, 2), 0.6))
        assert entropy_of(policy, torch.zeros(policy.batch_shape)).isfinite().all()


def test_a_transform_that_the_policy_gives_and_the_one_hot_choices_of_others_are_as_the_page_says():
    one, again = kl_twice(given_by_the_policy)
    assert one.isfinite().all() and not torch.equal(one, again)
    for kind in (modules.OneHotCategorical, tensordict_nn.distributions.OneHotCategorical):
        one, expected = (kl_twice(lambda x, made=made: made(logits=x))[0] for made in (kind, D.OneHotCategorical))
        torch.testing.assert_close(one, expected)
