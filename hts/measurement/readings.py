"""When a sensor was read: many show one reading for several samples of a log."""

from __future__ import annotations

import numpy as np

LEAST_SHARE = 0.02  # of samples that differ from the one before; with fewer, nobody knows when it was read


def new_readings(target: np.ndarray) -> np.ndarray:
    """Whether a sample (T,) is a new reading: it differs from the sample before; the first one's age is unknown.

    A sensor of 5 Hz in a log of 50 Hz is one number ten times over, of which nine are old: what the robot does
    meanwhile explains nothing of them. All samples count where fewer than LEAST_SHARE of them differ.
    """
    new = np.zeros(len(target), dtype=bool)
    new[1:] = target[1:] != target[:-1]
    return new if new.mean() >= LEAST_SHARE else np.ones(len(target), dtype=bool)
