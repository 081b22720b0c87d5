"""How long the bound is exceeded where rewards are large, with and without normalised advantages, and who says so.

The task of `test_known_optimum`, whose rewards are of the order of 1, with them multiplied by 1, 10 and 100: as a
script, this prints the table of docs/rl.md.
"""

from __future__ import annotations

import warnings

import pytest
import torch
from test_known_optimum import SIGMA, Slope
from torchrl.objectives.value import GAE
from walk_env import CPU

from hts.rl import (
    KLConstrainedPPOLoss,
    LagrangeMultiplier,
    Population,
    PopulationActor,
    PopulationCollector,
    PopulationCritic,
    PopulationRandom,
    Sizes,
)

SCALES = (1.0, 10.0, 100.0)  # one for each candidate of the task
BOUND = 0.05


class Scaled(Slope):
    def rewards(self, steps):
        return super().rewards(steps) * torch.tensor(SCALES).view(1, -1, 1)


def trained(batches: int, normalize: bool) -> torch.Tensor:
    """KL / c after each batch, [batches, 3], at multiplier_rate 0.05 and a learning rate of 1e-3."""
    torch.manual_seed(0)
    sizes = Sizes(3, 3, 2, (32,))
    start = Population(sizes, 1, init_std=SIGMA, seed=1).candidate(0)
    population = Population.from_candidates(sizes, [start] * len(SCALES))
    actor = PopulationActor(population, PopulationRandom([0] * len(SCALES), CPU))
    critic = PopulationCritic(population)
    loss = KLConstrainedPPOLoss(actor, critic, kl_bound=BOUND, normalize_advantage=normalize)
    env = Scaled()
    frames = env.batch_size.numel() * 24
    collector = PopulationCollector(env, actor, frames_per_batch=frames, total_frames=batches * frames)
    advantage = GAE(gamma=0.9, lmbda=0.9, value_network=critic, vectorized=False)
    optimiser = torch.optim.Adam(loss.parameters(), lr=1e-3)
    found = []
    for data in collector:
        advantage(data)
        samples = data.flatten(1, 2)
        for _ in range(4):
            for rows in torch.randperm(samples.shape[1]).chunk(4):
                parts = loss(samples[:, rows])
                optimiser.zero_grad()
                (parts["loss_objective"] + parts["loss_critic"]).sum().backward()
                optimiser.step()
        kl = loss.kl_to_reference(data)
        loss.update_multiplier(kl)
        found.append(kl / BOUND)
    collector.shutdown()
    return torch.stack(found)


def warned(multiplier: LagrangeMultiplier, kls) -> list[str]:
    with warnings.catch_warnings(record=True) as found:
        warnings.simplefilter("always")
        for kl in kls:
            multiplier.update(torch.as_tensor(kl))
    return [str(one.message) for one in found]


def test_a_kl_that_stays_far_beyond_its_bound_is_told_once():
    assert warned(LagrangeMultiplier(0.1), [0.25] * 49) == []
    (said,) = warned(LagrangeMultiplier(0.1), [0.25] * 200)
    assert "above 2 times its bound in 50 updates" in said and "normalize_advantage=True" in said
    (said,) = warned(LagrangeMultiplier(torch.tensor([0.1, torch.inf, 0.1])), [[0.1, 9.0, 0.3]] * 60)
    assert "KL / c is [1.0, 0.0, 3.0" in said


@pytest.mark.parametrize(
    ("how", "kls"),
    [
        ({"bounds": 0.1}, ([0.25] * 49 + [0.15]) * 4),  # it comes back in between
        ({"bounds": 0.1}, [0.2] * 99),  # beyond, and not far
        ({"bounds": torch.inf}, [9.0] * 99),
        ({"bounds": 0.1, "rate": 0.0}, [9.0] * 99),  # it stands still since that is meant
    ],
)
def test_no_other_is(how, kls):
    assert warned(LagrangeMultiplier(**how), kls) == []


def test_large_rewards_that_are_not_normalised_are_told_in_training():
    with pytest.warns(UserWarning, match="normalize_advantage=True if it is not, or divide"):
        kl = trained(56, normalize=False)
    assert kl[-1, 0] < 1.5 and kl[-1, 2] > 50.0  # where they are of the order of 1 it is back


def test_what_counts_is_not_saved_so_that_older_states_open():
    multiplier = LagrangeMultiplier(0.1)
    multiplier.update(torch.tensor(0.9))
    assert set(multiplier.state_dict()) == {"value", "bounds"}


if __name__ == "__main__":
    warnings.simplefilter("always")
    for normalize in (False, True):
        kl = trained(400, normalize)
        for index, scale in enumerate(SCALES):
            own = kl[:, index]
            told = ", ".join(f"{float(own[batch - 1]):.2f}" for batch in (10, 30, 100, 200, 400))
            most, far = float(own.max()), int((own > 2.0).sum())
            print(f"normalize={normalize}, rewards x {scale:g}: KL/c {told}; largest {most:.1f}; above 2 in {far}")
