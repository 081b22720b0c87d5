"""From a collected batch to the samples that gradient steps are taken on."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import torch
from tensordict import TensorDictBase

from hts.rl.advantage import advantages
from hts.rl.kl import gaussian_kl
from hts.rl.population import Population
from hts.rl.rows import row_mean, row_standardised

Samples = Mapping[str, torch.Tensor]
NextValues = Callable[[Population, TensorDictBase, torch.Tensor], torch.Tensor]


def samples_of(
    data: TensorDictBase,
    reward: torch.Tensor,
    population: Population,
    reference: Population | None,
    *,
    gamma: float,
    lam: float,
    next_values: NextValues,
) -> tuple[Samples, Samples]:
    """Flatten a batch [P, N, T] to [P, S] samples with everything the loss needs (`surrogate.population_loss`),
    observations as the networks see them; and what is one per candidate, [P, 1, J].

    reward [P, N, T]; next_values: how V of the states that steps ended in is found. What the collector has computed
    beside the physics (state_value, reference_loc) is taken from the batch.
    """
    observation, critic_observation = (data[name].flatten(1, 2) for name in ("observation", "critic_observation"))
    value = data.get("state_value", None)
    value = population.value(critic_observation).view(reward.shape) if value is None else value.squeeze(-1)
    terminated, done = (data["next", key].squeeze(-1) for key in ("terminated", "done"))
    following = next_values(population, data, value)
    advantage, target = advantages(reward, value, following, terminated, done, gamma, lam)
    constant = {"old_log_std": population.log_std().clone()}
    samples = {
        "observation": population.normalised("observation", observation),
        "critic_observation": population.normalised("critic_observation", critic_observation),
        "action": data["action"].flatten(1, 2),
        "old_mean": data["loc"].flatten(1, 2),
        "log_prob": data["action_log_prob"].flatten(1, 2),
        "advantage": row_standardised(advantage.flatten(1)),
        "target": target.flatten(1),
        "old_value": value.flatten(1),
    }
    if reference is not None:
        loc = data.get("reference_loc", None)
        samples["reference_mean"] = reference.mean(observation) if loc is None else loc.flatten(1, 2)
        constant["reference_log_std"] = reference.log_std()
    return samples, constant


def kl_of_batch(
    data: TensorDictBase, population: Population, reference: Population, reference_mean: torch.Tensor, stride: int
) -> torch.Tensor:
    """Mean KL(pi || reference) [P] over every stride-th state of a batch [P, N, T], with the parameters as they are
    now; reference_mean [P, N T, J]: the reference's mean actions in all of them."""
    observation = data["observation"].flatten(1, 2)[:, ::stride]
    mean = population.mean(observation)
    return row_mean(gaussian_kl(mean, population.log_std(), reference_mean[:, ::stride], reference.log_std()))
