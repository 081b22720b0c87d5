"""A task whose best policy under the bound is known on paper: does a stock TorchRL loop with our loss find it?

States are drawn anew at every step, so an action changes nothing but its own reward r = w(s) · a. The reference is
N(0, σ² I). A shift δ(s) of the mean costs |δ|² / 2σ² nats and pays w·δ; widening σ costs and pays nothing. So

    max E[w·δ]  subject to  E[|δ|²] / 2σ² ≤ c     has     δ(s) = w(s) σ sqrt(2c / E|w|²),  E[w·δ] = σ sqrt(2c E|w|²),

with the KL at c: it must be spent where it pays, and all of it.
"""

from __future__ import annotations

import functools

import pytest
import torch
from torchrl.objectives.value import GAE
from walk_env import CPU, Walk

from hts.rl import (
    KLConstrainedPPOLoss,
    Population,
    PopulationActor,
    PopulationCollector,
    PopulationCritic,
    PopulationRandom,
    Sizes,
    gaussian_kl,
)

SIGMA, BOUNDS = 0.5, (0.05, 0.2, 1.0)
COUNT, INSTANCES, HORIZON, BATCHES = len(BOUNDS), 64, 24, 90


def slope(state: torch.Tensor) -> torch.Tensor:
    """w(s) of two actions, for states in [-1, 1]^3."""
    return torch.stack((1.0 + state[..., 0], state[..., 1] - 0.5 * state[..., 2]), -1)


class Slope(Walk):
    """r = w(s) · a in states that nobody can influence; one step in ten ends an episode."""

    def __init__(self) -> None:
        super().__init__(torch.Size((COUNT, INSTANCES)))

    def draw(self, size: int = 3) -> torch.Tensor:
        return 2.0 * self.random.uniform(INSTANCES, size) - 1.0

    def end_step(self, action):
        over = self.draw(1) > 0.8
        return (self.last, action), {"terminated": over, "truncated": torch.zeros_like(over), "done": over}

    def rewards(self, steps):
        return torch.stack([(slope(state) * action).sum(-1) for state, action in steps])


def trained(
    batches: int = BATCHES, multiplier_rate: float = 0.05, learning_rate: float = 1e-3
) -> tuple[Population, Population]:
    """A stock loop: our collector, actor and loss, TorchRL's GAE, torch's Adam. Returns policies and references."""
    torch.manual_seed(0)
    sizes = Sizes(3, 3, 2, (32,))
    start = Population(sizes, 1, init_std=SIGMA, seed=1).candidate(0)
    population = Population.from_candidates(sizes, [start] * COUNT)
    reference = population.frozen()
    actor = PopulationActor(population, PopulationRandom(range(COUNT), CPU))
    critic = PopulationCritic(population)
    loss = KLConstrainedPPOLoss(
        actor, critic, kl_bound=torch.tensor(BOUNDS), multiplier_rate=multiplier_rate, normalize_advantage=True
    )
    frames = COUNT * INSTANCES * HORIZON
    collector = PopulationCollector(Slope(), actor, frames_per_batch=frames, total_frames=batches * frames)
    advantage = GAE(gamma=0.9, lmbda=0.9, value_network=critic, vectorized=False)
    optimiser = torch.optim.Adam(loss.parameters(), lr=learning_rate)
    slower = torch.optim.lr_scheduler.LambdaLR(optimiser, lambda batch: max(0.05, 1.0 - batch / batches))
    for data in collector:
        advantage(data)
        samples = data.flatten(1, 2)  # [P, N T]
        for _ in range(4):
            for rows in torch.randperm(samples.shape[1]).chunk(4):
                parts = loss(samples[:, rows])
                optimiser.zero_grad()
                (parts["loss_objective"] + parts["loss_critic"] + parts["loss_entropy"]).sum().backward()
                optimiser.step()
        slower.step()
        loss.update_multiplier(loss.kl_to_reference(data))
    collector.shutdown()
    return population, reference


@torch.no_grad()
def measured(population: Population, reference: Population) -> tuple[list[float], list[float]]:
    """KL / c and return / optimum of each candidate, over states and not over samples of actions."""
    states = 2.0 * torch.rand(20_000, 3, generator=torch.Generator().manual_seed(9)) - 1.0
    seen, worth = states.expand(COUNT, -1, -1), slope(states)
    bounds = torch.tensor(BOUNDS)
    optimum = SIGMA * (2.0 * bounds * worth.square().sum(-1).mean()).sqrt()
    mean = population.mean(seen)
    kl = gaussian_kl(mean, population.log_std(), reference.mean(seen), reference.log_std()).mean(1)
    shift = mean - reference.mean(seen)
    return (kl / bounds).tolist(), ((worth * shift).sum(-1).mean(1) / optimum).tolist()


@functools.cache
def once() -> tuple[list[float], list[float]]:
    return measured(*trained())


def test_the_optimum_on_paper_is_the_optimum():
    """Of shifts that cost the same, the one of the formula pays most."""
    states = 2.0 * torch.rand(20_000, 3, generator=torch.Generator().manual_seed(9)) - 1.0
    worth = slope(states)

    def paid(direction):  # by a shift along it that costs 0.2 nats
        cost = direction.square().sum(-1).mean() / (2 * SIGMA**2)
        return float((worth * direction).sum(-1).mean() * (0.2 / cost).sqrt())

    best = SIGMA * float((2 * 0.2 * worth.square().sum(-1).mean()).sqrt())
    assert paid(worth) == pytest.approx(best)
    assert paid(torch.tensor([1.0, 0.0]).expand_as(worth)) < 0.8 * best  # the same shift everywhere
    assert paid(worth / worth.norm(dim=-1, keepdim=True)) < 0.98 * best  # the same cost everywhere


def test_the_kl_ends_at_the_bound_without_any_projection():
    for bound, share in zip(BOUNDS, once()[0], strict=True):
        assert 0.9 <= share <= 1.05, f"c = {bound}: KL is {share:.3f} c"


def test_the_return_is_the_best_that_the_bound_allows():
    for bound, share in zip(BOUNDS, once()[1], strict=True):
        assert 0.98 <= share <= 1.02, f"c = {bound}: return is {share:.3f} of the optimum"


def test_a_multiplier_that_stands_still_and_a_policy_that_learns_nothing_are_both_seen():
    kl, _ = measured(*trained(25, multiplier_rate=0.0))
    assert min(kl) > 1.05
    kl, paid = measured(*trained(2, learning_rate=0.0))
    assert max(kl) < 0.9 and max(paid) < 0.98
