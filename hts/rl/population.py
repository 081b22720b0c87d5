"""Actor and critic of P candidates, stacked so that one program runs and trains all of them."""

from __future__ import annotations

import copy
import functools
import itertools
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import torch
from torch import nn
from torch.nn import functional as F

from hts.rl.given import OfItsSizes
from hts.rl.threads import pool
from hts.rl.tracing import compiled

LONG = 8192  # samples per candidate from which on a GPU takes candidates in turn: a product adds its bias only there
MANY = 512  # samples per candidate from which on a CPU takes halves of them side by side
BLOCK = 64  # samples: a half is so many times a whole number, as products want it
ALIGNED = 8  # numbers; rows of matrices on a GPU begin at a multiple
PARTIAL = 64  # sums side by side
CLIP = 10.0  # of normalised observations

Parameters = list[dict[str, torch.Tensor]] | Mapping[str, torch.Tensor]
"""By name: a list of dicts on a CPU, one of them for each candidate, one dict of stacked ones [P, ...] on a GPU."""


@functools.cache
def _activated(device: torch.device) -> Callable[[torch.Tensor, torch.Tensor], torch.Tensor]:
    """ELU of x + bias; on a GPU in one pass over memory, of any shape."""

    def activated(x: torch.Tensor, bias: torch.Tensor) -> torch.Tensor:
        return F.elu(x + bias)

    return compiled(activated, device, dynamic=True)


def split_of(count: int, length: int) -> int:
    """Into how many parts a GPU splits each candidate's samples to sum gradients: the sums over 18 candidates keep half
    of an H200 busy, partial sums all of it. As many as give at most `PARTIAL` sums, of 512 samples or more."""
    most = max(1, min(PARTIAL // count, length // 512))
    return next(parts for parts in range(most, 0, -1) if length % parts == 0)


@dataclass(frozen=True)
class Sizes:
    """Layer sizes: observation, critic observation, action; hidden layers are shared by actor and critic."""

    observation: int
    critic_observation: int
    action: int
    hidden: tuple[int, ...] = (256, 128)

    def layers(self, first: int, last: int) -> list[tuple[int, int]]:
        """(inputs, outputs) of each linear layer."""
        widths = (first, *self.hidden, last)
        return list(itertools.pairwise(widths))

    def shapes(self) -> dict[str, tuple[int, ...]]:
        """Name and shape of every parameter of one candidate, in the order in which they lie in its vector."""
        shapes: dict[str, tuple[int, ...]] = {}
        for part, first, last in (("actor", self.observation, self.action), ("critic", self.critic_observation, 1)):
            for index, (inputs, outputs) in enumerate(self.layers(first, last)):
                shapes[f"{part}.{index}.weight"] = (outputs, inputs)
                shapes[f"{part}.{index}.bias"] = (outputs,)
        shapes["log_std"] = (self.action,)
        return shapes

    def normalisers(self) -> dict[str, tuple[int, ...]]:
        """Name and shape of what one candidate's two normalisers hold."""
        sizes = {"observation": self.observation, "critic_observation": self.critic_observation}
        shapes: dict[str, tuple[int, ...]] = {
            f"{name}_{what}": (size,) for name, size in sizes.items() for what in ("mean", "std")
        }
        return shapes | {f"{name}_count": () for name in sizes}


class Population(OfItsSizes):
    """P actor-critics: a = N(mean(o), diag sigma^2), v = V(o_critic), both on normalised observations.

    A candidate's parameters are one vector, so that optimiser, clipping and learning rate are per candidate for free.
    On the CPU the candidates are computed one by one: the matrices are the same whoever else trains, so a
    candidate's numbers do not change in a crowd by as much as a rounding. On a GPU they are one batched product.
    """

    def __init__(
        self, sizes: Sizes, count: int, init_std: float = 1.0, seed: int = 0, device: torch.device | str = "cpu"
    ) -> None:
        super().__init__()
        self.sizes, self.count = sizes, count
        self._shapes = sizes.shapes()
        self._lengths = [torch.Size(shape).numel() for shape in self._shapes.values()]
        vectors = [self._initial_vector(init_std, seed + index) for index in range(count)]
        self.vectors = nn.ParameterList([nn.Parameter(vector.to(device)) for vector in vectors])
        for name, size in (("observation", sizes.observation), ("critic_observation", sizes.critic_observation)):
            self.register_buffer(f"{name}_mean", torch.zeros(count, 1, size, device=device))
            self.register_buffer(f"{name}_std", torch.ones(count, 1, size, device=device))
            self.register_buffer(f"{name}_count", torch.zeros(count, device=device))
        self._stacked: torch.Tensor | None = None
        self._versions: list[int] = []
        self._cache: Parameters | None = None

    def _initial_vector(self, init_std: float, seed: int) -> torch.Tensor:
        generator = torch.Generator().manual_seed(seed)
        parts = []
        for name, shape in self._shapes.items():
            if name == "log_std":
                parts.append(torch.full(shape, init_std).log())
            elif name.endswith("bias"):
                parts.append(torch.zeros(shape))
            else:
                weight = torch.empty(shape)
                last = name in (f"actor.{len(self.sizes.hidden)}.weight",)
                nn.init.orthogonal_(weight, gain=0.01 if last else 2**0.5, generator=generator)
                parts.append(weight)
        return torch.cat([part.reshape(-1) for part in parts])

    # -------------------------------------------------------------------------------------- parameters by name

    @property
    def device(self) -> torch.device:
        return self.vectors[0].device

    def split(self, vector: torch.Tensor) -> dict[str, torch.Tensor]:
        """Named views of a candidate's vector [D], or of all of them stacked [P, D or more]."""
        parts = vector[..., : sum(self._lengths)].split(self._lengths, dim=-1)
        lead = vector.shape[:-1]
        return {name: part.view(*lead, *shape) for (name, shape), part in zip(self._shapes.items(), parts, strict=True)}

    def named(self) -> Parameters:
        """Parameters as the forward pass wants them: a list of P dicts on the CPU, one stacked dict on a GPU."""
        vectors = list(self.vectors)
        if self.device.type == "cpu":
            return [self.split(vector) for vector in vectors]
        return self.split(torch.stack(vectors))

    def stacked(self) -> torch.Tensor:
        """A copy of all vectors, [P, D and zeros up to a multiple of `ALIGNED`]:
        matrix units read 16 bytes at a time."""
        vectors = torch.stack([vector.detach() for vector in self.vectors])
        return F.pad(vectors, (0, -vectors.shape[1] % ALIGNED))

    def refresh(self) -> None:
        """Renew what `mean` and `value` use without gradients; call after every change of parameters.

        On the CPU weights are copied, if they have changed, laid out by column: a product with few observations is then
        twice as fast. On a GPU they are copied to where they were before, which is where a captured graph reads them.
        A copy of the population makes its own.
        """
        before, self._versions = self._versions, self._now()
        with torch.no_grad():
            if self.device.type == "cpu":
                if self._cache is not None and before == self._versions:
                    return
                self._cache = [
                    {
                        name: v.t().contiguous().t() if v.ndim == 2 else v.clone()
                        for name, v in self.split(vector.clone()).items()  # one row is already laid out by column
                    }
                    for vector in self.vectors
                ]
                return
            stacked = self.stacked()
            if self._stacked is None or self._stacked.device != stacked.device:
                self._stacked = stacked
                self._cache = self.split(stacked)
            else:
                self._stacked.copy_(stacked)

    # ------------------------------------------------------------------------------------------------ forward

    def _one(self, part: str, x: torch.Tensor, one: Mapping[str, torch.Tensor]) -> torch.Tensor:
        """The network of a single candidate: x [B, inputs] -> [B, outputs]."""
        last = len(self.sizes.hidden)
        for index in range(last + 1):
            weight = one[f"{part}.{index}.weight"]
            if index == 0 and x.shape[-1] > weight.shape[-1]:  # `normalised` has added zeros
                weight = F.pad(weight, (0, x.shape[-1] - weight.shape[-1]))
            x = F.linear(x, weight, one[f"{part}.{index}.bias"])
            if index < last:
                x = F.elu_(x)
        return x

    def _each(self, part: str, x: torch.Tensor, named: Sequence[Mapping[str, torch.Tensor]]) -> torch.Tensor:
        """Candidate by candidate, x [P, B, inputs] -> [P, B, outputs]; in halves and side by side where they take
        longer than handing them to threads does, but not with parameters that somebody gave: `vmap`, in which TorchRL
        evaluates values, knows one thread."""
        if x.shape[1] < MANY or torch.is_grad_enabled() or named is not self._cache:
            return torch.stack([self._one(part, row, one) for row, one in zip(x.unbind(0), named, strict=True)])

        @torch.no_grad()  # known to each thread for itself
        def run(rows: torch.Tensor, one: Mapping[str, torch.Tensor]) -> torch.Tensor:
            return self._one(part, rows, one)

        half = x.shape[1] // (2 * BLOCK) * BLOCK
        halves = [rows for row in x.unbind(0) for rows in (row[:half], row[half:])]
        with pool(len(halves)) as threads:
            parts = list(threads.map(run, halves, [one for one in named for _ in range(2)]))
        return torch.cat(parts).view(*x.shape[:2], -1)

    def _mlp(self, part: str, x: torch.Tensor, named: Parameters) -> torch.Tensor:
        """x [P, B, inputs] -> [P, B, outputs]."""
        last = len(self.sizes.hidden)
        if isinstance(named, list):
            return self._each(part, x, named)
        if x.shape[1] >= LONG and not torch.is_grad_enabled():
            each = range(len(x))
            rows = [self._one(part, x[row], {name: value[row] for name, value in named.items()}) for row in each]
            return torch.stack(rows)
        count, length = x.shape[:2]
        parts = split_of(count, length) if torch.is_grad_enabled() else 1
        if parts > 1:
            x = x.reshape(count * parts, length // parts, x.shape[2])
            layers = [f"{part}.{index}.{what}" for index in range(last + 1) for what in ("weight", "bias")]
            named = {
                name: named[name].unsqueeze(1).expand(-1, parts, *named[name].shape[1:]).flatten(0, 1)
                for name in layers
            }
        for index in range(last + 1):
            weight = named[f"{part}.{index}.weight"]
            if index == 0 and x.shape[-1] > weight.shape[-1]:
                weight = F.pad(weight, (0, x.shape[-1] - weight.shape[-1]))
            x, bias = torch.bmm(x, weight.mT), named[f"{part}.{index}.bias"].unsqueeze(1)
            if index == last:
                x = x + bias
            elif torch.is_grad_enabled():  # compiled as a whole, if at all
                x = F.elu(x + bias)
            else:
                x = _activated(x.device)(x, bias)
        return x.reshape(count, length, -1)

    def normalised(self, name: str, x: torch.Tensor, members: slice = slice(None)) -> torch.Tensor:
        """Observations or critic observations [P, B, size] as the networks see them; on a GPU with zeros up to a size
        that its matrix units can read. members: whose rows x holds."""
        mean, std = getattr(self, f"{name}_mean")[members], getattr(self, f"{name}_std")[members]
        x = (x - mean).div_(std).clamp(-CLIP, CLIP)  # not in place: `vmap` knows no clamp_
        return x if x.device.type == "cpu" else F.pad(x, (0, -x.shape[-1] % ALIGNED))

    def mean(
        self,
        observation: torch.Tensor,
        named: Parameters | None = None,
        normalised: bool = False,
        members: slice = slice(None),
    ) -> torch.Tensor:
        """Mean action [P, B, J] of observations [P, B, O]; normalised: they are already; members: whose they are."""
        if named is None:
            named = self._ready(members)
        x = observation if normalised else self.normalised("observation", observation, members)
        return self._mlp("actor", x, named)

    def log_std(self, named: Parameters | None = None) -> torch.Tensor:
        """log sigma [P, 1, J]."""
        if named is None:
            named = self._ready()
        if isinstance(named, list):
            return torch.stack([one["log_std"] for one in named]).unsqueeze(1)
        return named["log_std"].unsqueeze(1)

    def value(
        self, critic_observation: torch.Tensor, named: Parameters | None = None, normalised: bool = False
    ) -> torch.Tensor:
        """V [P, B] of critic observations [P, B, O_c]; normalised: they are already."""
        if named is None:
            named = self._ready()
        x = critic_observation if normalised else self.normalised("critic_observation", critic_observation)
        return self._mlp("critic", x, named).squeeze(-1)

    def value_of(self, index: int, critic_observation: torch.Tensor) -> torch.Tensor:
        """V [B] of one candidate, of critic observations [B, O_c]."""
        member = slice(index, index + 1)
        x = self.normalised("critic_observation", critic_observation.unsqueeze(0), member)
        return self._mlp("critic", x, self._ready(member)).view(-1)

    def _ready(self, members: slice = slice(None)) -> Parameters:
        if self._cache is None or self._now() != self._versions:
            self.refresh()
        assert self._cache is not None  # `refresh` has made it
        if members == slice(None):
            return self._cache
        if isinstance(self._cache, list):
            return self._cache[members]
        return {name: value[members] for name, value in self._cache.items()}

    def _now(self) -> list[int]:
        """How often each candidate's parameters have been changed, also by an optimiser."""
        return [vector._version for vector in self.vectors]

    def __getstate__(self) -> dict[str, Any]:
        # What copying asks for: the parameters of a copy count their changes from 0 again.
        return {**self.__dict__, "_stacked": None, "_versions": [], "_cache": None}

    def _apply(self, fn: Callable[[torch.Tensor], torch.Tensor], recurse: bool = True) -> Population:
        # What .to(device), .double(), ... call.
        self._versions = []  # counts nothing: the copies are of other parameters now
        return super()._apply(fn, recurse)

    # --------------------------------------------------------------------------------------------- normaliser

    @torch.no_grad()
    def update_normaliser(self, name: str, x: torch.Tensor) -> None:
        """Fold x [P, B, size] into the running mean and variance (Chan et al. 1979). Pretraining only:
        fine-tuning keeps the anchor's normaliser, else the anchor would drift with it."""
        mean, std, count = (getattr(self, f"{name}_{what}") for what in ("mean", "std", "count"))
        batch = x.shape[1]
        if x.device.type == "cpu":  # row by row: torch may order the sums of [P, B, size] differently for different P
            new_var, new_mean = (
                torch.stack(parts)
                for parts in zip(*(torch.var_mean(row, 0, correction=0, keepdim=True) for row in x), strict=True)
            )
        else:
            new_var, new_mean = torch.var_mean(x, 1, correction=0, keepdim=True)
        total = count + batch
        share = (batch / total).view(-1, 1, 1)
        delta = new_mean - mean
        variance = std.square() * (1 - share) + new_var * share + delta.square() * share * (1 - share)
        mean += delta * share
        std.copy_(variance.clamp(min=1e-4).sqrt())
        count.copy_(total.clamp(max=1e8))

    # --------------------------------------------------------------------------------------- single candidates

    def candidate(self, index: int) -> dict[str, torch.Tensor]:
        """Everything of one candidate, by name, on the CPU; what a policy file holds."""
        state = {
            name: value.detach().cpu().clone().contiguous() for name, value in self.split(self.vectors[index]).items()
        }
        for name in ("observation", "critic_observation"):
            for what in ("mean", "std"):
                state[f"{name}_{what}"] = getattr(self, f"{name}_{what}")[index, 0].cpu().clone()
            state[f"{name}_count"] = getattr(self, f"{name}_count")[index].cpu().clone()
        return state

    @classmethod
    def from_candidates(
        cls, sizes: Sizes, candidates: Sequence[Mapping[str, torch.Tensor]], device: torch.device | str = "cpu"
    ) -> Population:
        """A population whose members start as these. Raises ValueError for what is not of these sizes."""
        for index, state in enumerate(candidates):
            for name, shape in {**sizes.shapes(), **sizes.normalisers()}.items():
                found = tuple(state[name].shape) if name in state else "missing"
                if found != shape:
                    raise ValueError(f"candidate {index}: '{name}' is {found}, expected {shape}, as {sizes} says.")
        population = cls(sizes, len(candidates), device=device)
        with torch.no_grad():
            for index, state in enumerate(candidates):
                vector = torch.cat([state[name].reshape(-1) for name in population._shapes])
                population.vectors[index].copy_(vector)
                for name in ("observation", "critic_observation"):
                    for what in ("mean", "std"):
                        getattr(population, f"{name}_{what}")[index, 0] = state[f"{name}_{what}"].to(device)
                    getattr(population, f"{name}_count")[index] = state[f"{name}_count"].to(device)
        return population

    def frozen(self) -> Population:
        """A copy that never changes: the anchor, its observation normaliser included."""
        return copy.deepcopy(self).requires_grad_(False).eval()
