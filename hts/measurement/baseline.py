"""The analytic stand-in of an objective as a prediction of its target: what a measurement model has to beat.

It gets every chance that a line can give it: scale, offset and delay are fitted to the training recordings
(`plain`), and once more with a moving average of fitted length (`smoothed`), since sensors average.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import torch

from hts.measurement.scoring import SETTLE_SECONDS, Trace, scores

if TYPE_CHECKING:
    from hts.contracts import Objective
    from hts.recordings.recording import Recording

LONGEST_DELAY_SECONDS = 0.3
WINDOWS_SECONDS = (0.0, 0.04, 0.1, 0.16, 0.2, 0.24, 0.3, 0.4, 0.5)  # 0: no averaging


@dataclass(frozen=True)
class ProxyFit:
    """target(t) ≈ scale · mean of the stand-in over [t − delay − window, t − delay] + offset."""

    scale: float
    offset: float
    delay_samples: int
    window_samples: int

    def predict(self, proxy: np.ndarray) -> np.ndarray:
        """From the stand-in along a recording (T,) to the target (T,)."""
        return self.scale * shifted(proxy, self.delay_samples, self.window_samples) + self.offset


def shifted(series: np.ndarray, delay: int, window: int) -> np.ndarray:
    """Moving average over the last `window` samples, `delay` samples late; the start is padded with the first value."""
    padded = np.concatenate((np.full(delay + window - 1, series[0]), series)).astype(np.float64)
    total = np.cumsum(np.concatenate(([0.0], padded)))
    return ((total[window:] - total[:-window]) / window)[: len(series)]


def proxy_along(objective: Objective, recording: Recording) -> np.ndarray | None:
    """The stand-in at each sample of a recording, (T,); None if the objective has none."""
    channels = {name: torch.from_numpy(np.array(recording.values(name))) for name in objective.inputs}
    proxy = objective.proxy(channels)
    return None if proxy is None else proxy.reshape(-1).double().numpy()


def fit_proxy(
    objective: Objective, training: Sequence[Recording], windows: Sequence[float] = (0.0,)
) -> ProxyFit | None:
    """The line, delay and window with the least squared error on the training recordings; None without stand-in."""
    pairs, rate = [], 0.0
    for recording in training:
        proxy = proxy_along(objective, recording)
        if proxy is None:
            return None
        pairs.append((proxy, recording.values(objective.target.name).reshape(-1).astype(np.float64)))
        rate = recording.rate_hz
    if not pairs:
        return None
    skip = round(SETTLE_SECONDS * rate)
    y = np.concatenate([target[skip:] for _, target in pairs])
    best, least = None, np.inf
    for window in sorted({max(1, round(seconds * rate)) for seconds in windows}):
        for delay in range(round(LONGEST_DELAY_SECONDS * rate) + 1):
            x = np.concatenate([shifted(proxy, delay, window)[skip:] for proxy, _ in pairs])
            variance = x.var()
            scale = float(((x - x.mean()) * (y - y.mean())).mean() / variance) if variance > 0 else 0.0
            offset = float(y.mean() - scale * x.mean())
            error = float(((y - scale * x - offset) ** 2).mean())
            if error < least:
                best, least = ProxyFit(scale, offset, delay, window), error
    return best


def check_proxy(
    objective: Objective, held_out: Sequence[Recording], training: Sequence[Recording]
) -> dict[str, Any] | None:
    """Scores of the stand-in on held-out recordings: {"plain": …, "smoothed": …}; None without stand-in."""
    report = {}
    seen = {recording.policy_hash for recording in training}
    for name, windows in (("plain", (0.0,)), ("smoothed", WINDOWS_SECONDS)):
        fitted = fit_proxy(objective, training, windows)
        if fitted is None:
            return None
        traces = []
        for recording in held_out:
            proxy = proxy_along(objective, recording)
            if proxy is not None:
                traces.append(Trace.of(recording, objective.target.name, fitted.predict(proxy)))
        report[name] = asdict(fitted) | scores(traces, seen)
    return report
