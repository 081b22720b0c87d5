"""The gradient steps of a batch on a GPU: all candidates in each, as one CUDA graph that is replayed."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import torch
from torch.nn import functional as F
from torch.optim.adam import adam

from hts.rl.capture import captured, warm_up
from hts.rl.population import ALIGNED, Population
from hts.rl.precision import tf32
from hts.rl.settings import UpdateSettings
from hts.rl.surrogate import population_loss
from hts.rl.tracing import TracedGraph, can_compile, compiled
from hts.rl.updates import REPORTED, GradientSteps, Samples, Stop, adapted


class BatchedSteps(GradientSteps):
    """Every step takes all candidates; nothing in it waits for the device.

    Learning rates, who still runs, and sums of losses live on the device; they are read once per batch. capture: as
    CUDA graphs, one for each size of minibatch; without it the same steps run one operation after the other.
    """

    def __init__(
        self,
        population: Population,
        config: UpdateSettings,
        stop: Stop,
        capture: bool,
        *,
        tf32: bool = True,
        fuse: bool | None = None,
    ) -> None:
        super().__init__(population, config, stop)
        count, device = population.count, population.device
        self._capture, self._tf32 = capture, tf32
        self._rates = torch.full((count,), config.learning_rate, device=device)
        self._running = torch.ones(count, dtype=torch.bool, device=device)
        # One long leaf, of which the candidates' vectors are views from now on.
        self._leaf = torch.nn.Parameter(population.stacked())
        for vector, row in zip(population.vectors, self._leaf.detach(), strict=True):
            vector.data = row[: len(vector)]
        self._moments = {name: torch.zeros_like(self._leaf.detach()) for name in ("exp_avg", "exp_avg_sq")}
        self._moments["step"] = torch.zeros((), device=device)
        self._fixed: dict[str, torch.Tensor] = {}
        self._rows: dict[int, torch.Tensor] = {}
        self._graphs: dict[int, torch.cuda.CUDAGraph] = {}
        self._fuse = capture and (can_compile(device) if fuse is None else fuse)
        self._losses = compiled(self._forward, device, self._fuse)
        self._update: Callable[..., Any] | None = None
        self._sums = torch.zeros(len(REPORTED), count, device=device)
        self._columns: dict[str, tuple[int, int, bool]] = {}

    # --------------------------------------------------------------------------------------------------- a batch

    def run(
        self,
        samples: Samples,
        constant: Samples,
        multipliers: torch.Tensor,
        orders: Sequence[torch.Tensor],
        policy_on: float,
    ) -> dict[str, torch.Tensor]:
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
        wide = [value if value.ndim == 3 else value.unsqueeze(-1) for value in samples.values()]
        # Side by side, each from a multiple of 16 bytes on: a minibatch is then gathered by whole rows, at once.
        padded = [F.pad(value, (0, -value.shape[-1] % ALIGNED)) for value in wide]
        self._columns, start = {}, 0
        for (name, value), broad, full in zip(samples.items(), wide, padded, strict=True):
            self._columns[name] = (start, broad.shape[-1], value.ndim == 2)
            start += full.shape[-1]
        first_rows = torch.arange(len(multipliers)).unsqueeze(1) * wide[0].shape[1]  # of each candidate's samples
        new = {
            **constant,
            "samples": torch.cat(padded, -1),
            "multipliers": multipliers,
            "policy_on": torch.tensor(policy_on),
            "first": first_rows,
        }
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
        taken = fixed["samples"].flatten(0, 1).index_select(0, (rows + fixed["first"]).flatten()).view(*rows.shape, -1)
        batch = {name: fixed[name] for name in self._constant}
        for name, (start, size, flat) in self._columns.items():
            batch[name] = taken[..., start] if flat else taken[..., start : start + size]
        # A leaf of its own: autograd remembers on which stream a leaf was first used, and a capture must know no other.
        leaf = self._leaf.detach().requires_grad_()
        with torch.enable_grad(), tf32(self._tf32):
            total, *parts = self._losses(leaf, batch, fixed["multipliers"], fixed["policy_on"])
            (gradient,) = torch.autograd.grad(total, leaf)
        with torch.no_grad():
            self._apply(gradient)
        if config.adaptive_rate:
            self.adapt(parts[REPORTED.index("kl_old")])
        self._sums += torch.stack(parts)

    def _forward(
        self, stacked: torch.Tensor, batch: Samples, multipliers: torch.Tensor, policy_on: torch.Tensor
    ) -> tuple[torch.Tensor, ...]:
        """The loss summed over candidates, which share no parameter, and what is reported of it, each [P]."""
        loss = population_loss(
            self.population,
            batch,
            multipliers,
            clip=self.config.clip,
            value_coef=self.config.value_coef,
            entropy_coef=self.config.entropy_coef,
            policy_on=policy_on,
            normalised=True,
            named=self.population.split(stacked),
        )
        return (loss.total.sum(), *(getattr(loss, name) for name in REPORTED))

    def _apply(self, gradient: torch.Tensor) -> None:
        """Clip each candidate's gradient [P, D] by its own norm and take the step of all that still run."""
        memory = [gradient, self._leaf.detach(), *self._moments.values(), self._rates, self._running]
        if self._update is None:
            self._update = TracedGraph(self._adam_step, memory) if self._fuse else self._adam_step
        self._update(*memory)

    def _adam_step(
        self,
        gradient: torch.Tensor,
        leaf: torch.Tensor,
        exp_avg: torch.Tensor,
        exp_avg_sq: torch.Tensor,
        step: torch.Tensor,
        rates: torch.Tensor,
        running: torch.Tensor,
    ) -> None:
        """In place: gradient, leaf and moments [P, D], step [], rates [P], running bool [P]."""
        norms = torch.linalg.vector_norm(gradient, dim=1)
        running &= norms.isfinite()
        scale = (self.config.max_grad_norm / (norms + 1e-6)).clamp(max=1.0)
        # `where` and not a product: NaN x 0 is NaN.
        clipped = torch.where(running.unsqueeze(1), gradient * scale.unsqueeze(1), 0.0)
        before = leaf.clone()
        # Adam's step is proportional to its rate: it is taken with rate 1 and then scaled by each candidate's own.
        adam(
            [leaf],
            [clipped],
            [exp_avg],
            [exp_avg_sq],
            [],
            [step],
            foreach=False,
            fused=not self._fuse,
            capturable=self._fuse or leaf.device.type == "cuda",
            amsgrad=False,
            beta1=0.9,
            beta2=0.999,
            lr=1.0,
            weight_decay=0.0,
            eps=1e-8,
            maximize=False,
        )
        leaf.copy_(torch.lerp(before, leaf, torch.where(running, rates, 0.0).unsqueeze(1)))

    def adapt(self, kl_old: torch.Tensor) -> None:
        """The candidates' next rates, from kl_old [P], nats."""
        self._rates.copy_(adapted(self._rates, kl_old, self.config.desired_kl))

    # --------------------------------------------------------------------------------------------------- capture

    def _captured(self, rows: torch.Tensor) -> torch.cuda.CUDAGraph:
        """The graph of `_step` on rows. Warming up takes steps; they are undone."""
        device, changed = self._rates.device, self._changed()
        before = [tensor.clone() for tensor in changed]
        warm_up(lambda: self._step(rows), device)
        graph, _ = captured(lambda: self._step(rows))
        with torch.no_grad():
            for tensor, value in zip(changed, before, strict=True):
                tensor.copy_(value)
        return graph

    def _changed(self) -> list[torch.Tensor]:
        """Everything a step changes."""
        return [self._leaf, self._rates, self._running, self._sums, *self._moments.values()]

    # ----------------------------------------------------------------------------------------------------- state

    @property
    def rates(self) -> list[float]:
        return self._rates.tolist()

    @rates.setter
    def rates(self, values: Sequence[float]) -> None:
        self._rates.copy_(torch.tensor(values))

    def state(self) -> dict[str, dict[str, torch.Tensor]]:
        if not bool(self._moments["step"]):
            return {}
        rows = zip(self._moments["exp_avg"].clone(), self._moments["exp_avg_sq"].clone(), strict=True)
        step = self._moments["step"]
        return {
            str(index): {"step": step.clone(), "exp_avg": average, "exp_avg_sq": square}
            for index, (average, square) in enumerate(rows)
        }

    def load_state(self, state: Mapping[str, Mapping[str, torch.Tensor]]) -> None:
        if not state:
            return
        rows = [state[str(index)] for index in range(self.population.count)]
        self._moments["step"].copy_(rows[0]["step"])
        for name in ("exp_avg", "exp_avg_sq"):
            self._moments[name].copy_(torch.stack([row[name] for row in rows]))

    def halt(self, index: int) -> None:
        super().halt(index)
        self._running[index] = False
