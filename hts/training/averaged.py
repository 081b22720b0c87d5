"""Parameters averaged over the end of a training: what a multiplier makes swing has its balance in the middle."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import torch

from hts.rl.population import Population


class Averaged:
    """The mean of all candidates' parameters over the last batches of a group.

    The average of the iterates is what a Lagrangian method of primal and dual steps brings to the saddle point; its
    last iterate may circle around it (Nedić and Ozdaglar 2009, "Subgradient Methods for Saddle-Point Problems").

    share: of the training, at its end, in [0, 1); 0 keeps nothing. batches: of the whole of it.
    """

    def __init__(self, share: float, batches: int) -> None:
        self.after = round((1.0 - share) * batches) if share else batches
        self.count = 0
        self.mean: torch.Tensor | None = None

    @torch.no_grad()
    def look(self, done: int, population: Population) -> None:
        """After so many batches: count them in, if they are among the last."""
        if done <= self.after:
            return
        vectors = torch.stack([vector.detach() for vector in population.vectors])
        self.count += 1
        if self.mean is None:
            self.mean = vectors
        else:
            self.mean = self.mean.to(vectors.device).lerp(vectors, 1.0 / self.count)

    @torch.no_grad()
    def put_into(self, population: Population, able: list[int]) -> None:
        """The mean in place of where candidates ended, of those in `able`; the others keep their parameters."""
        if self.mean is None:
            return
        for index in able:
            population.vectors[index].copy_(self.mean[index])
        population.refresh()

    def state(self) -> dict[str, torch.Tensor]:
        """Tensors for a checkpoint."""
        return {} if self.mean is None else {"mean": self.mean.clone()}

    def notes(self) -> dict[str, Any]:
        """The rest of it."""
        return {"count": self.count}

    def load(self, state: Mapping[str, torch.Tensor], notes: Mapping[str, Any]) -> None:
        """Go on from a checkpoint."""
        self.count = int(notes["count"])
        self.mean = state.get("mean")
