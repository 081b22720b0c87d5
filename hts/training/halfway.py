"""Candidates as they were on the way: training goes on as long as it is told to, and its last moment need not be its
best. What is kept here is judged in simulation beside the candidates themselves."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import torch

from hts.rl.population import Population

Tensors = Mapping[str, torch.Tensor]


@dataclass(frozen=True)
class Moment:
    """One candidate at one time. index: which of its group; share: of its training; kl: mean KL(pi || anchor) over the
    batch before, nats; std: mean sigma, action units."""

    index: int
    share: float
    kl: float
    std: float
    tensors: Tensors


@dataclass
class Halfway:
    """What a group keeps. shares: of its training, each in (0, 1); batches: of the whole of it."""

    shares: Sequence[float]
    batches: int
    moments: list[Moment] = field(default_factory=list)

    def look(self, done: int, population: Population, kl: torch.Tensor, able: Sequence[int]) -> None:
        """After so many batches: keep the candidates in `able` if it is time to; kl: of each, [P]."""
        due = [share for share in self.shares if max(1, round(share * self.batches)) == done < self.batches]
        if not due:
            return
        std, found = population.log_std().exp().mean((1, 2)).tolist(), kl.tolist()
        self.moments += [
            Moment(index, share, found[index], std[index], population.candidate(index))
            for share in due
            for index in able
        ]

    def state(self) -> dict[str, Tensors]:
        """Tensors for a checkpoint."""
        return {str(number): dict(moment.tensors) for number, moment in enumerate(self.moments)}

    def notes(self) -> list[dict[str, Any]]:
        """The rest of it."""
        return [{key: value for key, value in vars(moment).items() if key != "tensors"} for moment in self.moments]

    def load(self, state: Mapping[str, Tensors], notes: Sequence[Mapping[str, Any]]) -> None:
        """Go on from a checkpoint."""
        self.moments = [Moment(**note, tensors=dict(state[str(number)])) for number, note in enumerate(notes)]
