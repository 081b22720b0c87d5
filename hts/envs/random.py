"""Random numbers of a population: one generator per candidate, so that nobody's stream depends on the others."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import torch


class PopulationRandom:
    """P generators on one device; every draw has shape [P, ...].

    seeds: one per candidate. A candidate that keeps its seed draws the same numbers alone and in a crowd.
    """

    def __init__(self, seeds: Sequence[int], device: torch.device):
        self.device = device
        self.generators = [torch.Generator(device).manual_seed(int(seed)) for seed in seeds]

    def uniform(self, *shape: int) -> torch.Tensor:
        """Uniform in [0, 1), shape [P, *shape]."""
        out = torch.empty(len(self.generators), *shape, device=self.device)
        for row, generator in zip(out, self.generators, strict=True):
            row.uniform_(generator=generator)
        return out

    def normal(self, *shape: int) -> torch.Tensor:
        """Standard normal, shape [P, *shape]."""
        out = torch.empty(len(self.generators), *shape, device=self.device)
        for row, generator in zip(out, self.generators, strict=True):
            row.normal_(generator=generator)
        return out

    def permutation(self, count: int) -> torch.Tensor:
        """A random order of range(count) for each candidate, shape [P, count]."""
        if self.device.type != "cpu":  # one sort for all of them
            return self.uniform(count).argsort(dim=1)
        return torch.stack([torch.randperm(count, generator=g, device=self.device) for g in self.generators])

    def state_dict(self) -> dict[str, torch.Tensor]:
        return {"generators": torch.stack([generator.get_state() for generator in self.generators])}

    def load_state_dict(self, state: Mapping[str, torch.Tensor]) -> None:
        for generator, saved in zip(self.generators, state["generators"], strict=True):
            generator.set_state(saved.cpu().clone())
