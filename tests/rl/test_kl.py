"""The KL divergence of two distributions of actions, beside integrals and torch's own."""

from __future__ import annotations

import pytest
import torch
from tensordict import TensorDict
from tensordict.nn import CompositeDistribution, TensorDictModule, set_composite_lp_aggregate
from torch import nn
from torch.distributions import (
    AffineTransform,
    Beta,
    Categorical,
    Independent,
    MixtureSameFamily,
    MultivariateNormal,
    Normal,
    StudentT,
    TransformedDistribution,
    VonMises,
)
from torchrl.modules import (
    IndependentNormal,
    NormalParamExtractor,
    ProbabilisticActor,
    TanhNormal,
    TruncatedNormal,
    ValueOperator,
)

from hts.rl import KLConstrainedPPOLoss, gaussian_kl
from hts.rl.kl import distribution_kl, kl_of


def test_squashing_changes_no_kl():
    loc, other = torch.randn(2, 5, 3)
    scale, wide = torch.full((5, 3), 0.4), torch.full((5, 3), 0.7)
    squashed = distribution_kl(TanhNormal(loc, scale), TanhNormal(other, wide))
    torch.testing.assert_close(squashed, gaussian_kl(loc, scale.log(), other, wide.log()))
    plain = distribution_kl(IndependentNormal(loc, scale), IndependentNormal(other, wide))
    torch.testing.assert_close(plain, squashed)


def test_squashing_to_other_limits_changes_the_kl():
    torch.manual_seed(0)
    loc, scale = torch.zeros(50_000, 2), torch.full((50_000, 2), 0.3)
    policy, reference = TanhNormal(loc, scale), TanhNormal(loc, scale, low=-2.0, high=2.0)
    # In the reference's y = 2 tanh(x), an action a of the policy is x = atanh(a / 2).
    x = torch.linspace(-2.0, 2.0, 4001)
    base = Normal(0.0, 0.3)
    density = base.log_prob(x) - (1 - x.tanh().square()).log()
    back = (x.tanh() / 2).atanh()
    there = base.log_prob(back) - (2 * (1 - back.tanh().square())).log()
    expected = 2 * float((base.log_prob(x).exp() * (density - there)).sum() * (x[1] - x[0]))
    assert expected > 0.5
    assert float(distribution_kl(policy, reference).mean()) == pytest.approx(expected, rel=0.02)
    same = distribution_kl(reference, TanhNormal(loc, 2 * scale, low=-2.0, high=2.0))
    torch.testing.assert_close(same, gaussian_kl(loc, scale.log(), loc, (2 * scale).log()))


def test_actions_that_are_shifted_otherwise_have_the_kl_of_their_own_scale():
    torch.manual_seed(0)
    base = Normal(torch.zeros(50_000, 1), 1.0)
    policy, reference = (
        Independent(TransformedDistribution(base, [AffineTransform(shift, 1.0)]), 1) for shift in (0.0, 3.0)
    )
    assert float(distribution_kl(policy, reference).mean()) == pytest.approx(4.5, rel=0.02)  # 3^2 / 2
    assert not distribution_kl(policy, policy).any()


def test_where_no_formula_is_known_one_sample_has_the_right_mean():
    torch.manual_seed(0)
    policy = Independent(Normal(torch.zeros(50_000, 1), 0.5), 1)
    reference = Independent(StudentT(torch.full((50_000, 1), 3.0)), 1)
    x = torch.linspace(-4.0, 4.0, 4001)  # the integral of p (ln p - ln q)
    density = Normal(0.0, 0.5).log_prob(x)
    expected = float((density.exp() * (density - StudentT(3.0).log_prob(x))).sum() * (x[1] - x[0]))
    assert expected > 0.2
    assert float(distribution_kl(policy, reference).mean()) == pytest.approx(expected, rel=0.02)


def test_a_distribution_without_a_formula_or_reparametrised_samples_is_refused():
    mixture = MixtureSameFamily(Categorical(logits=torch.zeros(4, 2)), Normal(torch.zeros(4, 2), 1.0))
    said = r"^torch knows no formula of KL\(MixtureSameFamily \|\| \w+\), and MixtureSameFamily has no rsample"
    with pytest.raises(NotImplementedError, match=said):
        distribution_kl(mixture, mixture)


def test_the_kl_of_categoricals_is_torchs_and_infinite_where_the_reference_forbids_what_is_done():
    torch.manual_seed(0)
    first, second = (torch.distributions.Categorical(logits=torch.randn(5, 4)) for _ in range(2))
    torch.testing.assert_close(distribution_kl(first, second), torch.distributions.kl_divergence(first, second))
    forbidden = torch.distributions.Categorical(probs=torch.tensor([0.5, 0.5, 0.0]))
    done = torch.distributions.Categorical(probs=torch.tensor([0.2, 0.2, 0.6]))
    assert distribution_kl(done, forbidden) == float("inf") and torch.isfinite(distribution_kl(forbidden, done))


def test_a_composite_of_distributions_has_the_kl_of_one_sample():
    with set_composite_lp_aggregate(True):
        made = [
            CompositeDistribution(
                TensorDict({part: {"loc": torch.full((5, 3), shift), "scale": torch.ones(5, 3)} for part in "ab"}, [5]),
                distribution_map={part: IndependentNormal for part in "ab"},
            )
            for shift in (0.0, 0.1)
        ]
        assert distribution_kl(*made).shape == (5,)
        assert distribution_kl(made[1], made[1]).tolist() == [0.0] * 5
        torch.manual_seed(0)
        found = torch.stack([distribution_kl(*made) for _ in range(4000)]).mean()
    assert float(found) == pytest.approx(6 * 0.1**2 / 2, abs=0.005)  # two parts of three; standard error 0.0017


def test_a_reference_within_limits_is_none_of_a_policy_without_any():
    free, squashed = (kind(torch.zeros(4, 2), torch.ones(4, 2)) for kind in (IndependentNormal, TanhNormal))
    doubled = TanhNormal(torch.zeros(4, 2), torch.ones(4, 2), low=-2.0, high=2.0)
    beta = Independent(Beta(torch.ones(4, 2), torch.ones(4, 2)), 1)
    for reference in (squashed, doubled, beta):
        with pytest.raises(ValueError, match=r"^KL\(IndependentNormal \|\| \w+\) is infinite: the policy's actions"):
            distribution_kl(free, reference)
        assert torch.isfinite(distribution_kl(reference, free)).all()  # the other way round it is finite
    several = MultivariateNormal(torch.zeros(4, 2), torch.eye(2))
    assert torch.isfinite(distribution_kl(several, free)).all() and torch.isfinite(distribution_kl(free, several)).all()


def loss_and_batch(count, distribution, **how) -> tuple[KLConstrainedPPOLoss, TensorDict, torch.Tensor]:
    """The loss of a small actor that acted in `count` states, its batch, and the bias of the actor's two means and two
    sigmas."""
    torch.manual_seed(0)
    head = TensorDictModule(nn.Sequential(nn.Linear(3, 4), NormalParamExtractor()), ["observation"], ["loc", "scale"])
    how |= {"distribution_class": distribution, "return_log_prob": True}
    actor = ProbabilisticActor(head, in_keys=["loc", "scale"], **how)
    loss = KLConstrainedPPOLoss(actor, ValueOperator(nn.Linear(3, 1), in_keys=["observation"]))
    sizes = {"observation": 3, "advantage": 1, "value_target": 1}
    data = TensorDict({name: torch.randn(count, size) for name, size in sizes.items()}, [count])
    with torch.no_grad():
        loss.critic_network(actor(data))
    return loss, data, head.module[0].bias


@pytest.mark.filterwarnings("ignore:.*should not be instantiated:DeprecationWarning")  # torch of TorchRL's tanh
def test_a_loss_of_actions_within_an_envs_limits_is_compiled_as_a_whole():
    limits = {"low": torch.tensor([-2.0, 0.0]), "high": torch.tensor([2.0, 3.0])}  # others than -1 and 1
    loss, data, bias = loss_and_batch(8, TanhNormal, distribution_kwargs=limits)
    with torch.no_grad():
        bias.add_(0.3)
    expected = loss(data)  # once before, as the page says
    found = torch.compile(loss, backend="eager", fullgraph=True)(data)
    assert float(found["kl"]) > 0.01
    torch.testing.assert_close(found["kl"], expected["kl"])


def scaled_by_the_policy(loc, scale):
    base = Independent(Normal(torch.zeros_like(loc), 1.0), 1)
    return TransformedDistribution(base, [AffineTransform(loc, scale, event_dim=1)])


def test_a_bijection_that_is_learned_has_a_kl_in_compiled_code_too():
    loss, data, bias = loss_and_batch(2000, scaled_by_the_policy)
    loss(data)  # policy and reference are the same here
    with torch.no_grad():
        bias[:2] += 0.3
    found = torch.compile(loss, backend="eager", fullgraph=True)(data)
    sigma = loss.reference.get_dist(data).transforms[0].scale
    assert float(found["kl"]) == pytest.approx(float((0.3 / sigma).square().sum(-1).mean() / 2), rel=0.1)


def test_multivariate_normals_have_their_kl_in_compiled_code():
    def asked(loc):
        policy, reference = (MultivariateNormal(mean, torch.eye(3)) for mean in (loc, torch.zeros(3)))
        return kl_of(policy, reference, False) + 1.0

    found = torch.compile(asked, backend="eager")(torch.ones(5, 3))
    torch.testing.assert_close(found, torch.full((5,), 2.5))


@pytest.mark.parametrize("kind", [TanhNormal, TruncatedNormal])
def test_a_reference_within_narrower_limits_is_none(kind):
    loc, scale = torch.zeros(4, 2), torch.ones(4, 2)
    narrow, wide = kind(loc, scale), kind(loc, scale, high=torch.tensor([1.0, 3.0]))
    with pytest.raises(ValueError, match=r"is infinite: the policy's actions go to 3, its reference's to 1\. Expected"):
        distribution_kl(wide, narrow)
    assert torch.isfinite(distribution_kl(narrow, wide)).all()


def test_limits_that_are_learned_are_not_compared():
    def scaled(low, width):
        return TransformedDistribution(Beta(2 * torch.ones(4, 1), 2.0), [AffineTransform(low, width)])

    low, width = torch.zeros(4, 1, requires_grad=True), torch.ones(4, 1)
    assert distribution_kl(scaled(low, width), scaled(low.detach(), width)).tolist() == [[0.0]] * 4


def test_what_lacks_a_formula_is_called_by_its_own_name():
    ring = Independent(VonMises(torch.zeros(4, 2), torch.ones(4, 2)), 1)
    with pytest.raises(NotImplementedError, match=r"^torch knows no formula of KL\(VonMises \|\| VonMises\)"):
        distribution_kl(ring, ring)
