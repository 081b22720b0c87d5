"""Processes that work side by side, and end when the one that began them does."""

from __future__ import annotations

import multiprocessing
import os
import threading
import time
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager

PARENT_SECONDS = 1.0  # between two looks whether the parent is there


@contextmanager
def worker_processes(number: int) -> Iterator[ProcessPoolExecutor]:
    """So many, each with nothing of this one's memory. What was not begun when they are done with is not begun."""
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(number, mp_context=context, initializer=_begin, initargs=(os.getpid(),)) as pool:
        try:
            yield pool
        finally:
            pool.shutdown(cancel_futures=True)


def _begin(parent: int) -> None:
    """In a new process, before it loads anything large."""
    os.environ["MUJOCO_GL"] = "disable"  # nothing is drawn, so no library need look for a display, and warn without one
    end_with(parent)


def end_with(parent: int) -> None:
    """This process ends when its parent does, even if that is killed in the midst of a draw."""

    def watch() -> None:
        while os.getppid() == parent:
            time.sleep(PARENT_SECONDS)
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()
