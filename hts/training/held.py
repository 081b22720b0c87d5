"""Sim channels whose mean fine-tuning holds at zero or below a number, from the env to the learner."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import torch
from tensordict.utils import NestedKey
from torchrl.data import Composite, Unbounded

from hts.config import FinetuneConfig
from hts.contracts import Robot
from hts.errors import SimulationError, unknown_name
from hts.rl.deferred import DeferrableTransform
from hts.training.trainer import STRENGTH


@dataclass(frozen=True)
class Holding:
    """Sim channels whose mean fine-tuning holds, as `Robot` names them. at_zero: name -> an error that matters; below:
    name -> limit."""

    at_zero: Mapping[str, float]
    below: Mapping[str, float]

    @classmethod
    def of(cls, robot: Robot, config: FinetuneConfig) -> Holding:
        """What the configuration asks for."""
        return cls(
            dict(robot.held_at_zero) if config.hold else {},
            dict(robot.held_below) if config.hold and config.hold_below else {},
        )

    @property
    def names(self) -> tuple[str, ...]:
        """All of them."""
        return tuple(dict.fromkeys((*self.at_zero, *self.below)))


LAST = 0.25  # share of a training over which a price is averaged: the swings of a multiplier last about so long


def found_prices(history: Sequence[Mapping[str, float]], held: Holding) -> dict[str, float]:
    """At what price each of the held means was in balance at the end of a candidate's training, per strength of the
    rewards that pull at it (so that it serves another λ too): the mean over the last quarter of its batches. None of
    a training whose history does not tell that strength, as one that an earlier version began."""
    last = history[-max(1, round(LAST * len(history))) :]
    if not all(STRENGTH in row for row in last):
        return {}
    return {
        name: sum(row[f"held/{name}_multiplier"] / row[STRENGTH] for row in last) / len(last) for name in held.names
    }


def begun_at(made: Sequence[Mapping[str, Any]], held: Holding) -> dict[str, torch.Tensor]:
    """Where multipliers begin, name -> [P], per strength: where those of each candidate's anchor ended, as its card
    says in `made`; 0 for an anchor that knows none."""
    known = [one.get("prices") or {} for one in made]
    return {name: torch.tensor([float(one.get(name, 0.0)) for one in known]) for name in held.names}


class Held(DeferrableTransform):
    """Writes ("held", name) [P, N, 1] for each of the named channels, whose samples are single numbers [P, N]."""

    def __init__(self, names: tuple[str, ...]) -> None:
        keys = [("held", name) for name in names]
        super().__init__(in_keys=[("channels", name) for name in names], out_keys=keys)
        self.names = names

    def transform_observation_spec(self, observation_spec: Composite) -> Composite:
        batch, device = observation_spec.shape, observation_spec.device
        known = set(observation_spec["channels"].keys())
        for name in self.names:
            if name not in known:
                raise SimulationError("finetune.hold: " + unknown_name("channel of the env", name, known))
        entries = {name: Unbounded((*batch, 1), device=device) for name in self.names}
        observation_spec["held"] = Composite(entries, shape=batch, device=device)
        return observation_spec

    def record(self, channels: Mapping[str, torch.Tensor]) -> torch.Tensor:
        return torch.stack([channels[name] for name in self.names], -1).flatten(0, 1)

    def evaluate(self, recorded: torch.Tensor) -> dict[NestedKey, torch.Tensor]:
        parts = zip(self.out_keys, recorded.unbind(-1), strict=True)
        return {key: value.unsqueeze(-1) for key, value in parts}

    def forward_sequence(self, recorded: torch.Tensor, ended: torch.Tensor) -> dict[NestedKey, torch.Tensor]:
        return self.evaluate(recorded)

    def forget(self, ended: torch.Tensor) -> None:
        """Nothing is remembered."""
