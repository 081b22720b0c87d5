"""Measurement models: how they are made and fitted. How a fitted one runs is in `measurement_models`."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

import numpy as np

from hts.contracts import MeasurementModel, ModelContext
from hts.errors import HtsError
from hts.plugin_settings import settings_model
from hts.plugins import Entry, Registry
from hts.testing.checks.ensure import Check, after, ensure
from hts.testing.checks.fitted_models import (
    context_for,
    fit_as_in_a_run,
    fitted_model,
    of_known_scale,
)

if TYPE_CHECKING:
    from pydantic import BaseModel

FAR_OFF = 1.0  # standard deviations that a model fitted in haste may be off, in mean and in spread
SPREAD = 20.0  # of the target, in its unit, so that a prediction in the unit is far from one in deviations
EPOCHS = 30  # of the fit whose scale is looked at: so much work, however fast the machine is
FOLLOWS, TOO_SMALL = 0.8, 6.0
"""A fitted model that follows the target (correlation) does not have to be so many times larger to fit it best."""


def is_made_unfitted(entry: Entry, registry: Registry) -> None:
    """Made without settings for the given channels and units; its settings are JSON and make it again."""
    context, _ = context_for(entry, registry)
    model = entry.factory({}, context)
    ensure(isinstance(model, MeasurementModel), f"is a {type(model).__name__}, not a hts.contracts.MeasurementModel")
    found, wanted = model.signals, context.signals
    for was, now in zip((*wanted.inputs, wanted.target), (*found.inputs, found.target), strict=False):
        ensure(now == was, f"is made for '{was.name}' in {was.unit} and says '{now.name}' in {now.unit}")
    ensure(found == wanted, f"is made for {len(wanted.inputs)} inputs at {wanted.rate_hz:g} Hz and says {found}")
    settings = json.loads(json.dumps(dict(model.settings), allow_nan=False))
    again = registry.make_measurement_model(entry.name, settings, context)
    ensure(dict(again.settings) == dict(model.settings), "its settings, given to its factory, make another model")


@after(is_made_unfitted)
def settings_are_all_there(entry: Entry, registry: Registry) -> None:
    """`settings` holds every setting with its value, given or default: its file makes the same model again by them."""
    known = settings_model(registry, "measurement_models", entry.name)
    if known is None:
        return
    context, _ = context_for(entry, registry)
    made = entry.factory({}, context).settings
    for key, default in _defaults(known).items():
        ensure(key in made, f"its settings hold {sorted(made)}, no '{key}': return self.config.model_dump(mode='json')")
        ensure(_equal(made[key], default), f"its settings hold {key}={made[key]!r}, its default is {default!r}")
        for value in _others(default):
            try:
                found = entry.factory(dict(known.model_validate({key: value}).model_dump(include={key})), context)
            except (HtsError, ValueError):  # ValueError: what pydantic raises; not a value for this setting
                continue
            held = found.settings.get(key)
            ensure(_equal(held, value), f"its settings hold {key}={held!r} when it is made with {key}={value!r}")
            break


def _defaults(known: type[BaseModel]) -> dict[str, Any]:
    """Of the settings that have one, as JSON holds them."""
    try:
        return known().model_dump(mode="json")
    except ValueError:  # what pydantic raises: one of them has none
        return {}


def _others(default: object) -> tuple[Any, ...]:
    """Values to try in place of a number; none for anything else."""
    if isinstance(default, bool):
        return (not default,)
    if isinstance(default, int):
        return (default + 1, default - 1)
    return (0.5 * default, 2.0 * default, default + 0.5) if isinstance(default, float) else ()


def _equal(held: object, value: object) -> bool:
    """Whether numbers, texts and truths are the same; anything else may be written in more ways than one."""
    return held == value or not isinstance(held, int | float | str | None) or not isinstance(value, int | float | str)


@after(is_made_unfitted)
def making_it_draws_nothing(entry: Entry, registry: Registry) -> None:
    """Making it draws from no global random generator: else it is another model after whatever ran before it."""
    context, _ = context_for(entry, registry)
    with _global_generators(1) as state:
        before = state()
        entry.factory({}, context)
        ensure(
            state() == before,
            "is made with numbers from a global random generator, as layers of torch.nn draw them. Make the layers "
            "with device='meta', then .to_empty(device='cpu'), and fill them from a torch.Generator of your own "
            "(hts.measurement.lstm does), or make them inside `with torch.random.fork_rng(devices=[]): "
            "torch.manual_seed(0)`",
        )


@after(is_made_unfitted)
def can_be_fitted(entry: Entry, registry: Registry) -> None:
    """fit takes seed, epochs, max_seconds, progress and warm_start, as a run gives them, and gives a JSON report; it
    tells progress of passes counted from 1 and of a finite error, a float."""
    from hts.measurement.fitting import check_fit_arguments, check_json

    context, recordings = context_for(entry, registry)
    models = [registry.make_measurement_model(entry.name, {}, context) for _ in range(2)]
    check_fit_arguments(models[0], registry)
    told: list[tuple[Any, Any, Any]] = []

    def progress(epoch: int, epochs: int, error: float) -> None:
        told.append((epoch, epochs, error))

    for model, warm in zip(models, (None, models[0]), strict=True):
        check_json(fit_as_in_a_run(model, recordings, progress=progress, warm_start=warm), "the report of fit")
    for epoch, epochs, error in told:
        counted = isinstance(epoch, int) and isinstance(epochs, int) and 1 <= epoch <= epochs
        ensure(counted, f"fit tells progress({epoch!r}, {epochs!r}, …), expected whole numbers, from 1 to the last")
        number = isinstance(error, int | float) and math.isfinite(error)
        ensure(number, f"fit tells progress an error of {error!r}, expected a finite float, such as float(error)")


@after(is_made_unfitted)
def is_fitted_the_same_again(entry: Entry, registry: Registry) -> None:
    """fit gives the same numbers from the same seed, and draws from no global generator."""
    import torch

    context, recordings = context_for(entry, registry)
    found, drawn = [], False
    for turn in (2, 3):
        with _global_generators(1):  # so that what is drawn when it is made does not count here
            model = registry.make_measurement_model(entry.name, {}, context)
        with _global_generators(turn) as state:
            before = state()
            fit_as_in_a_run(model, recordings)
            drawn = drawn or state() != before
        found.append(dict(model.tensors()))
    for name, value in found[0].items():
        ensure(bool(torch.equal(value, found[1][name])), f"fitting it twice gives two '{name}'")
    ensure(not drawn, "fit draws from a global random generator")


@contextmanager
def _global_generators(seed: int) -> Iterator[Callable[[], str]]:
    """Global generators as somebody else left them, and as they were afterwards; gives what tells their state."""
    import torch

    def state() -> str:
        return f"{torch.random.get_rng_state().tolist()} {np.random.get_state(legacy=False)}"  # noqa: NPY002

    before = np.random.get_state()  # noqa: NPY002 - global on purpose
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(9_000 + seed)
        np.random.seed(9_000 + seed)  # noqa: NPY002
        try:
            yield state
        finally:
            np.random.set_state(before)  # noqa: NPY002


@after(is_made_unfitted)
def counts_in_deviations_of_the_target(entry: Entry, registry: Registry) -> None:
    """target_mean and target_std are those of the recordings, in the target's unit: rewards count in them."""
    context, recordings = context_for(entry, registry)
    model = fitted_model(entry, registry)
    target = np.concatenate([one.values(context.signals.target.name).reshape(-1) for one in recordings])
    for name, found, wanted in (("mean", model.target_mean, target.mean()), ("std", model.target_std, target.std())):
        ensure(
            abs(float(found) - wanted) <= 0.05 * target.std(),
            f"target_{name} is {float(found):g}, of the recordings it is {wanted:g} {context.signals.target.unit}",
        )


def predicts_in_deviations_of_the_target(entry: Entry, registry: Registry) -> None:
    """Its predictions along the recordings that it was fitted to are in standard deviations: about 0 ± 1."""
    # As its recordings are, and of a target that follows the inputs and varies much in its unit. The second fit makes
    # EPOCHS passes, and has no time limit: a slow machine would judge a model that was trained less.
    model = fitted_model(entry, registry)
    context, recordings = context_for(entry, registry)
    _about_one(model, context, _along(model, context, recordings))
    model, known = registry.make_measurement_model(entry.name, {}, context), of_known_scale(context, recordings, SPREAD)
    fit_as_in_a_run(model, known, epochs=EPOCHS, max_seconds=math.inf)
    along = _along(model, context, known)
    _about_one(model, context, along)
    predicted, target = along
    spread = float(predicted.std())
    follows = float(np.corrcoef(predicted, target)[0, 1]) if spread > 0 else 0.0
    if follows > FOLLOWS:
        factor = follows / spread  # by which the prediction fits best, in deviations
        ensure(
            factor < TOO_SMALL,
            f"follows the target (correlation {follows:.2f}) with {_pm(along[0])} where standard deviations are about "
            f"0 ± 1{_remedy(model, context)}",
        )


def _along(model: MeasurementModel, context: ModelContext, recordings: list[Any]) -> tuple[np.ndarray, np.ndarray]:
    """Predictions and the target in standard deviations, both after a second in which a memory fills."""
    import torch

    from hts.measurement.data import input_tensor

    run_in, name = round(context.signals.rate_hz), context.signals.target.name
    with torch.no_grad():
        means = [model.sequence(input_tensor(context.signals, one)[None])[0].mean[0, run_in:] for one in recordings]
    target = np.concatenate([one.values(name).reshape(-1)[run_in:] for one in recordings]).astype(float)
    return torch.cat(means).double().numpy(), (target - target.mean()) / target.std()


def _about_one(model: MeasurementModel, context: ModelContext, along: tuple[np.ndarray, np.ndarray]) -> None:
    mean, spread = float(along[0].mean()), float(along[0].std())
    ensure(
        abs(mean) <= FAR_OFF and spread <= 1 + FAR_OFF,
        f"predicts {_pm(along[0])} along the recordings that it was fitted to, where standard deviations are "
        f"about 0 ± 1{_remedy(model, context)}",
    )


def _pm(values: np.ndarray) -> str:
    return f"{values.mean():.3g} ± {values.std():.3g}"


def _remedy(model: MeasurementModel, context: ModelContext) -> str:
    target = f"{float(model.target_mean):.3g} ± {float(model.target_std):.3g} {context.signals.target.unit}"
    return f" (the target is {target}): fit to (target - target_mean) / target_std"


CHECKS: tuple[Check, ...] = (
    settings_are_all_there,
    making_it_draws_nothing,
    can_be_fitted,
    is_fitted_the_same_again,
    counts_in_deviations_of_the_target,
)
