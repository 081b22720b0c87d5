"""Live progress of a run: a bar with the time left on a terminal, plain lines elsewhere."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from rich.console import Console
from rich.progress import BarColumn, TextColumn, TimeElapsedColumn, TimeRemainingColumn
from rich.progress import Progress as Bars

START = 0.05  # share of a stage that says nothing of the rest: kernels are compiled, memory is taken


class Progress:
    """Stages one after the other. total: how many there are; index: the number of the last one that was begun or
    skipped; begun: how many were done here, rather than earlier."""

    def __init__(self, total: int, console: Console | None = None) -> None:
        self.console = console or Console()
        self.total, self.index, self.begun = total, 0, 0

    @contextmanager
    def stage(self, title: str) -> Iterator[Callable[[float], None]]:
        """Show a stage; yields a function that takes the share done, 0 to 1."""
        self.index += 1
        self.begun += 1
        label = f"[{self.index}/{self.total}] {title}"
        started = time.perf_counter()
        if self.console.is_terminal:
            columns = (
                TextColumn("{task.description}"),
                BarColumn(),
                TimeElapsedColumn(),
                TextColumn("left"),
                TimeRemainingColumn(),
            )
            with Bars(*columns, console=self.console, transient=True) as bars:
                task = bars.add_task(label, total=1.0)
                yield lambda share: bars.update(task, completed=share)
        else:
            self.console.print(label, highlight=False)
            yield self._plain(started)
        self.console.print(f"{label}: {time.perf_counter() - started:.1f} s", highlight=False)

    def _plain(self, started: float) -> Callable[[float], None]:
        shown = since = started
        before = 0.0

        def report(share: float) -> None:
            nonlocal shown, since, before
            now = time.perf_counter()
            if share < START:
                since, before = now, share
            if now - shown >= 15.0 and share > 0:  # a log file needs no more than that
                shown = now
                left = f", about {(now - since) * (1 - share) / (share - before):.0f} s left" if share > before else ""
                self.console.print(f"    {share:4.0%}{left}", highlight=False)

        return report

    def skip(self, count: int) -> None:
        """So many stages were finished earlier."""
        self.index += count

    def leave_out(self, count: int) -> None:
        """So many stages that were counted are not there after all."""
        self.total -= count

    def say(self, text: str) -> None:
        """One line."""
        self.console.print(text, highlight=False, soft_wrap=True)
