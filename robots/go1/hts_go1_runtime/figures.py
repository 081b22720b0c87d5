"""What a session says of its own timing."""

from __future__ import annotations

import resource
import sys
from typing import Any

import numpy as np

from hts_go1_runtime.loop import Loop


def figures(loop: Loop) -> dict[str, Any]:
    """Step times in ms (from the wake-up at the deadline until the command was sent), how many commands left a whole
    period or more after they were due, memory, packets."""
    step, late = 1e3 * np.array(loop.step_seconds), 1e3 * np.array(loop.late_seconds)
    period = 1e3 * loop.period
    return {
        "steps": len(step),
        "step_ms_mean": round(float(step.mean()), 3),
        "step_ms_p999": round(float(np.quantile(step, 0.999)), 3),
        "step_ms_worst": round(float(step.max()), 3),
        "late_ms_mean": round(float(late.mean()), 3),
        "late_ms_p999": round(float(np.quantile(late, 0.999)), 3),
        "late_ms_worst": round(float(late.max()), 3),
        "missed_deadlines": int(np.count_nonzero(late >= period)),
        "memory_mb": round(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024, 1),
        "modules": len(sys.modules),
        "packets": vars(loop.link.counts) | {},
    }
