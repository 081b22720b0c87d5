"""Gradients that are written out, against autograd of the loss that they are the gradients of."""

from __future__ import annotations

from concurrent.futures import Executor, ThreadPoolExecutor

import pytest
import torch

from hts.rl.actor import log_prob
from hts.rl.kl import gaussian_kl
from hts.rl.learner import Columns, Layout, Learner
from hts.rl.mlp import MLP, Workspace
from hts.rl.population import Population, Sizes
from hts.rl.settings import UpdateSettings
from hts.rl.surrogate import population_loss

SIZES = Sizes(5, 7, 3, (8, 6))
SAMPLES = 40


def population(hidden: tuple[int, ...] = (8, 6)) -> Population:
    """Of one candidate, in double precision; its biases and its sigmas are not all the same."""
    made = Population(Sizes(5, 7, 3, hidden), 1, init_std=0.4, seed=3).double()
    with torch.no_grad():
        vector = made.vectors[0]
        vector += 0.1 * torch.randn(vector.shape, generator=torch.Generator().manual_seed(1), dtype=vector.dtype)
    return made


def batch(of: Population, with_reference: bool = True) -> dict[str, torch.Tensor]:
    """Samples [1, S] of another policy: ratios, advantages and values on both sides of both clips."""
    generator = torch.Generator().manual_seed(2)

    def normal(*shape: int) -> torch.Tensor:
        return torch.randn(1, SAMPLES, *shape, generator=generator, dtype=torch.float64)

    made = {"observation": normal(5), "critic_observation": 2.0 * normal(7)}
    with torch.no_grad():
        mean, value = (
            of.mean(made["observation"], of.named(), True),
            of.value(made["critic_observation"], of.named(), True),
        )
    old_log_std = of.log_std(of.named()).detach() + 0.1
    old_mean = mean + 0.1 * normal(3)
    action = old_mean + old_log_std.exp() * normal(3)
    made |= {
        "action": action,
        "old_mean": old_mean,
        "log_prob": log_prob(action, old_mean, old_log_std),
        "advantage": normal(),
        "old_value": value + 0.3 * normal(),
        "target": value + 0.3 * normal(),
        "old_log_std": old_log_std,
    }
    if with_reference:
        made |= {"reference_mean": mean + 0.2 * normal(3), "reference_log_std": old_log_std + 0.2}
    return made


def learnt(
    of: Population, samples: dict[str, torch.Tensor], beside: Executor | None = None, **settings
) -> tuple[torch.Tensor, dict[str, torch.Tensor]]:
    """Gradient of the first candidate in the order of its vector, and the parts of its loss."""
    layout = Layout(of)
    learner = Learner(layout, of.vectors[0].detach())
    constant = {name: value[0] for name, value in samples.items() if name.endswith("log_std")}
    columns = Columns({name: value[0] for name, value in samples.items() if name not in constant}, constant)
    (minibatch,) = columns.minibatches(torch.randperm(SAMPLES), 1)  # the order of samples says nothing
    given = {"multiplier": 0.7, "policy_on": 1.0, **settings}
    config = UpdateSettings(clip=0.2, value_coef=0.8, entropy_coef=0.03)
    with torch.no_grad():
        parts = learner.differentiate(minibatch, given["multiplier"], given["policy_on"], config, beside)
    return layout.unpacked(learner.gradient), parts


def by_autograd(of: Population, samples: dict[str, torch.Tensor], multiplier: float = 0.7, policy_on: float = 1.0):
    loss = population_loss(
        of,
        samples,
        torch.tensor([multiplier], dtype=torch.float64),
        clip=0.2,
        value_coef=0.8,
        entropy_coef=0.03,
        policy_on=policy_on,
        normalised=True,
    )
    return torch.autograd.grad(loss.total.sum(), of.vectors[0])[0], loss


@pytest.mark.parametrize("hidden", [(), (4,), (8, 6), (6, 9, 4)])
@pytest.mark.parametrize("changes", [{}, {"multiplier": 0.0}, {"policy_on": 0.0}], ids=str)
@pytest.mark.parametrize("with_reference", [True, False])
def test_the_gradient_written_out_is_that_of_the_loss(hidden, changes, with_reference):
    of = population(hidden)
    samples = batch(of, with_reference)
    gradient, parts = learnt(of, samples, **changes)
    expected, loss = by_autograd(of, samples, **changes)
    torch.testing.assert_close(gradient, expected, rtol=1e-9, atol=1e-12)
    for name, value in parts.items():
        torch.testing.assert_close(value, getattr(loss, name)[0], rtol=1e-9, atol=1e-12)


def test_a_critic_that_learns_beside_its_actor_learns_the_same():
    of = population((8, 6))
    samples = batch(of)
    torch.manual_seed(0)
    alone, parts = learnt(of, samples)
    torch.manual_seed(0)
    with ThreadPoolExecutor(1) as beside:
        together, same = learnt(of, samples, beside)
    assert torch.equal(together, alone)
    assert {name: value.item() for name, value in same.items()} == {name: one.item() for name, one in parts.items()}


def test_what_goes_wrong_beside_is_told():
    of = population((4,))
    samples = {name: value for name, value in batch(of).items() if name != "target"}
    with ThreadPoolExecutor(1) as beside, pytest.raises(KeyError, match="target"):
        learnt(of, samples, beside)


def test_the_samples_lie_on_both_sides_of_both_clips():
    of = population()
    samples = batch(of)
    with torch.no_grad():
        mean, log_std = of.mean(samples["observation"], of.named(), True), of.log_std(of.named())
        value = of.value(samples["critic_observation"], of.named(), True)
    ratio = (log_prob(samples["action"], mean, log_std) - samples["log_prob"]).exp()
    moved = value - samples["old_value"]
    better = samples["advantage"] > 0
    for region in (ratio < 0.8, (ratio > 0.8) & (ratio < 1.2), ratio > 1.2):
        assert (region & better).any() and (region & ~better).any()
    worse = (moved.clamp(-0.2, 0.2) - moved + value - samples["target"]).abs() > (value - samples["target"]).abs()
    assert (moved.abs() < 0.2).any() and ((moved.abs() > 0.2) & worse).any() and ((moved.abs() > 0.2) & ~worse).any()


def test_the_gradient_is_the_slope_of_the_loss_along_any_line():
    of = population()
    samples = batch(of)
    gradient, _ = learnt(of, samples)
    direction = torch.randn(gradient.shape, generator=torch.Generator().manual_seed(5), dtype=torch.float64)
    step, totals = 1e-6, []
    for sign in (1.0, -1.0):
        with torch.no_grad():
            of.vectors[0] += sign * step * direction
            totals.append(by_total(of, samples))
            of.vectors[0] -= sign * step * direction
    slope = (totals[0] - totals[1]) / (2 * step)
    torch.testing.assert_close(torch.dot(gradient, direction), slope, rtol=1e-5, atol=1e-7)


def by_total(of: Population, samples: dict[str, torch.Tensor]) -> torch.Tensor:
    return population_loss(
        of,
        samples,
        torch.tensor([0.7], dtype=torch.float64),
        clip=0.2,
        value_coef=0.8,
        entropy_coef=0.03,
        normalised=True,
    ).total[0]


def test_a_sample_that_is_not_a_number_is_not_hidden_by_a_clip():
    of = population()
    for name in ("advantage", "log_prob", "target", "old_value", "action", "observation", "critic_observation"):
        samples = batch(of)
        samples[name][0, 3] = torch.nan
        assert not torch.isfinite(learnt(of, samples)[0]).all(), name


def test_parameters_come_back_from_the_order_in_which_they_learn():
    of = population()
    layout, vector = Layout(of), of.vectors[0].detach()
    packed = layout.packed(vector)
    assert torch.equal(layout.unpacked(packed), vector) and not torch.equal(packed, vector)
    named, views = of.split(vector), layout.split(packed)
    assert torch.equal(views["critic.1"][:, :-1], named["critic.1.weight"])
    assert torch.equal(views["critic.1"][:, -1], named["critic.1.bias"])
    assert torch.equal(views["log_std"][:, 0], named["log_std"])


def test_a_network_in_columns_is_the_network_in_rows():
    of = population()
    named = of.split(of.vectors[0].detach())
    layers = [torch.cat((named[f"actor.{i}.weight"], named[f"actor.{i}.bias"].unsqueeze(1)), 1) for i in range(3)]
    network = MLP(layers, [torch.empty_like(layer) for layer in layers])
    x = torch.randn(9, 5, dtype=torch.float64)
    columns = torch.cat((x, x.new_ones(9, 1)), 1).t()
    y = network.forward(columns, Workspace((8, 6), 9, x))
    torch.testing.assert_close(y.t(), of.mean(x.unsqueeze(0), of.named(), True)[0].detach())


def test_minibatches_hold_the_samples_in_the_order_asked_for():
    samples = {
        "observation": torch.arange(12.0).view(6, 2),
        "critic_observation": torch.zeros(6, 1),
        "advantage": torch.arange(6.0),
    }
    columns = Columns(samples, {"old_log_std": torch.tensor([[3.0, 4.0]])})
    first, second = columns.minibatches(torch.tensor([5, 0, 3, 1, 2, 4]), 2)
    assert first["advantage"].tolist() == [5.0, 0.0, 3.0] and second["advantage"].tolist() == [1.0, 2.0, 4.0]
    assert first["observation"].tolist() == [[10.0, 0.0, 6.0], [11.0, 1.0, 7.0], [1.0, 1.0, 1.0]]
    assert first["old_log_std"].tolist() == [[3.0], [4.0]]


def test_kl_to_the_old_policy_is_the_one_that_the_loss_reports():
    of = population()
    samples = batch(of)
    _, parts = learnt(of, samples)
    with torch.no_grad():
        mean = of.mean(samples["observation"], of.named(), True)
        expected = gaussian_kl(samples["old_mean"], samples["old_log_std"], mean, of.log_std(of.named())).mean()
    torch.testing.assert_close(parts["kl_old"], expected)
