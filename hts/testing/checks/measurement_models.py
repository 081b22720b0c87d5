"""Measurement models: run as the training env runs them, saved and moved. Making and fitting them is in
`model_fits`."""

from __future__ import annotations

import tempfile
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

import numpy as np

from hts.contracts import MeasurementModel, Prediction
from hts.errors import PolicyError
from hts.plugins import Entry, Registry
from hts.recordings.recording import Series
from hts.testing.checks import model_fits
from hts.testing.checks.ensure import Check, after, ensure, refused, same
from hts.testing.checks.fitted_models import (
    STEPS,
    WORLDS,
    context_for,
    fitted_anew,
    fitted_model,
    nearly_equal,
    samples_of_worlds,
    step_by_step,
    with_series,
)
from hts.testing.checks.model_fits import is_made_unfitted

if TYPE_CHECKING:
    import torch

LONG = 500  # samples at a time in which inputs stay: longer than most sensors are late
LONGEST = 60_000  # of them at most: 20 min at 50 Hz, for what warms up
SETTLED = {"rtol": 1e-3, "atol": 1e-3}  # of standard deviations
STILL = 1e-6  # standard deviations: a prediction that moves less in LONG samples is where it comes to
CUT = 5  # of STEPS samples, where a sequence is cut in two


def _pair(what: str, found: Any) -> tuple[Prediction, torch.Tensor]:
    """What a method of that name gave. Raises PluginError for anything but a prediction and a state."""
    expected = f"expected hts.contracts.Prediction and the state: `return Prediction(mean), state` in {what}"
    pair = isinstance(found, tuple) and not isinstance(found, Prediction) and len(found) == 2
    ensure(pair, f"{what} gives a {type(found).__name__}, {expected}")
    prediction, state = found
    kept = isinstance(prediction, Prediction)
    ensure(kept, f"{what} gives a {type(prediction).__name__} as its prediction, {expected}")
    return prediction, state


@after(is_made_unfitted)
def predicts_for_each_world(entry: Entry, registry: Registry) -> None:
    """step and sequence give a finite float32 each, a deviation of at least 0 or none, the same of the same;
    state leads with worlds."""
    import torch

    model = fitted_model(entry, registry)
    data = samples_of_worlds(entry, registry)
    found, after = _pair("step", model.step(data[0], model.initial_state(WORLDS)))
    along, last = _pair("sequence", model.sequence(data.movedim(0, 1)))
    for what, prediction, shape in (("step", found, (WORLDS,)), ("sequence", along, (WORLDS, STEPS))):
        for name, values in (("mean", prediction.mean), ("std", prediction.std)):
            if values is None:
                continue
            ensure(tuple(values.shape) == shape, f"{what}: {name} has shape {tuple(values.shape)}, not {shape}")
            ensure(values.dtype == torch.float32, f"{what}: {name} is {str(values.dtype).removeprefix('torch.')}")
            ensure(bool(torch.isfinite(values).all()), f"{what}: {name} is not finite for inputs like the recordings'")
        ensure(prediction.std is None or bool((prediction.std >= 0).all()), f"{what}: std is below 0")
    wanted = tuple(model.initial_state(WORLDS).shape)
    ensure(wanted[:1] == (WORLDS,), f"initial_state({WORLDS}) has shape {wanted}: worlds do not lead")
    for what, state in (("step", after), ("sequence", last)):
        ensure(tuple(state.shape) == wanted, f"{what}: the state has shape {tuple(state.shape)}, not {wanted}")
    again, left = model.step(data[0], model.initial_state(WORLDS))
    ensure(
        same(again.mean, found.mean) and same(left, after),
        "step predicts something else of the same inputs and state: it draws random numbers, or keeps a memory outside "
        "the state",
    )


@after(is_made_unfitted, predicts_for_each_world)
def step_and_sequence_agree(entry: Entry, registry: Registry) -> None:
    """Step by step, along a whole recording, and with `steps`, it predicts the same, doubt included: training is paid
    by `step`, reports are made from `sequence`."""
    import torch

    model = fitted_model(entry, registry)
    data = samples_of_worlds(entry, registry)
    walked, state = step_by_step(model, data)
    along, last = model.sequence(data.movedim(0, 1))
    ended = torch.zeros(STEPS, WORLDS, dtype=torch.bool)
    together, end = _pair("steps", model.steps(data, model.initial_state(WORLDS), ended))
    for what, found, left in (("sequence", _turned(along), last), ("steps", together, end)):
        _same_predictions(what, found, walked, "step after step")
        ensure(nearly_equal(left, state), f"{what} leaves another state than step after step")


@after(is_made_unfitted, predicts_for_each_world)
def sequence_goes_on(entry: Entry, registry: Registry) -> None:
    """`sequence` begins from the state that it is given: in two parts it predicts what it does of the whole."""
    model = fitted_model(entry, registry)
    data = samples_of_worlds(entry, registry).movedim(0, 1)
    whole, last = model.sequence(data)
    first, between = model.sequence(data[:, :CUT])
    second, end = _pair("sequence", model.sequence(data[:, CUT:], between))
    parts = "sequence in two parts, the second from the state after the first,"
    for part, place in ((first, slice(None, CUT)), (second, slice(CUT, None))):
        _same_predictions(parts, part, _part(whole, place), "one whole sequence")
    ensure(nearly_equal(end, last), f"{parts} leaves another state than one whole sequence")


def _turned(along: Prediction) -> Prediction:
    """(B, T) as (T, B)."""
    return Prediction(along.mean.t(), None if along.std is None else along.std.t())


def _part(along: Prediction, place: slice) -> Prediction:
    """Some samples of (B, T)."""
    return Prediction(along.mean[:, place], None if along.std is None else along.std[:, place])


def _same_predictions(what: str, found: Prediction, wanted: Prediction, of: str) -> None:
    """Raises PluginError where mean or std differ, or one has a std and the other has none; shapes are the same."""
    off = float((found.mean - wanted.mean).abs().max())
    ensure(nearly_equal(found.mean, wanted.mean), f"{what} is off from {of} by up to {off:g} standard deviations")
    if found.std is None or wanted.std is None:
        ensure(found.std is None, f"{what} gives a std, {of} gives none")
        ensure(wanted.std is None, f"{what} gives no std, {of} gives one")
        return
    off = float((found.std - wanted.std).abs().max())
    ensure(nearly_equal(found.std, wanted.std), f"{what}: std is off from {of} by up to {off:g} standard deviations")


@after(is_made_unfitted, predicts_for_each_world)
def keeps_worlds_apart(entry: Entry, registry: Registry) -> None:
    """A world's prediction does not depend on the worlds beside it, now or before: the state is per world."""
    model = fitted_model(entry, registry)
    data = samples_of_worlds(entry, registry)
    crowd, _ = step_by_step(model, data)
    for world in range(WORLDS):
        alone, _ = step_by_step(model, data[:, world : world + 1])
        ensure(
            _alike(alone, 0, crowd, world),
            f"the prediction of world {world} depends on the worlds beside it",
        )
    others = data.clone()
    others[:, 1:] *= 3.0
    changed, _ = step_by_step(model, others)
    ensure(_alike(changed, 0, crowd, 0), "the prediction of world 0 depends on the worlds beside it")


def _alike(first: Prediction, world: int, second: Prediction, other: int) -> bool:
    """Whether one world of the first is predicted as another of the second, doubt included."""
    pairs = [(one, two) for one, two in zip(first, second, strict=True) if one is not None and two is not None]
    return all(nearly_equal(one[:, world], two[:, other]) for one, two in pairs)


@after(is_made_unfitted, predicts_for_each_world)
def forgets_only_who_begins(entry: Entry, registry: Registry) -> None:
    """reset makes the memory of the worlds that begin that of initial_state; the others stay to the bit."""
    import torch

    model = fitted_model(entry, registry)
    data = samples_of_worlds(entry, registry)
    _, state = step_by_step(model, data)
    begun = torch.zeros(WORLDS, dtype=torch.bool)
    begun[1] = True
    after, fresh = model.reset(state, begun), model.initial_state(WORLDS)
    ensure(bool(torch.equal(after[1], fresh[1])), "reset leaves something in the memory of the world that begins")
    ensure(bool(torch.equal(after[~begun], state[~begun])), "reset of one world changes the memory of others")
    lost = torch.full_like(state, torch.nan) if state.is_floating_point() else state
    clean = model.reset(lost, torch.ones(WORLDS, dtype=torch.bool))
    ensure(bool(torch.equal(clean, fresh)), "reset leaves NaN in the memory of a world that ended in it")


@after(is_made_unfitted, predicts_for_each_world)
def lets_nan_through(entry: Entry, registry: Registry) -> None:
    """A NaN or infinite input makes its own world's prediction no finite number, and no other's."""
    import torch

    model = fitted_model(entry, registry)
    data = samples_of_worlds(entry, registry)[0]
    clean, _ = model.step(data, model.initial_state(WORLDS))
    for value in (torch.nan, torch.inf, -torch.inf):
        dirty = data.clone()
        dirty[2, 0] = value
        found = model.step(dirty, model.initial_state(WORLDS))[0].mean
        ensure(not bool(torch.isfinite(found[2])), f"makes {float(found[2]):g} of an input that is {value}")
        found[2] = clean.mean[2]
        ensure(
            nearly_equal(found, clean.mean), f"an input that is {value} in one world changes the prediction of others"
        )


def _mean(what: str, found: Any) -> torch.Tensor:
    """The mean (W,) of what a method of that name, which gives a prediction alone, gave."""
    kept = isinstance(found, Prediction)
    ensure(kept, f"{what} gives a {type(found).__name__}, expected hts.contracts.Prediction: `return Prediction(mean)`")
    mean: torch.Tensor = found.mean
    ensure(tuple(mean.shape) == (WORLDS,), f"{what}: mean has shape {tuple(mean.shape)}, not {(WORLDS,)}")
    return mean


def _comes_to(model: MeasurementModel, inputs: torch.Tensor, expected: torch.Tensor) -> tuple[torch.Tensor, int]:
    """What `sequence` shows, (W,), of inputs (W, F) that stay, and after how many samples: as soon as it is what is
    expected or no longer moves."""
    import torch

    held, state, samples = inputs[:, None].expand(-1, LONG, -1).contiguous(), None, 0
    before = torch.full((WORLDS,), torch.inf)
    while True:
        prediction, state = model.sequence(held, state)
        shown, samples = prediction.mean[:, -1], samples + LONG
        still = float((shown - before).abs().max()) < STILL
        if still or samples >= LONGEST or bool(torch.allclose(shown, expected, **SETTLED)):
            return shown, samples
        before = shown


@after(is_made_unfitted, predicts_for_each_world)
def settles_at_what_it_shows(entry: Entry, registry: Registry) -> None:
    """Where `settles` says so, `settled` gives what `sequence` comes to when the inputs stay, world by world."""
    import torch

    model = fitted_model(entry, registry)
    if not model.settles:
        return
    data = samples_of_worlds(entry, registry)[0]
    found = _mean("settled", model.settled(data))
    shown, samples = _comes_to(model, data, found)
    worst = int((shown - found).abs().argmax())
    ensure(
        bool(torch.allclose(shown, found, **SETTLED)),
        f"settled gives {float(found[worst]):.4g}, sequence comes to {float(shown[worst]):.4g} in "
        f"{samples / model.signals.rate_hz:g} s of the same inputs",
    )
    data[2, 0] = torch.nan
    broken = _mean("settled", model.settled(data))
    ensure(not bool(torch.isfinite(broken[2])), "settled makes a number of an input that is nan")
    ensure(nearly_equal(broken[:2], found[:2]), "settled: an input of one world changes what another settles at")
    if model.settles_in_physics_steps:
        again = _mean("settled_over", model.settled_over(data[:, None].expand(-1, 3, -1).contiguous()))
        ensure(nearly_equal(again[:2], found[:2]), "settled_over: steps that are alike are not what settled says")
        ensure(not bool(torch.isfinite(again[2])), "settled_over makes a number of an input that is nan")


@after(is_made_unfitted, predicts_for_each_world)
def changes_nothing(entry: Entry, registry: Registry) -> None:
    """step, steps and sequence only read the inputs and the state: the env goes on with them."""
    import torch

    model = fitted_model(entry, registry)
    data, (_, state) = samples_of_worlds(entry, registry), step_by_step(model, samples_of_worlds(entry, registry))
    given, before = data.clone(), state.clone()
    model.step(data[0], state)
    model.steps(data, state, torch.zeros(STEPS, WORLDS, dtype=torch.bool))
    model.sequence(data.movedim(0, 1), state)
    ensure(bool(torch.equal(data, given)), "changes its inputs in place")
    ensure(bool(torch.equal(state, before)), "changes its state in place")


@after(is_made_unfitted, predicts_for_each_world)
def is_saved_and_loaded(entry: Entry, registry: Registry) -> None:
    """Its file gives the same model back, to the bit, by its name and settings: all that was fitted is in `tensors`."""
    import torch

    from hts.measurement import files

    model = fitted_model(entry, registry)
    data = samples_of_worlds(entry, registry)
    with tempfile.TemporaryDirectory() as folder:
        loaded = files.load(files.save(model, Path(folder) / "model"), registry=registry)
    before, after = step_by_step(model, data)[0], step_by_step(loaded, data)[0]
    ensure(bool(torch.equal(before.mean, after.mean)), "it predicts something else after it was saved and loaded")
    doubts = [one.std if one.std is not None else torch.empty(0) for one in (before, after)]
    ensure(bool(torch.equal(*doubts)), "it doubts by another std after it was saved and loaded")
    same = torch.equal(model.denormalise(before.mean), loaded.denormalise(before.mean))
    ensure(bool(same), "its z-scores mean something else after it was saved and loaded")
    ensure(loaded.pessimism == model.pessimism, "its pessimism is another after it was saved and loaded")


@after(is_made_unfitted, is_saved_and_loaded)
def refuses_foreign_files(entry: Entry, registry: Registry) -> None:
    """A file that lacks a number, has one too many or one of another shape is refused in one line."""
    import torch

    from hts.measurement import files

    model = fitted_model(entry, registry)
    own = dict(model.tensors())
    ensure(bool(own), "tensors() is empty: nothing that was fitted would be saved")
    name = min(own)
    wrong = {
        f"without '{name}'": {key: value for key, value in own.items() if key != name},
        "with one too many": {**own, "stranger": torch.zeros(1)},
        f"with '{name}' of another shape": {**own, name: torch.zeros(2, *own[name].shape)},
    }
    for what, tensors in wrong.items():
        with tempfile.TemporaryDirectory() as folder:
            given = {"name": model.name, "settings": model.settings, "signals": model.signals}
            other = SimpleNamespace(**given, tensors=partial(dict, tensors))
            path = files.save(other, Path(folder) / "model")  # type: ignore[arg-type]
            try:
                files.load(path, registry=registry)
            except PolicyError as error:
                ensure("\n" not in str(error), f"says of a file {what} in several lines: {error}")
            else:
                ensure(False, f"takes a file {what}")


@after(is_made_unfitted)
def refuses_recordings(entry: Entry, registry: Registry) -> None:
    """Recordings without use (none, other units, NaN, a constant target) are an error of hts.errors, one line."""
    context, recordings = context_for(entry, registry)
    first, target = recordings[0], context.signals.target
    still = Series(target, np.full_like(first.values(target.name), 3.0))
    channel = context.signals.inputs[0]
    lost = np.full_like(first.values(channel.name), np.nan)
    other = type(channel)(channel.name, "s" if channel.unit != "s" else "m", channel.shape)
    wrong = {
        "no recordings": [],
        "a target that never varies": [with_series(first, still)],
        "an input that is NaN": [with_series(first, Series(channel, lost))],
        f"'{channel.name}' in {other.unit}, not {channel.unit}": [
            with_series(first, Series(other, first.values(channel.name)))
        ],
    }
    for what, given in wrong.items():
        with refused(what, f"is fitted to {what}"):
            entry.factory({}, context).fit(given, epochs=1)


@after(is_made_unfitted, predicts_for_each_world)
def stays_on_its_device(entry: Entry, registry: Registry) -> None:
    """step and reset stay on the device, look at no value (a GPU may capture them) and move with `to`."""
    import torch

    device = torch.device("cuda" if torch.cuda.is_available() else "meta")  # "meta" has shapes and no values to look at
    model, _ = fitted_anew(entry, registry)  # it is moved
    data = samples_of_worlds(entry, registry)[0]
    moved = model.to(device)
    ensure(moved is model, "to() gives another object than the model itself")
    ensure(model.device.type == device.type, f"to('{device}') leaves it on {model.device}")
    try:
        state = model.initial_state(WORLDS)
        found, state = model.step(data.to(device), state)
        state = model.reset(state, torch.zeros(WORLDS, dtype=torch.bool, device=device))
    except (RuntimeError, TypeError, NotImplementedError) as error:
        ensure(False, f"step leaves the device or looks at a value ({' '.join(str(error).split())[:100]})")
    for what, tensor in (("the prediction", found.mean), ("the state", state)):
        ensure(tensor.device.type == device.type, f"{what} is on {tensor.device}, the model on {device}")


CHECKS: Sequence[Check] = (
    is_made_unfitted,
    *model_fits.CHECKS,
    predicts_for_each_world,
    after(is_made_unfitted, predicts_for_each_world)(model_fits.predicts_in_deviations_of_the_target),
    step_and_sequence_agree,
    sequence_goes_on,
    keeps_worlds_apart,
    forgets_only_who_begins,
    lets_nan_through,
    changes_nothing,
    settles_at_what_it_shows,
    is_saved_and_loaded,
    refuses_foreign_files,
    refuses_recordings,
    stays_on_its_device,
)
