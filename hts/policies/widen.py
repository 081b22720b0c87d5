"""The same policy in a larger network: what `hts bench` needs to time networks that nobody has trained.

Function-preserving growth (Chen, Goodfellow, Shlens 2016, Net2Net): new units lead nowhere, and a new layer passes its
input on. ELU(x + 1) = x + 1 for what an ELU layer puts out, since that is never below -1.
"""

from __future__ import annotations

from collections.abc import Mapping

import torch

from hts.policies.networks import Population, Sizes


def widened(tensors: Mapping[str, torch.Tensor], sizes: Sizes, hidden: tuple[int, ...]) -> dict[str, torch.Tensor]:
    """A candidate with hidden layers `hidden` that computes what `tensors` of `sizes` does, to rounding.

    Raises ValueError if a layer of `hidden` is smaller than the one it grew from, or there are fewer layers.
    """
    old = sizes.hidden
    if len(hidden) < len(old) or any(new < was for new, was in zip(hidden, (*old, *[old[-1]] * 9), strict=False)):
        raise ValueError(f"hidden layers {hidden} cannot hold those of {old}")
    grown = Sizes(sizes.observation, sizes.critic_observation, sizes.action, hidden)
    made = Population(grown, 1).candidate(0)  # new units start like those of a new network
    made |= {name: value for name, value in tensors.items() if not name.startswith(("actor.", "critic."))}
    for part in ("actor", "critic"):
        for index in range(len(hidden) + 1):
            weight, bias = (torch.zeros_like(made[f"{part}.{index}.{what}"]) for what in ("weight", "bias"))
            if index < len(hidden):  # rows of units that lead nowhere may be anything
                used = old[min(index, len(old) - 1)]
                weight[used:] = made[f"{part}.{index}.weight"][used:]
            if index < len(old):
                was = tensors[f"{part}.{index}.weight"]
                weight[: was.shape[0], : was.shape[1]] = was
                bias[: was.shape[0]] = tensors[f"{part}.{index}.bias"]
            elif index < len(hidden):  # the first extra layer lifts by 1, later ones pass what is positive already
                weight[: old[-1], : old[-1]] = torch.eye(old[-1])
                bias[: old[-1]] = 1.0 if index == len(old) else 0.0
            else:
                was, lift = tensors[f"{part}.{len(old)}.weight"], float(len(hidden) > len(old))
                weight[:, : old[-1]] = was
                bias[:] = tensors[f"{part}.{len(old)}.bias"] - lift * was.sum(1)
            made[f"{part}.{index}.weight"], made[f"{part}.{index}.bias"] = weight, bias
    return made
