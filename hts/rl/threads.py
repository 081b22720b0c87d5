"""Two levels of threads do not mix: physics and candidates get the cores, torch computes with one thread.

Torch's own threads go on spinning for a while after each product, on the cores that physics wants next; and products
of a single candidate are too small to share out (on a busy machine their threads wait for each other tenfold). Sums on
one thread do not depend on how many cores there are either.
"""

from __future__ import annotations

from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager

import torch

from hts.cores import available


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
    return ThreadPoolExecutor(
        max(1, min(most, available())), "candidate", initializer=torch.set_num_threads, initargs=(1,)
    )
