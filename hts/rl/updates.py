"""The gradient steps of a batch: candidate by candidate on a CPU, all of them as one captured program on a GPU."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence

import torch

from hts.rl.population import Population
from hts.rl.settings import UpdateSettings
from hts.rl.surrogate import LossParts, population_loss
from hts.rl.threads import pool

LEAST_RATE, MOST_RATE = 1e-5, 1e-2  # of the adaptive rate (rsl_rl)
REPORTED = ("policy", "value", "kl_old")
MOMENTS = ("step", "exp_avg", "exp_avg_sq")  # Adam's state of a parameter
Stop = Callable[[int, str], None]
Samples = Mapping[str, torch.Tensor]


def adapted(rates: torch.Tensor, kl_old: torch.Tensor, desired: float) -> torch.Tensor:
    """Learning rates / 1.5 where KL(old || new) is above twice the desired one, x 1.5 below half of it (rsl_rl); all [P], nats."""
    slower, faster = (rates / 1.5).clamp(min=LEAST_RATE), (rates * 1.5).clamp(max=MOST_RATE)
    wanted = torch.where((kl_old > 0) & (kl_old < desired / 2), faster, rates)
    return torch.where(kl_old > 2 * desired, slower, wanted)


class GradientSteps(ABC):
    """Adam steps of P candidates, each with its own learning rate and its gradient clipped by its own norm.

    stop(index, reason): called when a candidate's gradient is not finite; from then on it is not changed any more.
    """

    def __init__(self, population: Population, config: UpdateSettings, stop: Stop) -> None:
        self.population, self.config, self.stop = population, config, stop
        self.stopped: set[int] = set()

    @abstractmethod
    def run(
        self, samples: Samples, constant: Samples, multipliers: torch.Tensor, orders: Sequence[torch.Tensor],
        policy_on: float,
    ) -> dict[str, torch.Tensor]:  # fmt: skip
        """All gradient steps on a batch. samples: name -> [P, S, ...]; constant: name -> [P, 1, J]; multipliers [P];
        orders: of the samples, [P, S] an epoch; policy_on: 0 fits the critic only. Mean losses, each [P]."""

    @property
    @abstractmethod
    def rates(self) -> list[float]:
        """Learning rate of each candidate."""

    @rates.setter
    @abstractmethod
    def rates(self, values: Sequence[float]) -> None: ...

    def halt(self, index: int) -> None:
        """Change this candidate no more."""
        self.stopped.add(index)

    @abstractmethod
    def state(self) -> dict[str, dict[str, torch.Tensor]]:
        """Adam's moments of each candidate that has taken a step."""

    @abstractmethod
    def load_state(self, state: Mapping[str, Mapping[str, torch.Tensor]]) -> None:
        """Go on from `state`. Before the first step, since a captured program keeps the memory it was made with."""

    def close(self) -> None:  # noqa: B027
        """Let go of threads."""

    def _loss(
        self, batch: Samples, multipliers: torch.Tensor, policy_on: float | torch.Tensor, members: slice, named=None
    ) -> LossParts:
        config = self.config
        return population_loss(
            self.population, batch, multipliers, clip=config.clip, value_coef=config.value_coef,
            entropy_coef=config.entropy_coef, policy_on=policy_on, members=members, normalised=True, named=named,
        )  # fmt: skip


class SeparateSteps(GradientSteps):
    """On a CPU: candidates share nothing, so each takes all its steps alone, as many side by side as there are cores."""

    def __init__(self, population: Population, config: UpdateSettings, stop: Stop) -> None:
        super().__init__(population, config, stop)
        self.optimisers = [
            torch.optim.Adam([vector], lr=config.learning_rate, eps=1e-8, fused=True) for vector in population.vectors
        ]
        self._pool = pool(population.count)

    def run(self, samples, constant, multipliers, orders, policy_on):
        def train(index: int) -> dict[str, torch.Tensor]:
            return self._train(index, samples, constant, multipliers, orders, policy_on)

        each = range(self.population.count)
        rows = list(map(train, each) if len(each) == 1 else self._pool.map(train, each))
        return {name: torch.cat([row[name] for row in rows]) for name in rows[0]}

    def _train(self, index, samples, constant, multipliers, orders, policy_on) -> dict[str, torch.Tensor]:
        member = slice(index, index + 1)
        own = {name: value[index] for name, value in samples.items()}
        fixed = {name: value[member] for name, value in constant.items()}
        sums: dict[str, torch.Tensor] = {}
        updates = 0
        for order in orders:
            for rows in order[index].chunk(self.config.minibatches):
                batch = {name: value.index_select(0, rows).unsqueeze(0) for name, value in own.items()} | fixed
                loss = self._loss(batch, multipliers[member], policy_on, member)
                self.step(index, loss.total)
                if self.config.adaptive_rate:
                    self.adapt(index, loss.kl_old)
                updates += 1
                for name in REPORTED:
                    sums[name] = sums.get(name, 0.0) + getattr(loss, name)
        return {name: value / updates for name, value in sums.items()}

    def step(self, index: int, loss: torch.Tensor) -> None:
        """One Adam step of a candidate, unless it has been stopped. loss [1]."""
        vector, optimiser = self.population.vectors[index], self.optimisers[index]
        optimiser.zero_grad(set_to_none=True)
        loss.sum().backward()
        assert vector.grad is not None
        norm = vector.grad.norm()
        vector.grad.mul_((self.config.max_grad_norm / (norm + 1e-6)).clamp(max=1.0))
        if not bool(norm.isfinite()) and index not in self.stopped:
            self.stop(index, "the gradient is not finite")
        if index in self.stopped:
            vector.grad = None
        optimiser.step()

    def adapt(self, index: int, kl_old: torch.Tensor) -> None:
        """The candidate's next rate, from kl_old [1], nats."""
        (group,) = self.optimisers[index].param_groups
        rate = torch.tensor([group["lr"]], dtype=torch.float64)
        group["lr"] = float(adapted(rate, kl_old, self.config.desired_kl))

    @property
    def rates(self) -> list[float]:
        return [optimiser.param_groups[0]["lr"] for optimiser in self.optimisers]

    @rates.setter
    def rates(self, values: Sequence[float]) -> None:
        for optimiser, value in zip(self.optimisers, values, strict=True):
            optimiser.param_groups[0]["lr"] = value

    def state(self) -> dict[str, dict[str, torch.Tensor]]:
        found = {}
        for index, (vector, optimiser) in enumerate(zip(self.population.vectors, self.optimisers, strict=True)):
            state = optimiser.state.get(vector)
            if state:
                found[str(index)] = {name: state[name].clone() for name in MOMENTS}
        return found

    def load_state(self, state: Mapping[str, Mapping[str, torch.Tensor]]) -> None:
        for index, (vector, optimiser) in enumerate(zip(self.population.vectors, self.optimisers, strict=True)):
            if str(index) in state:
                optimiser.state[vector] = {name: state[str(index)][name].cpu().clone() for name in MOMENTS}

    def close(self) -> None:
        self._pool.shutdown()
