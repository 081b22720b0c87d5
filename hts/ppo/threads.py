"""Two levels of threads do not mix: physics and candidates get the cores, torch computes with one thread.

Torch's own threads go on spinning for a while after each product, on the cores that physics wants next; and products
of a single candidate are too small to share out (on a busy machine their threads wait for each other tenfold).
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager

import torch


@contextmanager
def one_thread() -> Iterator[None]:
    """Inside, torch computes with one thread."""
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(before)


def pool(most: int) -> ThreadPoolExecutor:
    """Threads for work that does not share anything, one per core at most, each with one torch thread."""
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    return ThreadPoolExecutor(max(1, min(most, cores)), "candidate", initializer=torch.set_num_threads, initargs=(1,))
