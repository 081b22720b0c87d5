"""How far a measurement model can be trusted: errors on unseen data, against `linear` and an analytic stand-in."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
import torch

from hts.contracts import MeasurementModel, Prediction
from hts.errors import PluginError
from hts.guarded import guarded
from hts.measurement.baseline import check_proxy
from hts.measurement.data import check_units, input_tensor
from hts.measurement.linear import Linear, LinearSettings
from hts.measurement.scoring import Trace, calibration, scores

if TYPE_CHECKING:
    from hts.contracts import Objective
    from hts.recordings.recording import Recording


@torch.no_grad()
def predict(model: MeasurementModel, recording: Recording) -> np.ndarray:
    """The model's prediction along a recording, in the target's unit, shape (T,)."""
    return predict_with_spread(model, recording)[0]


@torch.no_grad()
def predict_with_spread(model: MeasurementModel, recording: Recording) -> tuple[np.ndarray, np.ndarray | None]:
    """The prediction and its standard deviation, in the target's unit, each (T,); None from a model that has no spread.

    Raises RecordingError for a recording of another robot, or in other units.
    """
    inputs = input_tensor(model.signals, recording)
    check_units(model.signals, recording)
    own = model.inputs_along(recording)
    inputs = (inputs if own is None else own).to(model.device)
    found = check_prediction(model, inputs[None])
    std = None if found.std is None else (found.std[0] * model.target_std).cpu().numpy()
    return model.denormalise(found.mean[0]).cpu().numpy(), std


def check_prediction(model: MeasurementModel, inputs: torch.Tensor, finite: bool = True) -> Prediction:
    """What the model predicts along one recording, inputs (1, T, ...). Raises PluginError for what is no prediction of
    it: an exception, another shape, or, where it is to be `finite`, no number."""
    what, length = f"Measurement model '{model.name or type(model).__name__}': sequence()", inputs.shape[1]
    given = guarded(what, partial(model.sequence, inputs))
    pair = isinstance(given, tuple) and not isinstance(given, Prediction) and len(given) == 2
    if not pair or not isinstance(given[0], Prediction):
        kinds = " and ".join(type(one).__name__ for one in given) if pair else type(given).__name__
        raise PluginError(f"{what} gives {kinds}, expected a Prediction and the state.")
    found: Prediction = given[0]
    for name, part in (("mean", found.mean), ("std", found.std)):
        if part is None and name == "std":
            continue
        if not isinstance(part, torch.Tensor) or tuple(part.shape) != (1, length):
            shape = tuple(part.shape) if isinstance(part, torch.Tensor) else type(part).__name__
            raise PluginError(
                f"{what}: {name} is {shape} for inputs of (1, {length}, channels), expected (1, {length})."
            )
        if finite and not bool(torch.isfinite(part).all()):
            raise PluginError(
                f"{what}: {name} is not finite at sample {int((~torch.isfinite(part[0])).nonzero()[0])} of {length}. "
                "Its parameters or its inputs' scale went wrong in fit()."
            )
        if name == "std" and bool((part < 0).any()):
            raise PluginError(
                f"{what}: std is {float(part.min()):.3g} at its least, expected a standard deviation: 0 or more."
            )
    return found


def traces_of(model: MeasurementModel, target: str, recordings: Sequence[Recording]) -> list[Trace]:
    """Measured and predicted target along each recording."""
    return [Trace.of(recording, target, *predict_with_spread(model, recording)) for recording in recordings]


def fit_linear(model: MeasurementModel, training: Sequence[Recording]) -> Linear:
    """The reference with little to learn, `linear` with its default settings, for what the model reads and predicts."""
    if isinstance(model, Linear) and model.config == LinearSettings():
        return model
    reference = Linear(LinearSettings(), model.signals)
    reference.fit(training)
    return reference


def check(
    objective: Objective, model: MeasurementModel, held_out: Sequence[Recording], training: Sequence[Recording]
) -> dict[str, Any]:
    """The model, `linear`, and the objective's analytic stand-in, on recordings that were not fitted to.

    `held_out` may also be recordings of policies that were made with this model and tried out afterwards,
    the hardest test. `training` tells which policies were seen, and is what the other two are fitted to.
    Returns plain JSON values: the entries of `scores`, `recordings`, `unit`, `linear` (scores), `spread` (see
    `scoring.calibration`; None from a model that has none) and `proxy` (None if the objective has none).
    """
    target = objective.target.name
    seen = {recording.policy_hash for recording in training}
    traces = traces_of(model, target, held_out)
    report = scores(traces, seen)
    report["unit"] = objective.target.unit
    report["recordings"] = [recording.id for recording in held_out]
    report["spread"] = calibration(traces)
    linear = traces if isinstance(model, Linear) else traces_of(fit_linear(model, training), target, held_out)
    report["linear"] = scores(linear, seen)
    report["proxy"] = check_proxy(objective, held_out, training)
    return report
