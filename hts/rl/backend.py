"""How a population is collected from and trained on one kind of device, chosen once.

On a CPU candidates share nothing: each takes its gradient steps alone, as many side by side as there are cores, and its
bits do not depend on who trains beside it. On a GPU all of them take each step together, as captured programs in which
nothing waits for the host.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import TypeVar

import torch
from tensordict import TensorDictBase
from torchrl.collectors import BaseCollector
from torchrl.envs import EnvBase

from hts.rl.actor import PopulationActor
from hts.rl.advantage import sparse_next_values
from hts.rl.batched_updates import BatchedSteps
from hts.rl.capture import Captured
from hts.rl.captured_collector import CapturedCollector
from hts.rl.population import Population
from hts.rl.population_collector import PopulationCollector, can_split, torchrl_collector
from hts.rl.random import PopulationRandom
from hts.rl.settings import UpdateSettings
from hts.rl.updates import GradientSteps, SeparateSteps, Stop

Result = TypeVar("Result")


class Backend(ABC):
    """See `backend_for`."""

    kl_stride: int
    """The multiplier's KL is the mean over every so many states of a batch."""

    @abstractmethod
    def collector(
        self,
        env: EnvBase,
        actor: PopulationActor,
        frames_per_batch: int,
        reference: Population | None,
        fixed_normaliser: bool,
    ) -> BaseCollector:
        """The fastest collector that env can have: by its parts if it is a `SplitStepEnv`, else TorchRL's own.

        reference: whose mean actions learning will ask for; fixed_normaliser: false where observations are
        normalised otherwise after collecting (pretraining), so that nothing can be computed in advance.
        """

    @abstractmethod
    def gradient_steps(self, population: Population, settings: UpdateSettings, stop: Stop) -> GradientSteps:
        """What takes the gradient steps; stop(index, reason) is called for a candidate whose gradient is not finite."""

    @abstractmethod
    def next_values(self, population: Population, data: TensorDictBase, value: torch.Tensor) -> torch.Tensor:
        """V of the states that steps ended in, [P, N, T]; see `advantage.sparse_next_values`."""

    @abstractmethod
    def permutation(self, random: PopulationRandom, count: int) -> torch.Tensor:
        """A random order of range(count) for each candidate, [P, count]."""

    def repeated(self, function: Callable[[], Result]) -> Callable[[], Result]:
        """A function that reads tensors that keep their place, to be called again and again."""
        return function


class CpuBackend(Backend):
    """Candidate by candidate."""

    kl_stride = 1

    def collector(
        self,
        env: EnvBase,
        actor: PopulationActor,
        frames_per_batch: int,
        reference: Population | None,
        fixed_normaliser: bool,
    ) -> BaseCollector:
        if can_split(env):
            return PopulationCollector(env, actor, frames_per_batch=frames_per_batch)
        return torchrl_collector(env, actor, frames_per_batch)

    def gradient_steps(self, population: Population, settings: UpdateSettings, stop: Stop) -> GradientSteps:
        return SeparateSteps(population, settings, stop)

    def next_values(self, population: Population, data: TensorDictBase, value: torch.Tensor) -> torch.Tensor:
        return sparse_next_values(population, data, value)

    def permutation(self, random: PopulationRandom, count: int) -> torch.Tensor:
        return torch.stack([torch.randperm(count, generator=generator) for generator in random.generators])


class GpuBackend(Backend):
    """All candidates at once. capture: as CUDA graphs; tf32: matrix products in TF32; fuse: through torch.compile, None
    where that can work."""

    kl_stride = 4  # some thousands of states a candidate are plenty

    def __init__(self, device: torch.device, capture: bool, tf32: bool, fuse: bool | None) -> None:
        self.device, self.capture, self.tf32, self.fuse = device, capture and device.type == "cuda", tf32, fuse

    def collector(
        self,
        env: EnvBase,
        actor: PopulationActor,
        frames_per_batch: int,
        reference: Population | None,
        fixed_normaliser: bool,
    ) -> BaseCollector:
        if not can_split(env):
            return torchrl_collector(env, actor, frames_per_batch)
        return CapturedCollector(
            env,
            actor,
            frames_per_batch=frames_per_batch,
            capture=self.capture,
            tf32=self.tf32,
            compiled=self.fuse,
            side_stream=self.capture and fixed_normaliser,
            reference=reference,
        )

    def gradient_steps(self, population: Population, settings: UpdateSettings, stop: Stop) -> GradientSteps:
        return BatchedSteps(population, settings, stop, self.capture, tf32=self.tf32, fuse=self.fuse)

    def next_values(self, population: Population, data: TensorDictBase, value: torch.Tensor) -> torch.Tensor:
        seen = data["next", "critic_observation"].flatten(1, 2)
        return population.value(seen).view(value.shape)

    def permutation(self, random: PopulationRandom, count: int) -> torch.Tensor:
        draws = torch.empty(len(random.generators), count, device=self.device)
        return random.fill("uniform_", draws).argsort(dim=1)  # one sort for all of them

    def repeated(self, function: Callable[[], Result]) -> Callable[[], Result]:
        return Captured(function, self.device) if self.capture else function


def backend_for(device: torch.device, *, capture: bool = True, tf32: bool = True, fuse: bool | None = None) -> Backend:
    """The backend of a device; the settings are those of `GpuBackend`."""
    return CpuBackend() if device.type == "cpu" else GpuBackend(device, capture, tf32, fuse)
