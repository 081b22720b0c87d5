"""Training curves of an iteration, as TensorBoard reads them."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Self

from torch.utils.tensorboard import SummaryWriter

from hts.training.sweep import Candidate
from hts.training.trainer import BatchStats


class Curves:
    """One curve a number and candidate, over control steps of that candidate, in `folder`.

    goes_on: a stopped training goes on. What was written beyond the step that it goes on from comes again, so
    TensorBoard is told to forget the first of the two. A context manager: closed at its end, whatever happened.
    """

    def __init__(self, folder: Path, *, goes_on: bool = False) -> None:
        self._folder, self._goes_on = folder, goes_on
        self._writer: SummaryWriter | None = None

    def add(self, stats: BatchStats, members: Sequence[Candidate]) -> None:
        """The numbers of a batch."""
        step = stats.steps // len(members)
        if self._writer is None:
            self._writer = SummaryWriter(str(self._folder), purge_step=step if self._goes_on else None)
        for name, values in stats.values.items():
            for member, value in zip(members, values, strict=True):
                self._writer.add_scalar(f"{name}/{member.id}", value, step)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        if self._writer is not None:
            self._writer.close()
