"""How many processor cores this process may use."""

from __future__ import annotations

import os


def available() -> int:
    """Cores of this process, fewer than the machine's in a container or under `taskset`; at least 1."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0)) or 1
    return os.cpu_count() or 1
