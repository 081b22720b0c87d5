"""The gradient steps of a batch: candidate by candidate on a CPU, all of them as one captured program on a GPU."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence

import torch

from hts.cores import available
from hts.rl.learner import Columns, Layout, Learner
from hts.rl.population import Population
from hts.rl.settings import UpdateSettings
from hts.rl.threads import pool

LEAST_RATE, MOST_RATE = 1e-5, 1e-2  # of the adaptive rate (rsl_rl)
REPORTED = ("policy", "value", "kl_old")
MOMENTS = ("step", "exp_avg", "exp_avg_sq")  # Adam's state of a parameter
Stop = Callable[[int, str], None]
Samples = Mapping[str, torch.Tensor]


def adapted(rates: torch.Tensor, kl_old: torch.Tensor, desired: float) -> torch.Tensor:
    """Learning rates / 1.5 where KL(old || new) is above twice the desired one, x 1.5 below half of it (rsl_rl);
    all [P], nats."""
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
        self,
        samples: Samples,
        constant: Samples,
        multipliers: torch.Tensor,
        orders: Sequence[torch.Tensor],
        policy_on: float,
    ) -> dict[str, torch.Tensor]:
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


class SeparateSteps(GradientSteps):
    """On a CPU: candidates share nothing, so each takes all its steps alone, as many side by side as there are cores.

    Gradients are written out (`hts.rl.learner`): few and large operations, so that threads seldom meet at Python's
    lock.
    """

    def __init__(self, population: Population, config: UpdateSettings, stop: Stop) -> None:
        super().__init__(population, config, stop)
        self._layout = Layout(population)
        self._rates = [config.learning_rate] * population.count
        self._moments: list[dict[str, torch.Tensor]] = [{} for _ in range(population.count)]  # in the layout's order
        self._pool = pool(population.count)
        # Where there are cores for it, a candidate's critic learns beside its actor: they meet in the gradient's norm.
        self._critics = pool(population.count) if 2 * population.count <= available() else None

    def run(
        self,
        samples: Samples,
        constant: Samples,
        multipliers: torch.Tensor,
        orders: Sequence[torch.Tensor],
        policy_on: float,
    ) -> dict[str, torch.Tensor]:
        def train(index: int) -> dict[str, torch.Tensor]:
            own, fixed = ({name: value[index] for name, value in of.items()} for of in (samples, constant))
            return self._train(index, Columns(own, fixed), float(multipliers[index]), orders, policy_on)

        each = range(self.population.count)
        rows = list(map(train, each) if len(each) == 1 else self._pool.map(train, each))
        return {name: torch.stack([row[name] for row in rows]) for name in rows[0]}

    @torch.no_grad()
    def _train(
        self, index: int, columns: Columns, multiplier: float, orders: Sequence[torch.Tensor], policy_on: float
    ) -> dict[str, torch.Tensor]:
        """All steps of a candidate; mean losses, each []."""
        vector = self.population.vectors[index]
        learner = Learner(self._layout, vector)
        sums, updates = torch.zeros(len(REPORTED)), 0
        for order in orders:
            for batch in columns.minibatches(order[index], self.config.minibatches):
                losses = learner.differentiate(batch, multiplier, policy_on, self.config, self._critics)
                self.step(index, learner)
                if self.config.adaptive_rate:
                    self.adapt(index, losses["kl_old"])
                sums += torch.stack([losses[name] for name in REPORTED])
                updates += 1
        if index not in self.stopped:
            vector.copy_(self._layout.unpacked(learner.parameters))
        return dict(zip(REPORTED, sums.div_(updates), strict=True))

    @torch.no_grad()
    def step(self, index: int, learner: Learner) -> None:
        """One Adam step of a candidate, unless it has been stopped. Its gradient is clipped in place."""
        norm = float(learner.gradient.norm())
        if not math.isfinite(norm) and index not in self.stopped:
            self.population.vectors[index].copy_(self._layout.unpacked(learner.parameters))  # as it was until here
            self.stop(index, "the gradient is not finite")
            self.stopped.add(index)
        if index in self.stopped:
            return
        if norm > self.config.max_grad_norm:
            learner.gradient.mul_(self.config.max_grad_norm / (norm + 1e-6))
        moments = self._moments[index]
        if not moments:
            moments |= {name: torch.zeros_like(learner.gradient) for name in MOMENTS} | {"step": torch.zeros(())}
        # What `torch.optim.Adam(fused=True)` calls, without the 0.1 ms of Python around it.
        torch._fused_adam_(
            [learner.parameters],
            [learner.gradient],
            [moments["exp_avg"]],
            [moments["exp_avg_sq"]],
            [],
            [moments["step"].add_(1.0)],
            lr=self._rates[index],
            beta1=0.9,
            beta2=0.999,
            weight_decay=0.0,
            eps=1e-8,
            amsgrad=False,
            maximize=False,
        )

    def adapt(self, index: int, kl_old: torch.Tensor) -> None:
        """The candidate's next rate, from kl_old [] or [1], nats."""
        rate = torch.tensor([self._rates[index]], dtype=torch.float64)
        self._rates[index] = float(adapted(rate, kl_old, self.config.desired_kl))

    @property
    def rates(self) -> list[float]:
        return list(self._rates)

    @rates.setter
    def rates(self, values: Sequence[float]) -> None:
        self._rates = [float(value) for value in values]

    def state(self) -> dict[str, dict[str, torch.Tensor]]:
        return {
            str(index): self._moved(moments, self._layout.unpacked)
            for index, moments in enumerate(self._moments)
            if moments
        }

    def load_state(self, state: Mapping[str, Mapping[str, torch.Tensor]]) -> None:
        for index, moments in enumerate(self._moments):
            if str(index) in state:
                moments |= self._moved(state[str(index)], self._layout.packed)

    def _moved(
        self, moments: Mapping[str, torch.Tensor], order: Callable[[torch.Tensor], torch.Tensor]
    ) -> dict[str, torch.Tensor]:
        """Copies of Adam's moments on the CPU, in another order."""
        return {
            name: order(moments[name].cpu()) if moments[name].ndim else moments[name].cpu().clone() for name in MOMENTS
        }

    def close(self) -> None:
        self._pool.shutdown()
        if self._critics is not None:
            self._critics.shutdown()
