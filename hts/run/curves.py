"""Training curves of an iteration, as TensorBoard reads them."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Self

from torch.utils.tensorboard import SummaryWriter

from hts.training.sweep import Candidate
from hts.training.trainer import BatchStats


class Curves:
    """One curve a number, over control steps of one candidate, in a folder of each candidate's own below `folder`, so
    that TensorBoard takes candidates as runs and draws them into one chart.

    goes_on: a stopped training goes on. What was written beyond the step that it goes on from comes again, so
    TensorBoard is told to forget the first of the two. A context manager: closed at its end, whatever happened.
    """

    def __init__(self, folder: Path, *, goes_on: bool = False) -> None:
        self._folder, self._goes_on = folder, goes_on
        self._writers: dict[str, SummaryWriter] = {}

    def add(self, stats: BatchStats, members: Sequence[Candidate]) -> None:
        """The numbers of a batch."""
        step = stats.steps // len(members)
        for member in members:
            if member.id not in self._writers:
                folder, forget = str(self._folder / member.id), step if self._goes_on else None
                self._writers[member.id] = SummaryWriter(folder, purge_step=forget)
        for name, values in stats.values.items():
            for member, value in zip(members, values, strict=True):
                self._writers[member.id].add_scalar(name, value, step)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        for writer in self._writers.values():
            writer.close()
