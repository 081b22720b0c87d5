"""A policy file as TorchRL's ordinary modules, and back."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping

import torch
from tensordict.nn import TensorDictModule
from torch import nn
from torchrl.modules import IndependentNormal, ProbabilisticActor, ValueOperator

from hts.policies.files import Policy, check_finite, hash_tensors
from hts.rl.population import CLIP


class Normaliser(nn.Module):
    """(o − mean) / std, clipped; frozen."""

    mean: torch.Tensor
    std: torch.Tensor

    def __init__(self, mean: torch.Tensor, std: torch.Tensor) -> None:
        super().__init__()
        self.register_buffer("mean", mean.clone())
        self.register_buffer("std", std.clone())

    def forward(self, observation: torch.Tensor) -> torch.Tensor:
        """Any leading dimensions."""
        return ((observation - self.mean) / self.std).clamp(-CLIP, CLIP)


class GaussianMean(nn.Module):
    """observation [..., O] -> loc and scale [..., A]; scale does not depend on the state."""

    def __init__(self, network: nn.Module, log_std: torch.Tensor) -> None:
        super().__init__()
        self.network, self.log_std = network, nn.Parameter(log_std.clone())

    def forward(self, observation: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        loc = self.network(observation)
        return loc, self.log_std.exp().expand_as(loc)


def _network(part: str, normaliser: str, tensors: Mapping[str, torch.Tensor]) -> nn.Sequential:
    """Normaliser, then linear layers with ELU between them."""
    layers: list[nn.Module] = [Normaliser(tensors[f"{normaliser}_mean"], tensors[f"{normaliser}_std"])]
    count = sum(name.startswith(f"{part}.") and name.endswith(".weight") for name in tensors)
    for index in range(count):
        weight, bias = tensors[f"{part}.{index}.weight"], tensors[f"{part}.{index}.bias"]
        linear = nn.Linear(weight.shape[1], weight.shape[0], device="meta").to_empty(device="cpu")
        with torch.no_grad():
            linear.weight.copy_(weight)
            linear.bias.copy_(bias)
        layers += [linear] if index == count - 1 else [linear, nn.ELU()]
    return nn.Sequential(*layers)


def actor_of(policy: Policy) -> ProbabilisticActor:
    """The policy as a `ProbabilisticActor`: observation [..., O] -> loc, scale, action [..., A] and
    action_log_prob [...].

    For example `actor_of(load_policy(path))`. Its parameters can be trained; the observation normaliser stays.
    """
    mean = GaussianMean(_network("actor", "observation", policy.tensors), policy.tensors["log_std"])
    head = TensorDictModule(mean, in_keys=["observation"], out_keys=["loc", "scale"])
    return ProbabilisticActor(
        head, in_keys=["loc", "scale"], distribution_class=IndependentNormal, return_log_prob=True
    )


def critic_of(policy: Policy) -> ValueOperator:
    """The policy's critic as a `ValueOperator`: critic_observation [..., O_c] -> state_value [..., 1]."""
    return ValueOperator(_network("critic", "critic_observation", policy.tensors), in_keys=["critic_observation"])


def with_parameters(policy: Policy, actor: nn.Module, critic: nn.Module | None = None) -> Policy:
    """The policy with the numbers of modules that `actor_of` and `critic_of` made, trained since: ready to be saved.

    How the policy was made that this one started from stands in the new card under `made.start`, beside its hash: the
    card cannot know what was done since. Numbers that are the same are the same policy, with the card that it had.
    Raises ValueError for modules of another shape, PolicyError for numbers that are not finite.
    """
    tensors = {name: value.clone() for name, value in policy.tensors.items()}
    _take(tensors, "actor", actor)
    tensors["log_std"] = _single(actor, GaussianMean).log_std.detach().cpu().clone()
    if critic is not None:
        _take(tensors, "critic", critic)
    check_finite("The trained policy", tensors)
    own = hash_tensors(tensors)
    if own == policy.card.policy_hash:
        return Policy(tensors, policy.card)
    start = {"policy_hash": policy.card.policy_hash, "made": dict(policy.card.made)}
    made = {"by": "hts.policies.modules.with_parameters", "start": start}
    return Policy(tensors, dataclasses.replace(policy.card, policy_hash=own, made=made))


def _take(tensors: dict[str, torch.Tensor], part: str, module: nn.Module) -> None:
    """The linear layers of a module, in order, as the tensors of a part."""
    linears = [one for one in module.modules() if isinstance(one, nn.Linear)]
    count = sum(name.startswith(f"{part}.") and name.endswith(".weight") for name in tensors)
    if len(linears) != count:
        raise ValueError(
            f"The {part} has {len(linears)} linear layers, its policy {count}. Take a module of `{part}_of`."
        )
    for index, linear in enumerate(linears):
        for name, value in (("weight", linear.weight), ("bias", linear.bias)):
            key = f"{part}.{index}.{name}"
            if value.shape != tensors[key].shape:
                raise ValueError(f"{key} has shape {tuple(value.shape)}, the policy's {tuple(tensors[key].shape)}.")
            tensors[key] = value.detach().cpu().clone()


def _single(module: nn.Module, kind: type[GaussianMean]) -> GaussianMean:
    found = [one for one in module.modules() if isinstance(one, kind)]
    if len(found) != 1:
        raise ValueError(f"Found {len(found)} {kind.__name__} in the actor, expected one. Take a module of `actor_of`.")
    return found[0]
