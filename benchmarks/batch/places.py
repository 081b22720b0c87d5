"""Where runs go on a machine: its cores and GPUs, and who has which."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol

from batch.methods import Job


@dataclass(frozen=True)
class Slot:
    """What one run may use. gpu: for CUDA_VISIBLE_DEVICES, "" hides all, None leaves the variable alone."""

    cores: tuple[int, ...]
    gpu: str | None = None


class Places(Protocol):
    """What runs share; `str()` of it says so in a few words."""

    def take(self, job: Job) -> Slot | None:
        """A slot for this run, None while there is none."""

    def give(self, slot: Slot) -> None:
        """Back from a run that has ended."""


class Slots:
    """So many, all alike or not, each for any run."""

    def __init__(self, slots: Sequence[Slot]) -> None:
        self._count, self._free = len(slots), list(slots)

    def __str__(self) -> str:
        return f"{self._count} at once"

    def take(self, job: Job) -> Slot | None:
        return self._free.pop(0) if self._free else None

    def give(self, slot: Slot) -> None:
        self._free.append(slot)


def slots_of(cores: int, gpus: Sequence[str] | None, jobs: int | None, available: Sequence[int]) -> Slots:
    """As many as there are cores for, GPUs in turn; `jobs` at most. At least one, on whatever cores there are."""
    count = max(1, len(available) // cores)
    count = min(count, jobs) if jobs else count
    return Slots(
        [
            Slot(
                tuple(available[index * cores : (index + 1) * cores]) or tuple(available),
                None if gpus is None else (gpus[index % len(gpus)] if gpus else ""),
            )
            for index in range(count)
        ]
    )


@dataclass(frozen=True)
class Need:
    """What a run asks for. gpu: whether it takes one; all are hidden from it otherwise."""

    cores: int
    gpu: bool = False


class Machine:
    """Cores and GPUs that runs of unlike needs share. A core has one run; a GPU has many, each new one goes where the
    cores of those that are on it are fewest. needs: by the job's key; each must fit on the machine alone."""

    def __init__(self, cores: Sequence[int], gpus: Sequence[str], needs: Mapping[str, Need]) -> None:
        self._count, self._free, self._needs = len(cores), sorted(cores), needs
        self._load = Counter(dict.fromkeys(gpus, 0))

    def __str__(self) -> str:
        return f"on {self._count} cores and {len(self._load)} GPUs"

    def take(self, job: Job) -> Slot | None:
        need = self._needs[job.key]
        if need.cores > len(self._free):
            return None
        taken, self._free = self._free[: need.cores], self._free[need.cores :]
        gpu = min(self._load, key=self._load.__getitem__) if need.gpu else ""
        if gpu:
            self._load[gpu] += need.cores
        return Slot(tuple(taken), gpu)

    def give(self, slot: Slot) -> None:
        self._free = sorted([*self._free, *slot.cores])
        if slot.gpu:
            self._load[slot.gpu] -= len(slot.cores)
