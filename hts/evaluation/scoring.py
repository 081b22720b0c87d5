"""The score and the comparison of an objective, asked: arrays and plain numbers come back, or one line says whose
mistake it is."""

from __future__ import annotations

import math
from collections.abc import Mapping
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from hts.contracts import Comparison, Objective
from hts.errors import EvaluationError, PluginError
from hts.guarded import guarded

if TYPE_CHECKING:
    from hts.evaluation.segments import Segments


def scored(objective: Objective, segments: Segments, of: str) -> dict[str, np.ndarray]:
    """Quantities of each segment, (segments,) each, all finite. of: whose segments they are. Raises PluginError for an
    exception in `score` and for what is no numbers by name, EvaluationError for numbers that cannot be used."""
    who = f"Objective '{objective.name}'"
    scores = as_scores(who, guarded(f"{who}: score()", partial(objective.score, segments)), len(segments))
    for name, values in scores.items():
        bad = int((~np.isfinite(values)).sum())
        if bad:
            names = [channel.name for channel in objective.real_channels]
            channels = f"channel{'s' if len(names) > 1 else ''} " + " and ".join(map(repr, names))
            raise EvaluationError(
                f"{who}: '{name}' is not a finite number in {bad} of {len(values)} segments of the {of}. Look at "
                f"{channels} in its recordings."
            )
    return scores


def as_scores(who: str, found: object, count: int) -> dict[str, np.ndarray]:
    """What `score` gave, as arrays (count,). Raises PluginError where it is something else, or nothing."""
    if not isinstance(found, Mapping):
        raise PluginError(
            f"{who}: score gives a {type(found).__name__}, expected names with arrays, one number per segment."
        )
    if not found:
        raise PluginError(f"{who}: score gives no quantity of the segments, expected one at least, such as its target.")
    scores = {}
    for name, values in found.items():
        try:
            array = np.asarray(values, dtype=float)
        except (TypeError, ValueError) as error:
            raise PluginError(
                f"{who}: score '{name}' holds a {type(values).__name__} that is no array of numbers. Expected one "
                "number per segment."
            ) from error
        if array.shape != (count,):
            raise PluginError(
                f"{who}: score '{name}' has shape {array.shape} for {count} segments, expected one number for each."
            )
        scores[str(name)] = array
    return scores


def compared(objective: Objective, policy: Mapping[str, float], reference: Mapping[str, float]) -> Comparison:
    """Of two means, in plain numbers. Raises EvaluationError where such numbers cannot be compared, PluginError for any
    other exception and for what is no comparison."""

    def ask() -> object:
        try:
            return objective.compare(policy, reference)
        except ArithmeticError as error:
            raise EvaluationError(
                f"Objective '{objective.name}' cannot compare {dict(policy)} with {dict(reference)}: {error}. Check "
                "the idle level and the recordings."
            ) from error

    return plain(objective, guarded(f"Objective '{objective.name}': compare()", ask))


def plain(objective: Objective, found: object) -> Comparison:
    """A comparison whose numbers are Python's, which a file can hold. Raises PluginError that names what is none."""
    what = f"Objective '{objective.name}': compare()"
    if not isinstance(found, Comparison):
        raise PluginError(f"{what} gave {type(found).__name__}, expected Comparison.")
    if not isinstance(found.metrics, Mapping):
        raise PluginError(
            f"{what} gave metrics that are a {type(found.metrics).__name__}, expected names with numbers."
        )
    if all(isinstance(one, float) for one in (found.improvement, found.selection_score, *found.metrics.values())):
        return found
    return Comparison(
        _number(what, "improvement", found.improvement),
        _number(what, "selection_score", found.selection_score),
        {str(name): _number(what, name, value) for name, value in found.metrics.items()},
    )


def _number(what: str, name: str, value: object) -> float:
    """One number of any library, 0-dimensional arrays and tensors among them."""
    try:
        if isinstance(value, (str, bytes)) or np.ndim(value) != 0:  # type: ignore[arg-type]
            raise TypeError
        return float(value)  # type: ignore[arg-type]
    except (TypeError, ValueError) as error:
        shown = " ".join(repr(value).split())
        raise PluginError(
            f"{what} gave '{name}' as {shown:.60}, a {type(value).__name__}; expected one number, such as float(x)."
        ) from error


def check_finite(objective: Objective, comparison: Comparison) -> None:
    """Raise EvaluationError for a number that is none."""
    numbers = {
        "improvement": comparison.improvement,
        "selection_score": comparison.selection_score,
        **comparison.metrics,
    }
    for name, value in numbers.items():
        if not math.isfinite(value):
            raise EvaluationError(
                f"Objective '{objective.name}': '{name}' of the comparison is {value}. The reference's mean is "
                "probably zero: check the idle level and the recordings."
            )
