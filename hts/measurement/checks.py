"""How far a measurement model can be trusted: errors on data it has not seen, against an analytic stand-in.

The first second of each recording is not scored: the model's memory starts empty, the real sensor's does not.
"""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Collection, Sequence
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import torch

from hts.errors import RecordingError
from hts.measurement.models import MeasurementModel, stack_channels

if TYPE_CHECKING:
    from hts.contracts import Objective
    from hts.recordings.recording import Recording

SETTLE_SECONDS = 1.0
WHOLE_POLICIES_FROM = 4  # with fewer policies each one is needed for fitting


def split(
    recordings: Sequence[Recording], share: float, seed: int = 0, keep: Collection[str] = ()
) -> tuple[list[Recording], list[Recording]]:
    """Recordings to fit on, and about `share` of them held out: whole policies first, then single recordings.

    From four policies on, `share` of them are held out whole, at least one; never the one with the most
    recordings nor those whose hash is in `keep`. Then one recording each of other policies that have several,
    until the share is reached. Of a single recording its end is held out. Same recordings and seed, same split.
    """
    if len(recordings) == 1:
        only = recordings[0]
        at = round((1.0 - share) * only.num_samples)
        return [part(only, 0, at)], [part(only, at, only.num_samples)]
    rng = np.random.default_rng(seed)
    by_policy: dict[str, list[int]] = defaultdict(list)
    for index, recording in enumerate(recordings):
        by_policy[recording.policy_hash].append(index)
    policies = [list(by_policy)[i] for i in rng.permutation(len(by_policy))]
    budget = max(1, round(share * len(recordings)))
    held: list[int] = []
    if len(policies) >= WHOLE_POLICIES_FROM:
        most = max(policies, key=lambda policy: len(by_policy[policy]))
        free = [policy for policy in policies if policy != most and policy not in keep]
        for policy in free[: max(1, round(share * len(policies)))]:
            held += by_policy.pop(policy)
    queues = {policy: [indices[i] for i in rng.permutation(len(indices))] for policy, indices in by_policy.items()}
    while len(held) < budget and any(len(queue) > 1 for queue in queues.values()):
        for policy in policies:
            if len(held) < budget and len(queues.get(policy, ())) > 1:
                held.append(queues[policy].pop())
    if not held:  # every policy has one recording, and there are too few to spare a whole policy by the rule above
        held.append(queues[policies[-1]].pop())
    chosen = set(held)
    return (
        [recording for index, recording in enumerate(recordings) if index not in chosen],
        [recording for index, recording in enumerate(recordings) if index in chosen],
    )


def part(recording: Recording, start: int, stop: int) -> Recording:
    """Samples start to stop of a recording, as a recording."""
    from hts.recordings.recording import Series

    channels = {name: Series(s.channel, s.values[start:stop]) for name, s in recording.channels.items()}
    return recording.replace(time=recording.time[start:stop], channels=channels)


@torch.no_grad()
def predict(model: MeasurementModel, recording: Recording) -> np.ndarray:
    """The model's prediction along a recording, in the target's unit, shape (T,)."""
    values = {name: recording.values(name) for name in model.config.inputs}
    inputs = torch.from_numpy(stack_channels(values, model.config.inputs)).to(model.feature_mean.device)
    if inputs.shape[1] != model.num_inputs:
        raise RecordingError(
            f"Recording {recording.id or '(not stored)'} gives {inputs.shape[1]} input numbers a sample, "
            f"the model of '{model.config.target}' reads {model.num_inputs}. It was fitted to another robot."
        )
    prediction, _ = model.sequence(inputs[None])
    return model.denormalise(prediction[0]).cpu().numpy()


def r2(measured: np.ndarray, predicted: np.ndarray) -> float | None:
    """Share of the variance explained, 1 - SSE/SST; None if nothing varies."""
    total = float(((measured - measured.mean()) ** 2).sum()) if measured.size else 0.0
    return 1.0 - float(((measured - predicted) ** 2).sum()) / total if total > 0 else None


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
    """Measured and predicted target along one recording, after the first second, each (T',)."""

    recording: Recording
    measured: np.ndarray
    predicted: np.ndarray

    @classmethod
    def of(cls, recording: Recording, target: str, predicted: np.ndarray) -> Trace:
        skip = round(SETTLE_SECONDS * recording.rate_hz)
        measured = recording.values(target).reshape(-1).astype(np.float64)
        return cls(recording, measured[skip:], predicted[skip:].astype(np.float64))


def policy_costs(traces: Sequence[Trace]) -> list[PolicyCost]:
    """Costs of all policies at the commanded speed that most of them share, ordered by measured cost.

    Costs at different speeds must not be ranked together: that walking faster costs more is no news.
    """
    sums: dict[float, dict[str, np.ndarray]] = defaultdict(dict)
    for trace in traces:
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
    """Commanded forward speed at each sample, m/s rounded to 0.01, shape (T,)."""
    ends = np.cumsum([command.seconds for command in recording.schedule.commands])
    speeds = np.array([round(command.vx, 2) for command in recording.schedule.commands])
    elapsed = recording.time - recording.time[0]
    return speeds[np.minimum(np.searchsorted(ends, elapsed, side="right"), len(speeds) - 1)]


def scores(traces: Sequence[Trace], seen_policies: Collection[str] = ()) -> dict[str, Any]:
    """Errors of predictions along recordings, as plain JSON values.

    r2: over all samples together; r2_policies: over those of policies not in `seen_policies`, None if there are
    none; rmse: in the target's unit; rank_correlation: across policies at the commanded speed most of them
    share, None with one policy.
    """
    if not traces:
        return {"r2": None, "r2_policies": None, "rmse": None, "rank_correlation": None, "policies": [], "samples": 0}
    measured = np.concatenate([trace.measured for trace in traces])
    predicted = np.concatenate([trace.predicted for trace in traces])
    new = [trace for trace in traces if trace.recording.policy_hash not in seen_policies]
    costs = policy_costs(traces)
    return {
        "r2": r2(measured, predicted),
        "r2_policies": _pooled_r2(new),
        "rmse": math.sqrt(float(((measured - predicted) ** 2).mean())) if measured.size else None,
        "rank_correlation": spearman([c.measured for c in costs], [c.predicted for c in costs]),
        "policies": [asdict(cost) for cost in costs],
        "samples": int(measured.size),
    }


def _pooled_r2(traces: Sequence[Trace]) -> float | None:
    if not traces:
        return None
    return r2(np.concatenate([t.measured for t in traces]), np.concatenate([t.predicted for t in traces]))


def check(
    objective: Objective,
    model: MeasurementModel,
    held_out: Sequence[Recording],
    training: Sequence[Recording],
) -> dict[str, Any]:
    """The model, and the objective's analytic stand-in, on recordings that were not fitted to.

    `held_out` may also be recordings of policies that were made with this model and tried out afterwards,
    the hardest test. `training` tells which policies were seen, and is what the stand-in is fitted to.
    Returns plain JSON values: the entries of `scores`, `recordings`, and `proxy` (None if there is none).
    """
    from hts.measurement.baseline import check_proxy

    target = objective.target.name
    seen = {recording.policy_hash for recording in training}
    traces = [Trace.of(recording, target, predict(model, recording)) for recording in held_out]
    report = scores(traces, seen)
    report["unit"] = objective.target.unit
    report["recordings"] = [recording.id for recording in held_out]
    report["proxy"] = check_proxy(objective, held_out, training)
    return report
