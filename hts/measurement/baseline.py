"""The analytic stand-in of an objective as a prediction of its target: what a measurement model has to beat.

It gets every chance that a line can give it: scale, offset and delay are fitted to the training recordings
(`plain`), and once more with a moving average of fitted length (`smoothed`), since sensors average.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from hts.measurement.proxy import has_proxy, proxy_along, proxy_series
from hts.measurement.scoring import Trace, one_a_sample, scores, unscored, varies

if TYPE_CHECKING:
    from hts.contracts import Objective, Signals
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


StandIn = Callable[[Mapping[str, np.ndarray]], np.ndarray]
"""From channels (T, ...) by name to a stand-in (T,)."""


def stand_ins(objective: Objective, signals: Signals) -> dict[str, StandIn]:
    """What may stand for the target, by formula: the objective's own, or, where it has none, the generic ones of the
    inputs there are: sums over components of |x|, x², and |x·y| and max(x·y, 0) of two channels of one size."""

    def own(channels: Mapping[str, np.ndarray]) -> np.ndarray | None:
        return proxy_series(objective, channels, "a recording")

    if has_proxy(objective, signals.inputs):
        return {"its own": own}  # type: ignore[dict-item]
    sizes = dict(zip(signals.names, signals.sizes, strict=True))
    found: dict[str, StandIn] = {}
    for one in sizes:
        found[f"Σ|{one}|"] = partial(_sum_of, one, None, np.abs)
        found[f"Σ {one}²"] = partial(_sum_of, one, one, np.asarray)
    for one, two in itertools.combinations(sizes, 2):
        if sizes[one] == sizes[two]:
            found[f"Σ|{one}·{two}|"] = partial(_sum_of, one, two, np.abs)
            found[f"Σ max({one}·{two}, 0)"] = partial(_sum_of, one, two, partial(np.maximum, 0.0))
    return found


def _sum_of(
    first: str, second: str | None, shape: Callable[[np.ndarray], np.ndarray], channels: Mapping[str, np.ndarray]
) -> np.ndarray:
    """Σ over components of a channel, or of its product with another, each bent by `shape`: (T,)."""
    values = _flat(channels[first])
    return shape(values if second is None else values * _flat(channels[second])).sum(1)


def fit_best(
    candidates: Mapping[str, StandIn], target: str, training: Sequence[Recording], windows: Sequence[float] = (0.0,)
) -> tuple[str, ProxyFit]:
    """The stand-in, of those named, whose line has the least squared error on the training recordings."""
    fits = {}
    for name, formula in candidates.items():
        pairs = []
        for one in training:
            stand_in = formula({key: one.values(key) for key in one.channels}).astype(np.float64)
            pairs.append((stand_in, one_a_sample(one, target), one))
        fits[name] = _fit_line(pairs, windows)
    best = min(fits, key=lambda name: fits[name][1])
    return best, fits[best][0]


def fit_proxy(
    objective: Objective, training: Sequence[Recording], windows: Sequence[float] = (0.0,)
) -> ProxyFit | None:
    """The line, delay and window with the least squared error on the training recordings; None without stand-in."""
    pairs = []
    for recording in training:
        proxy = proxy_along(objective, recording)
        if proxy is None:
            return None
        pairs.append((proxy, one_a_sample(recording, objective.target.name), recording))
    return _fit_line(pairs, windows)[0] if pairs else None


def _fit_line(
    pairs: Sequence[tuple[np.ndarray, np.ndarray, Recording]], windows: Sequence[float]
) -> tuple[ProxyFit, float]:
    """From stand-in (T,), target (T,) and recording of each: the line, and its mean squared error."""
    skips, rate = [unscored(recording) for _, _, recording in pairs], pairs[-1][2].rate_hz
    y = np.concatenate([target[skip:] for skip, (_, target, _) in zip(skips, pairs, strict=True)])
    best, least = ProxyFit(0.0, float(y.mean()), 0, 1), np.inf
    for window in sorted({max(1, round(seconds * rate)) for seconds in windows}):
        for delay in range(round(LONGEST_DELAY_SECONDS * rate) + 1):
            x = np.concatenate(
                [shifted(proxy, delay, window)[skip:] for skip, (proxy, _, _) in zip(skips, pairs, strict=True)]
            )
            variance = x.var()
            moves = varies(variance, (x * x).mean())  # differences of sums leave rounding noise of a constant
            scale = float(((x - x.mean()) * (y - y.mean())).mean() / variance) if moves else 0.0
            offset = float(y.mean() - scale * x.mean())
            error = float(((y - scale * x - offset) ** 2).mean())
            if error < least:
                best, least = ProxyFit(scale, offset, delay, window), error
    return best, least


def _flat(values: np.ndarray) -> np.ndarray:
    return values.reshape(len(values), -1).astype(np.float64)


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
