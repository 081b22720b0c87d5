"""Fitted measurement models for the checks of them, and what they are run on."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from typing import TYPE_CHECKING, Any

import numpy as np

from hts.config import Named
from hts.contracts import MeasurementModel, ModelContext, Prediction
from hts.errors import HtsError
from hts.plugins import Entry, Registry
from hts.recordings.recording import Recording, Series
from hts.testing.checks.made_up import walk
from hts.testing.known_signals import SIGNALS, known_heat

if TYPE_CHECKING:
    import torch

    from hts.contracts.measurement_model import Progress

WORLDS, STEPS = 5, 12
MEMBER = Named(name="linear", lags=2)  # stands for the objective's own model, for models that are made of others


def context_for(entry: Entry, registry: Registry) -> tuple[ModelContext, list[Recording]]:
    """What to try a model on: channels and walks of the objective whose own model it is, else the kit's signals."""
    from hts.measurement.data import recorded_signals

    for one in registry.objectives.values():
        if one.package == entry.package:
            try:
                objective = registry.make_objective(one.name)
            except HtsError:  # found when that one is checked
                continue
            if objective.measurement_model().name == entry.name:
                recordings = [walk(objective, registry, seed=seed) for seed in range(3)]
                return ModelContext(recorded_signals(objective, recordings[0]), MEMBER, registry), recordings
    return ModelContext(SIGNALS, MEMBER, registry), [known_heat(seed, seconds=6.0) for seed in range(3)]


@dataclass(frozen=True)
class _Key:
    """What was fitted, so that it is not fitted again for every check."""

    entry: Entry
    registry: Registry = field(compare=False)


@lru_cache(maxsize=1)
def _once(key: _Key) -> MeasurementModel:
    return fitted_anew(key.entry, key.registry)[0]


def fitted_model(entry: Entry, registry: Registry) -> MeasurementModel:
    """A fitted one, for checks that only read it."""
    return _once(_Key(entry, registry))


def fitted_anew(entry: Entry, registry: Registry) -> tuple[MeasurementModel, dict[str, Any]]:
    context, recordings = context_for(entry, registry)
    model = registry.make_measurement_model(entry.name, {}, context)
    return model, fit_as_in_a_run(model, recordings)


def _nobody_is_told(epoch: int, epochs: int, error: float) -> None:
    """A progress that shows nothing."""


def fit_as_in_a_run(
    model: MeasurementModel,
    recordings: Sequence[Recording],
    epochs: int = 1,
    progress: Progress = _nobody_is_told,
    warm_start: MeasurementModel | None = None,
    max_seconds: float = 600.0,
) -> dict[str, Any]:
    """Its report; `fit` is given all that its contract names. max_seconds: as a run has it, unless another is said."""
    return model.fit(
        recordings, seed=0, epochs=epochs, max_seconds=max_seconds, progress=progress, warm_start=warm_start
    )


def of_known_scale(context: ModelContext, recordings: Sequence[Recording], spread: float) -> list[Recording]:
    """The recordings with another target, that follows the inputs and their squares: 3 · spread ± spread."""
    from hts.measurement.data import input_tensor

    signals, made = context.signals, []
    inputs = [input_tensor(signals, one).double().numpy() for one in recordings]
    whole = np.concatenate(inputs)
    low, scale = whole.mean(0), whole.std(0) + 1e-9
    shown = [((one - low) / scale).sum(1) + (((one - low) / scale) ** 2).sum(1) for one in inputs]
    mean, std = np.concatenate(shown).mean(), np.concatenate(shown).std()
    for recording, values in zip(recordings, shown, strict=True):
        target = (spread * (3.0 + (values - mean) / std)).reshape(len(values), *signals.target.shape)
        made.append(with_series(recording, Series(signals.target, target)))
    return made


def samples_of_worlds(entry: Entry, registry: Registry) -> torch.Tensor:
    """Samples of different places of the recordings, (STEPS, WORLDS, F)."""
    import torch

    from hts.measurement.data import input_tensor

    context, recordings = context_for(entry, registry)
    whole = torch.cat([input_tensor(context.signals, one) for one in recordings])
    places = [torch.arange(STEPS) + 37 * world for world in range(WORLDS)]
    return torch.stack([whole[place] for place in places], 1)


def step_by_step(model: MeasurementModel, data: torch.Tensor) -> tuple[Prediction, torch.Tensor]:
    """Predictions (T, W) and the last state of step after step; no std where one step gave none."""
    import torch

    state, found = model.initial_state(data.shape[1]), []
    for inputs in data:
        prediction, state = model.step(inputs, state)
        found.append(prediction)
    stds = [one.std for one in found if one.std is not None]
    std = torch.stack(stds) if len(stds) == len(found) else None
    return Prediction(torch.stack([one.mean for one in found]), std), state


def with_series(recording: Recording, *series: Series) -> Recording:
    return recording.replace(channels={**recording.channels, **{one.channel.name: one for one in series}})


def nearly_equal(first: torch.Tensor, second: torch.Tensor) -> bool:
    import torch

    return bool(torch.allclose(first, second, rtol=1e-3, atol=1e-4))
