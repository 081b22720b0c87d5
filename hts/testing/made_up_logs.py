"""A made-up log of a machine with two joints, as columns and as text: for examples and tests of log readers."""

from __future__ import annotations

import json

import numpy as np

IDLE = 1.9
"""What the column `current` shows with electronics on and motors idle, A."""


def walk_columns() -> dict[str, np.ndarray]:
    """20 s at 100 Hz: t ms, tau_left, tau_right N·m, dq_left, dq_right rad/s, current A; (rows,) each, rounded as
    loggers do.

    The current is 1.9 + Σ(|τ q̇| / 2 + τ²), shown about 0.1 s late: what a fit should find.
    """
    random, rate_hz = np.random.default_rng(0), 100.0
    time = np.arange(2000) / rate_hz
    phase = 2 * np.pi * 1.3 * time + random.normal(0, 0.05, len(time)).cumsum()
    swell = 1.0 + 0.5 * np.sin(0.9 * time)
    torque = np.stack([0.4 * swell * np.sin(phase + lag) for lag in (0.0, 2.0)], axis=1)
    speed = np.stack([6.0 * swell * np.sin(phase + lag + 0.6) for lag in (0.0, 2.0)], axis=1)
    now = (np.abs(torque * speed) / 2 + torque**2).sum(axis=1)
    shown, level = np.empty(len(now)), float(now[0])
    for row, value in enumerate(now):
        level += (value - level) / (0.1 * rate_hz)
        shown[row] = IDLE + level
    return {
        "t": (1000 * time).round().astype(int),
        "tau_left": torque[:, 0].round(4),
        "tau_right": torque[:, 1].round(4),
        "dq_left": speed[:, 0].round(3),
        "dq_right": speed[:, 1].round(3),
        "current": (shown + random.normal(0, 0.02, len(time))).round(3),
    }


def as_csv(columns: dict[str, np.ndarray]) -> str:
    """The same as comma-separated text, names in the first line."""
    rows = zip(*(values.tolist() for values in columns.values()), strict=True)
    return "\n".join([",".join(columns), *(",".join(map(str, row)) for row in rows)]) + "\n"


def as_json_lines(columns: dict[str, np.ndarray]) -> str:
    """The same as one JSON object a line."""
    rows = zip(*(values.tolist() for values in columns.values()), strict=True)
    return "".join(json.dumps(dict(zip(columns, row, strict=True))) + "\n" for row in rows)
