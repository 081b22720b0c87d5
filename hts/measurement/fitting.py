"""A fit of a plugin's measurement model: whatever goes wrong in it is one line that names the model and its package."""

from __future__ import annotations

import inspect
import json
from collections.abc import Mapping, Sequence
from functools import partial
from typing import TYPE_CHECKING, Any

import torch

from hts.contracts import MeasurementModel
from hts.errors import PluginError
from hts.guarded import guarded
from hts.measurement.checks import check_prediction, predict
from hts.measurement.files import give_tensors, moved, tensors_of
from hts.measurement.fit_settings import FitSettings

if TYPE_CHECKING:
    from hts.plugins import Registry
    from hts.recordings.recording import Recording

TRIED_SECONDS = 4.0  # of made-up inputs
TRIED_WORLDS = 3


def called(model: MeasurementModel, registry: Registry | None) -> str:
    """How a message names a model: with its package, where a registry knows it."""
    entry = None if registry is None else registry.measurement_models.get(model.name)
    return f"Measurement model '{model.name}'" + ("" if entry is None else f" (from {entry.package})")


def fit_model(
    model: MeasurementModel, recordings: Sequence[Recording], how: FitSettings, registry: Registry | None
) -> dict[str, Any]:
    """Fit the model in place; its report. Raises what `fit` raises of hts.errors; PluginError for any other exception
    in it, for a report that is no dict or that JSON cannot hold, as for such settings, and for a fitted model that does
    not predict a number at each sample of the shortest of these recordings."""
    check_json(model.settings, f"{called(model, registry)}: its `settings`")  # its file will need them
    what = f"{called(model, registry)}: fit()"
    report = guarded(what, partial(model.fit, recordings, **vars(how)))
    if not isinstance(report, dict):
        raise PluginError(f"{what} gives a {type(report).__name__}, expected a report: a dict of JSON values.")
    check_json(report, f"{what}: its report")
    predict(model, min(recordings, key=lambda one: one.num_samples))
    return report


def check_unfitted(model: MeasurementModel, registry: Registry | None) -> None:
    """Raise PluginError for what a fit, or what follows on it, would end in, as far as a model that was just made
    shows it: before any data are collected for it."""
    check_json(model.settings, f"{called(model, registry)}: its `settings`")
    check_fit_arguments(model, registry)
    give_tensors(model, {name: value.clone() for name, value in tensors_of(model).items()})
    moved(model, model.device)
    _check_begun(model, registry)
    length = max(2, round(TRIED_SECONDS * model.signals.rate_hz))
    with torch.no_grad():
        check_prediction(model, torch.full((1, length, model.signals.num_inputs), 0.5, device=model.device), False)


def check_fit_arguments(model: MeasurementModel, registry: Registry | None) -> None:
    """Raise PluginError for a `fit` that does not take what its contract says that it is given."""
    given = vars(FitSettings(0, 1))
    try:
        inspect.signature(model.fit).bind([], **given)
    except TypeError as error:
        raise PluginError(
            f"{called(model, registry)}: fit() does not take what it will be given, {error}. Expected fit(self, "
            f"recordings, *, {', '.join(given)})."
        ) from error


def check_json(values: Mapping[str, Any], what: str) -> None:
    """Raise PluginError, beginning with `what`, that names the first value that JSON cannot hold; NaN is one."""
    if not isinstance(values, Mapping):
        raise PluginError(
            f"{what} is a {type(values).__name__}, expected a dict of JSON values"
            + (" (a property, no method)." if callable(values) else ".")
        )
    for key, value in values.items():
        try:
            json.dumps({key: value}, allow_nan=False)
        except (TypeError, ValueError, RecursionError) as error:
            raise PluginError(
                f"{what} holds {key!r}: {type(value).__name__}, which JSON cannot hold ({error}). Expected finite "
                "numbers, text, lists and dicts of these, such as float(x) or x.tolist()."
            ) from error


def _check_begun(model: MeasurementModel, registry: Registry | None) -> None:
    """Raise PluginError unless the model remembers something, or nothing, of each world that begins."""
    what = f"{called(model, registry)}: initial_state()"
    begun = guarded(what, partial(model.initial_state, TRIED_WORLDS))
    if not isinstance(begun, torch.Tensor) or begun.ndim == 0 or len(begun) != TRIED_WORLDS:
        shown = f"shape {tuple(begun.shape)}" if isinstance(begun, torch.Tensor) else type(begun).__name__
        raise PluginError(
            f"{what} gave {shown} as state of {TRIED_WORLDS} worlds, expected a tensor with worlds first; (W, 0) where "
            "nothing is remembered."
        )
