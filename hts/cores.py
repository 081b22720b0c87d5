"""How many processor cores this process may use."""

from __future__ import annotations

import os
import sys


def available() -> int:
    """Cores of this process, fewer than the machine's in a container or under `taskset`; at least 1."""
    if sys.platform == "linux":  # elsewhere nothing says which of the machine's cores are ours
        return len(os.sched_getaffinity(0)) or 1
    return os.cpu_count() or 1
