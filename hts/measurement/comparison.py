"""The chosen model beside others on the same split: the mean, the analytic stand-in fitted, `linear`, and who is asked.

Which of them is kept, where the best is wanted, is decided by cross-validation inside the training recordings: the
best of several on what is held out would be no held-out figure any more.
"""

from __future__ import annotations

import itertools
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from hts.contracts import MeasurementModel
from hts.measurement.baseline import WINDOWS_SECONDS, ProxyFit, StandIn, fit_best
from hts.measurement.checks import predict
from hts.measurement.scoring import Trace, scores
from hts.measurement.split import named_part

if TYPE_CHECKING:
    from hts.recordings.recording import Recording

FOLDS = 3
MEAN, PROXY, SMOOTHED = "mean", "proxy", "proxy, smoothed"
Predictor = Callable[["Recording"], np.ndarray]
"""A fitted model: the target along a recording, (T,)."""
Fitter = Callable[[Sequence["Recording"]], "Fitted"]


class Fitted(NamedTuple):
    """Fitted to recordings: along: the target; detail: what was found, in words; scale: of a stand-in's line."""

    along: Predictor
    detail: str
    scale: float | None = None


@dataclass(frozen=True)
class Row:
    """One line of the table. kind: `reference` (mean and stand-ins) or `model`; r2 …: on what is held out, see
    `scoring.scores`; cross_validated: R² inside the training, None where nobody asked; detail: what was found; scale:
    of a stand-in's line, None of others."""

    name: str
    kind: str
    r2: float | None
    r2_interval: list[float] | None
    rmse: float | None
    cross_validated: float | None
    detail: str
    fit_seconds: float
    scale: float | None = None


def references(target: str, candidates: Mapping[str, StandIn]) -> dict[str, Fitter]:
    """What needs no model: the training's mean, and the analytic stand-in with fitted scale, offset and delay, without
    and with a moving average of fitted length."""

    def mean(training: Sequence[Recording]) -> Fitted:
        level = float(np.concatenate([one.values(target).reshape(-1) for one in training]).mean(dtype=np.float64))
        return Fitted(lambda one: np.full(one.num_samples, level), f"{level:.4g} always")

    def proxy(windows: Sequence[float]) -> Fitter:
        def fit(training: Sequence[Recording]) -> Fitted:
            name, line = fit_best(candidates, target, training, windows)
            formula = candidates[name]

            def along(one: Recording) -> np.ndarray:
                return line.predict(formula({key: one.values(key) for key in one.channels}))

            return Fitted(along, _in_words(name, line, training[0].rate_hz), line.scale)

        return fit

    return {MEAN: mean, PROXY: proxy((0.0,)), SMOOTHED: proxy(WINDOWS_SECONDS)}


def of_model(model: MeasurementModel) -> Predictor:
    """A fitted measurement model as a predictor."""
    return lambda recording: predict(model, recording)


def row(
    name: str,
    kind: str,
    fitter: Fitter,
    target: str,
    training: Sequence[Recording],
    held_out: Sequence[Recording],
    cross_validated: float | None = None,
) -> Row:
    """Fitted to the training, scored on the held-out recordings."""
    began = time.monotonic()
    fitted = fitter(training)
    took = time.monotonic() - began
    found = scores([Trace.of(one, target, fitted.along(one)) for one in held_out])
    scored = (found["r2"], found["r2_interval"], found["rmse"], cross_validated)
    return Row(name, kind, *scored, fitted.detail, took, fitted.scale)


def cross_validated(
    fitters: Mapping[str, Fitter],
    target: str,
    training: Sequence[Recording],
    say: Callable[[str], None],
) -> dict[str, float | None]:
    """R² of each over all parts of the training, each part predicted by a fit to the others."""
    folds = training_folds(training)
    if len(folds) < 2:
        return dict.fromkeys(fitters)
    found: dict[str, float | None] = {}
    for name, fitter in fitters.items():
        traces = []
        for number, fold in enumerate(folds):
            say(f"cross-validation: {name}, part {number + 1} of {len(folds)}")
            rest = [one for other in folds if other is not fold for one in other]
            along = fitter(rest).along
            traces += [Trace.of(one, target, along(one)) for one in fold]
        found[name] = scores(traces)["r2"]
    return found


def training_folds(training: Sequence[Recording]) -> list[list[Recording]]:
    """Three parts that are left out in turn: whole policies or recordings where there are three, else stretches, each
    recording cut into as many as its share of six."""
    policies = [one.policy_hash for one in training]
    if len(set(policies)) >= FOLDS or len(training) >= FOLDS:
        names = policies if len(set(policies)) >= FOLDS else [str(index) for index in range(len(training))]
        order = list(dict.fromkeys(names))
        pairs = [(order.index(name) % FOLDS, one) for name, one in zip(names, training, strict=True)]
    else:
        total, parts = sum(one.num_samples for one in training), []
        for one in training:
            count = max(1, min(round(2 * FOLDS * one.num_samples / total), int(one.seconds)))
            edges = np.linspace(0, one.num_samples, count + 1).round().astype(int)
            parts += [named_part(one, int(a), int(b)) for a, b in itertools.pairwise(edges)]
        pairs = [(index % FOLDS, part) for index, part in enumerate(parts)]
    return [fold for number in range(FOLDS) if (fold := [one for place, one in pairs if place == number])]


def _in_words(name: str, line: ProxyFit, rate_hz: float) -> str:
    window = f", mean over {1000 * line.window_samples / rate_hz:.0f} ms" if line.window_samples > 1 else ""
    late = f", {1000 * line.delay_samples / rate_hz:.0f} ms late" if line.delay_samples else ""
    return f"{line.scale:.3g} × {name} {'+' if line.offset >= 0 else '−'} {abs(line.offset):.3g}{late}{window}"
