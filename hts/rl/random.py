"""Random numbers of a population: one generator per candidate, so that nobody's stream depends on the others."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import torch

EXPLORATION_SEED = 101  # added to a candidate's seed: its noise is not drawn from the stream that its env draws from


class PrefetchedNoise:
    """The numbers of several steps drawn at once, before the first of them: a step that is a captured graph then only
    looks up its row, and many small draws become few large ones.

    random: whose generators draw; steps: how many; time (1,): the step that is running, on the device.
    """

    def __init__(self, random: PopulationRandom, steps: int, time: torch.Tensor) -> None:
        self.random, self.steps, self.time = random, steps, time
        self._drawn: list[tuple[str, tuple[int, ...], torch.Tensor]] = []
        self._count = 0

    def begin_step(self) -> None:
        """A step begins; it makes the same draws in the same order as every other."""
        self._count = 0

    def next(self, kind: str, shape: tuple[int, ...]) -> torch.Tensor:
        """The numbers [P, *shape] of the running step's next draw."""
        if self._count == len(self._drawn):
            room = torch.empty(len(self.random.generators), self.steps, *shape, device=self.random.device)
            self._drawn.append((kind, shape, self.random.fill(kind, room)))
        known, size, numbers = self._drawn[self._count]
        if (known, size) != (kind, shape):
            raise RuntimeError(f"draw {self._count} of a step was {known}{size}, now it is {kind}{shape}")
        self._count += 1
        return numbers.index_select(1, self.time).squeeze(1)

    def renew(self) -> None:
        """Draw the numbers of the next steps."""
        for kind, _, numbers in self._drawn:
            self.random.fill(kind, numbers)


class PopulationRandom:
    """P generators on one device; every draw has shape [P, ...].

    seeds: one per candidate. A candidate that keeps its seed draws the same numbers alone and in a crowd.
    prefetched: where the numbers of a step come from instead, once a collector has set it.
    """

    def __init__(self, seeds: Sequence[int], device: torch.device) -> None:
        self.device = device
        self.generators = [torch.Generator(device).manual_seed(int(seed)) for seed in seeds]
        self.prefetched: PrefetchedNoise | None = None

    @classmethod
    def joined(cls, parts: Sequence[PopulationRandom]) -> PopulationRandom:
        """The candidates of all parts: the same generators, not copies."""
        whole = cls((), parts[0].device)
        whole.generators = [generator for part in parts for generator in part.generators]
        return whole

    def of(self, members: slice) -> PopulationRandom:
        """Some candidates: the same generators, not copies."""
        part = PopulationRandom((), self.device)
        part.generators = self.generators[members]
        return part

    def seed(self, seed: int) -> None:
        """Begin anew: candidate p draws from seed + p."""
        for index, generator in enumerate(self.generators):
            generator.manual_seed(seed + index)

    def uniform(self, *shape: int) -> torch.Tensor:
        """Uniform in [0, 1), shape [P, *shape]."""
        return self._draw("uniform_", shape)

    def normal(self, *shape: int) -> torch.Tensor:
        """Standard normal, shape [P, *shape]."""
        return self._draw("normal_", shape)

    def begin_step(self) -> None:
        """A step begins, for numbers that are prefetched."""
        if self.prefetched is not None:
            self.prefetched.begin_step()

    def renew(self) -> None:
        """A batch of steps begins, for numbers that are prefetched."""
        if self.prefetched is not None:
            self.prefetched.renew()

    def _draw(self, kind: str, shape: tuple[int, ...]) -> torch.Tensor:
        if self.prefetched is not None:
            return self.prefetched.next(kind, shape)
        return self.fill(kind, torch.empty(len(self.generators), *shape, device=self.device))

    def fill(self, kind: str, out: torch.Tensor) -> torch.Tensor:
        """Fill out [P, ...], each row from its own generator; kind: a torch method that fills."""
        for row, generator in zip(out, self.generators, strict=True):
            getattr(row, kind)(generator=generator)
        return out

    def state_dict(self) -> dict[str, torch.Tensor]:
        return {"generators": torch.stack([generator.get_state() for generator in self.generators])}

    def load_state_dict(self, state: Mapping[str, torch.Tensor]) -> None:
        """Go on from `state_dict`. Raises ValueError for one of another number of candidates."""
        if len(state["generators"]) != len(self.generators):
            raise ValueError(
                f"The saved random numbers are of {len(state['generators'])} candidates, expected those of "
                f"{len(self.generators)}: they are of another training."
            )
        for generator, saved in zip(self.generators, state["generators"], strict=True):
            generator.set_state(saved.cpu().clone())
