"""The gradient steps of a batch on a GPU: all candidates in each, as one CUDA graph that is launched again and again."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import torch

from hts.config import PPOConfig
from hts.policies.networks import Population
from hts.ppo.precision import tf32
from hts.ppo.steps import LEAST_RATE, MOST_RATE, REPORTED, GradientSteps, Samples, Stop

WARM_UP = 2  # steps before capture, undone afterwards


class BatchedSteps(GradientSteps):
    """Every step takes all candidates; nothing in it waits for the device.

    Learning rates, who still runs, and sums of losses live on the device; they are read once per batch. capture: as
    CUDA graphs, one for each size of minibatch; without it the same steps run one operation after the other.
    """

    def __init__(self, population: Population, config: PPOConfig, stop: Stop, capture: bool) -> None:
        super().__init__(population, config, stop)
        count, device = population.count, population.device
        self._capture = capture
        self._rates = torch.full((count,), config.learning_rate, device=device)
        self._effective = self._rates.clone()  # 0 for who has been stopped
        self._running = torch.ones(count, dtype=torch.bool, device=device)
        groups = [
            {"params": [vector], "lr": rate}
            for vector, rate in zip(population.vectors, self._effective.unbind(), strict=True)
        ]
        self.optimisers = [torch.optim.Adam(groups, eps=1e-8, fused=True, capturable=device.type == "cuda")]
        self._fixed: dict[str, torch.Tensor] = {}
        self._rows: dict[int, torch.Tensor] = {}
        self._graphs: dict[int, torch.cuda.CUDAGraph] = {}
        self._sums = torch.zeros(len(REPORTED), count, device=device)
        self._member = torch.arange(count, device=device).unsqueeze(1)

    # --------------------------------------------------------------------------------------------------- a batch

    def run(self, samples, constant, multipliers, orders, policy_on):
        self._hold(samples, constant, multipliers, policy_on)
        self._sums.zero_()
        updates = 0
        for order in orders:
            for rows in order.chunk(self.config.minibatches, dim=1):
                self._launch(rows)
                updates += 1
        for index in (~self._running).nonzero().flatten().tolist():  # waits, once per batch
            if index not in self.stopped:
                self.stop(index, "the gradient is not finite")
        return dict(zip(REPORTED, (self._sums / updates).unbind(), strict=True))

    def _hold(self, samples: Samples, constant: Samples, multipliers: torch.Tensor, policy_on: float) -> None:
        """Copy what the steps read to where they read it."""
        new = {**samples, **constant, "multipliers": multipliers, "policy_on": torch.tensor(policy_on)}
        self._sampled = tuple(samples)
        self._constant = tuple(constant)
        for name, value in new.items():
            if name not in self._fixed or self._fixed[name].shape != value.shape:
                self._fixed[name] = torch.empty_like(
                    value, device=self._rates.device, memory_format=torch.contiguous_format
                )
                self._graphs.clear()
            self._fixed[name].copy_(value)

    def _launch(self, rows: torch.Tensor) -> None:
        size = rows.shape[1]
        if size not in self._rows:
            self._rows[size] = torch.empty_like(rows, memory_format=torch.contiguous_format)
        self._rows[size].copy_(rows)
        if not self._capture:
            self._step(self._rows[size])
            return
        if size not in self._graphs:
            self._graphs[size] = self._captured(self._rows[size])
        self._graphs[size].replay()

    # ---------------------------------------------------------------------------------------------------- a step

    def _step(self, rows: torch.Tensor) -> None:
        """One Adam step of every candidate on its samples rows [P, B]."""
        fixed, config = self._fixed, self.config
        batch: dict[str, torch.Tensor] = {name: fixed[name][self._member, rows] for name in self._sampled}
        batch |= {name: fixed[name] for name in self._constant}
        stacked = torch.stack([vector.detach() for vector in self.population.vectors]).requires_grad_()
        with torch.enable_grad(), tf32(config.tf32):
            named = self.population.split(stacked)
            loss = self._loss(batch, fixed["multipliers"], fixed["policy_on"], slice(None), named)
            (gradient,) = torch.autograd.grad(loss.total.sum(), stacked)
        self._apply(gradient)
        if config.adaptive_rate:
            self.adapt(loss.kl_old)
        self._sums += torch.stack([getattr(loss, name) for name in REPORTED])

    def _apply(self, gradient: torch.Tensor) -> None:
        """Clip each candidate's gradient [P, D] by its own norm and take the step of all that still run."""
        norms = torch.linalg.vector_norm(gradient, dim=1)
        self._running &= norms.isfinite()
        scale = (self.config.max_grad_norm / (norms + 1e-6)).clamp(max=1.0)
        # `where` and not a product: NaN x 0 is NaN.
        clipped = torch.where(self._running.unsqueeze(1), gradient * scale.unsqueeze(1), 0.0)
        self._effective.copy_(torch.where(self._running, self._rates, 0.0))
        for vector, part in zip(self.population.vectors, clipped.unbind(), strict=True):
            vector.grad = part
        self.optimisers[0].step()

    def adapt(self, kl_old: torch.Tensor) -> None:
        """Rates / 1.5 above twice the desired KL, x 1.5 below half of it, per candidate (rsl_rl). kl_old [P], nats."""
        desired, rates = self.config.desired_kl, self._rates
        slower, faster = (rates / 1.5).clamp(min=LEAST_RATE), (rates * 1.5).clamp(max=MOST_RATE)
        wanted = torch.where((kl_old > 0) & (kl_old < desired / 2), faster, rates)
        rates.copy_(torch.where(kl_old > 2 * desired, slower, wanted))

    # --------------------------------------------------------------------------------------------------- capture

    def _captured(self, rows: torch.Tensor) -> torch.cuda.CUDAGraph:
        """The graph of `_step` on rows. Warming up takes steps; they are undone."""
        device, changed = self._rates.device, self._changed()
        before = [tensor.clone() for tensor in changed]
        known = {id(tensor) for tensor in changed}
        stream = torch.cuda.Stream(device)
        stream.wait_stream(torch.cuda.current_stream(device))
        with torch.cuda.stream(stream):
            for _ in range(WARM_UP):
                self._step(rows)
        torch.cuda.current_stream(device).wait_stream(stream)
        torch.cuda.synchronize(device)
        graph = torch.cuda.CUDAGraph()
        with torch.cuda.graph(graph):
            self._step(rows)
        with torch.no_grad():
            for tensor, value in zip(changed, before, strict=True):
                tensor.copy_(value)
            for tensor in self._changed():
                if id(tensor) not in known:  # moments that the first step made
                    tensor.zero_()
        return graph

    def _changed(self) -> list[torch.Tensor]:
        """Everything a step changes."""
        moments: list[Any] = [
            value
            for state in self.optimisers[0].state.values()
            for value in state.values()
            if isinstance(value, torch.Tensor)
        ]
        return [*self.population.vectors, self._rates, self._effective, self._running, self._sums, *moments]

    # ----------------------------------------------------------------------------------------------------- state

    @property
    def rates(self) -> list[float]:
        return self._rates.tolist()

    @rates.setter
    def rates(self, values: Sequence[float]) -> None:
        self._rates.copy_(torch.tensor(values))

    def halt(self, index: int) -> None:
        super().halt(index)
        self._running[index] = False
