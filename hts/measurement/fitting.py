"""A fit of a plugin's measurement model: whatever goes wrong in it is one line that names the model and its package."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from functools import partial
from typing import TYPE_CHECKING, Any

from hts.contracts import MeasurementModel
from hts.errors import PluginError
from hts.guarded import guarded
from hts.measurement.fit_settings import FitSettings

if TYPE_CHECKING:
    from hts.plugins import Registry
    from hts.recordings.recording import Recording


def called(model: MeasurementModel, registry: Registry | None) -> str:
    """How a message names a model: with its package, where a registry knows it."""
    entry = None if registry is None else registry.measurement_models.get(model.name)
    return f"Measurement model '{model.name}'" + ("" if entry is None else f" (from {entry.package})")


def fit_model(
    model: MeasurementModel, recordings: Sequence[Recording], how: FitSettings, registry: Registry | None
) -> dict[str, Any]:
    """Fit the model in place; its report. Raises what `fit` raises of hts.errors; PluginError for any other exception
    in it, and for a report that is no dict or that JSON cannot hold, as for such settings."""
    check_json(model.settings, f"{called(model, registry)}: its `settings`")  # its file will need them
    what = f"{called(model, registry)}: fit()"
    report = guarded(what, partial(model.fit, recordings, **vars(how)))
    if not isinstance(report, dict):
        raise PluginError(f"{what} gives a {type(report).__name__}, expected a report: a dict of JSON values.")
    check_json(report, f"{what}: its report")
    return report


def check_json(values: Mapping[str, Any], what: str) -> None:
    """Raise PluginError, beginning with `what`, that names the first value that JSON cannot hold; NaN is one."""
    if not isinstance(values, Mapping):
        raise PluginError(
            f"{what} is a {type(values).__name__}, expected a dict of JSON values (a property, no method)."
        )
    for key, value in values.items():
        try:
            json.dumps({key: value}, allow_nan=False)
        except (TypeError, ValueError, RecursionError) as error:
            raise PluginError(
                f"{what} holds {key!r}: {type(value).__name__}, which JSON cannot hold ({error}). Expected finite "
                "numbers, text, lists and dicts of these, such as float(x) or x.tolist()."
            ) from error
