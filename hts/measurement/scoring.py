"""Measured against predicted, along recordings: variance explained, errors, ranks of policies,
and whether a spread is honest.

The first second of each recording is not scored: the model's memory starts empty, the real sensor's does not.
Of a recording shorter than four seconds it is the first quarter, so that something is left to score.
"""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Collection, Sequence
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from hts.recordings.on_schedule import command_at

if TYPE_CHECKING:
    from hts.recordings.recording import Recording

SETTLE_SECONDS = 1.0
SETTLE_SHARE = 0.25
BLOCK_SECONDS = 1.0
"""What is drawn together for an interval: errors are alike for a while."""
DRAWS = 1000
LEAST_BLOCKS = 4
ROUNDING = 1e-12
"""A variance that is no larger share of the mean square than this is what rounding leaves of a constant."""


def unscored(recording: Recording) -> int:
    """How many samples at its beginning are not scored."""
    return min(round(SETTLE_SECONDS * recording.rate_hz), int(SETTLE_SHARE * recording.num_samples))


def one_a_sample(recording: Recording, channel: str) -> np.ndarray:
    """A channel of one number, (T,) float64."""
    return recording.values(channel).reshape(-1).astype(np.float64)


def varies(variance: float, square: float) -> bool:
    """Whether a variance is more than rounding; square: the mean square that it was made of, or sums of both."""
    return variance > ROUNDING * square


def explained(error: float, variance: float, square: float) -> float | None:
    """R² from a mean squared error, or sums of squares; None if nothing `varies`."""
    return 1.0 - error / variance if varies(variance, square) else None


def r2(measured: np.ndarray, predicted: np.ndarray) -> float | None:
    """Share of the variance explained, 1 - SSE/SST; None if nothing varies."""
    if not measured.size:
        return None
    total = float(((measured - measured.mean()) ** 2).sum())
    return explained(float(((measured - predicted) ** 2).sum()), total, float((measured**2).sum()))


def spearman(first: Sequence[float], second: Sequence[float]) -> float | None:
    """Rank correlation; None with fewer than two values or if one side does not vary."""
    if len(first) < 2 or len(set(first)) < 2 or len(set(second)) < 2:
        return None
    from scipy.stats import spearmanr

    return float(spearmanr(first, second).statistic)


@dataclass(frozen=True)
class PolicyCost:
    """Mean of the target over one policy's samples at one commanded speed, measured and predicted."""

    policy: str
    speed: float
    measured: float
    predicted: float
    samples: int


@dataclass(frozen=True)
class Trace:
    """Measured and predicted target along one recording, after what is not scored, each (T',).

    spread: standard deviation of the prediction, where the model gives one.
    """

    recording: Recording
    measured: np.ndarray
    predicted: np.ndarray
    spread: np.ndarray | None = None

    @classmethod
    def of(cls, recording: Recording, target: str, predicted: np.ndarray, spread: np.ndarray | None = None) -> Trace:
        skip = unscored(recording)
        measured = one_a_sample(recording, target)
        kept = None if spread is None else spread[skip:].astype(np.float64)
        return cls(recording, measured[skip:], predicted[skip:].astype(np.float64), kept)


def policy_costs(traces: Sequence[Trace]) -> list[PolicyCost]:
    """Costs of all policies at the commanded speed that most of them share, ordered by measured cost.

    Costs at different speeds must not be ranked together: that walking faster costs more is no news.
    """
    sums: dict[float, dict[str, np.ndarray]] = defaultdict(dict)
    for trace in traces:
        if not trace.measured.size:
            continue
        speeds = commanded_speed(trace.recording)[-len(trace.measured) :]
        for speed in np.unique(speeds):
            at = speeds == speed
            row = np.array([trace.measured[at].sum(), trace.predicted[at].sum(), at.sum()])
            table = sums[float(speed)]
            table[trace.recording.policy_hash] = table.get(trace.recording.policy_hash, np.zeros(3)) + row
    if not sums:
        return []
    speed = max(sums, key=lambda s: (len(sums[s]), sum(row[2] for row in sums[s].values())))
    costs = [PolicyCost(p, speed, float(m / n), float(f / n), int(n)) for p, (m, f, n) in sums[speed].items()]
    return sorted(costs, key=lambda cost: cost.measured)


def commanded_speed(recording: Recording) -> np.ndarray:
    """Commanded forward speed at each sample, m/s, or the set-point of another task in its unit, shape (T,)."""
    return np.array([command.commanded for command in recording.schedule.commands])[command_at(recording)]


def scores(traces: Sequence[Trace], seen_policies: Collection[str] = ()) -> dict[str, Any]:
    """Errors of predictions along recordings, as plain JSON values.

    r2: over all samples together; r2_interval: see `r2_interval`; seconds, samples: that are scored; r2_policies: over
    those of policies not in `seen_policies`, None if there are none; rmse: in the target's unit; rank_correlation:
    across policies at the commanded speed most of them share, None with one policy.
    """
    if not traces:
        nothing = dict.fromkeys(("r2", "r2_interval", "r2_policies", "rmse", "rank_correlation"))
        return {**nothing, "policies": [], "samples": 0, "seconds": 0.0}
    measured = np.concatenate([trace.measured for trace in traces])
    predicted = np.concatenate([trace.predicted for trace in traces])
    new = [trace for trace in traces if trace.recording.policy_hash not in seen_policies]
    costs = policy_costs(traces)
    return {
        "r2": r2(measured, predicted),
        "r2_interval": r2_interval(traces),
        "r2_policies": pooled_r2(new),
        "rmse": math.sqrt(float(((measured - predicted) ** 2).mean())) if measured.size else None,
        "rank_correlation": spearman([c.measured for c in costs], [c.predicted for c in costs]),
        "policies": [asdict(cost) for cost in costs],
        "samples": int(measured.size),
        "seconds": sum(trace.measured.size / trace.recording.rate_hz for trace in traces),
    }


def r2_interval(traces: Sequence[Trace]) -> list[float] | None:
    """95 % interval of R² by a block bootstrap: blocks of a second, drawn with replacement, a thousand times.

    It says how much hangs on which seconds were held out, not what other policies or days would give. None with fewer
    than four blocks. Each draw is scored against its own mean. Künsch 1989, of blocks that do not overlap.
    """
    rows = []
    for trace in traces:
        size = max(1, round(BLOCK_SECONDS * trace.recording.rate_hz))
        for start in range(0, trace.measured.size, size):
            y, error = trace.measured[start : start + size], (trace.measured - trace.predicted)[start : start + size]
            rows.append((len(y), y.sum(), (y * y).sum(), (error * error).sum()))
    if len(rows) < LEAST_BLOCKS:
        return None
    drawn = np.random.default_rng(0).integers(len(rows), size=(DRAWS, len(rows)))
    counts, totals, squared, errors = np.array(rows).T
    level = totals.sum() / counts.sum()  # about the mean, or sums of squares lose their last digits
    centred = np.stack((counts, totals - level * counts, squared - (2 * level * totals - level**2 * counts), errors), 1)
    count, total, squares, errors = centred[drawn].sum(1).T
    around = squares - total**2 / count
    moving = around > ROUNDING * np.maximum(squares, 1e-300)
    if moving.mean() < 0.5:
        return None
    low, high = np.quantile(1.0 - errors[moving] / around[moving], (0.025, 0.975))
    return [float(low), float(high)]


def pooled_r2(traces: Sequence[Trace]) -> float | None:
    """Over all their samples together."""
    if not traces:
        return None
    return r2(np.concatenate([t.measured for t in traces]), np.concatenate([t.predicted for t in traces]))


def calibration(traces: Sequence[Trace]) -> dict[str, Any] | None:
    """Whether errors are as large as the model's own standard deviations say; None without them, or without samples.

    within_1, within_2: share of samples whose error is at most one, two standard deviations (of a
    Gaussian: 0.68, 0.95);
    error_over_spread: root mean square of one over the other, the factor that the spread would need; policies:
    per policy the error of its mean, and the mean spread, target's unit, with the same shares over policies. The spread
    of a mean over time is at most the mean of the spreads, so those shares are on the generous side.
    """
    known = [(trace, trace.spread) for trace in traces if trace.spread is not None and trace.measured.size]
    if not known:
        return None
    error = np.concatenate([trace.predicted - trace.measured for trace, _ in known])
    spread = np.concatenate([spread for _, spread in known])
    by_policy: dict[str, list[tuple[Trace, np.ndarray]]] = defaultdict(list)
    for trace, own in known:
        by_policy[trace.recording.policy_hash].append((trace, own))
    off, wide = [], []
    for own_traces in by_policy.values():
        off.append(float(np.concatenate([trace.predicted - trace.measured for trace, _ in own_traces]).mean()))
        wide.append(float(np.concatenate([own for _, own in own_traces]).mean()))
    squared = float((spread**2).mean())
    over_policies = _within(np.abs(np.array(off)), np.array(wide))
    return {
        **_within(np.abs(error), spread),
        "error_over_spread": math.sqrt(float((error**2).mean()) / squared) if squared > 0 else None,
        "rms_spread": math.sqrt(squared),
        **{f"policies_{name}": share for name, share in over_policies.items()},
        "policies": [
            {"policy": policy, "error": error, "spread": spread}
            for policy, error, spread in zip(by_policy, off, wide, strict=True)
        ],
    }


def _within(error: np.ndarray, spread: np.ndarray) -> dict[str, float]:
    return {f"within_{times}": float((error <= times * spread).mean()) for times in (1, 2)}
