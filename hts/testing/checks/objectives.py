"""Objectives: their parts, their model, their score. The reward and the proxy are in `rewards`."""

from __future__ import annotations

import math
import tempfile
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from hts import units
from hts.channels import Channel
from hts.config import MeasurementConfig, Named
from hts.contracts import MODEL, Objective
from hts.contracts.measurement_model import several_numbers
from hts.errors import HtsError, PluginError, unknown_name
from hts.evaluation.scoring import plain
from hts.evaluation.segments import Segments
from hts.plugins import Entry, Registry
from hts.testing.checks.ensure import after, ensure, listed, same
from hts.testing.checks.instruments import remembered
from hts.testing.checks.made_up import segments, sim_channels, walk
from hts.testing.examples.robot.robot import Tiny

MOST_REMEMBERED = 0.25
"""Share that may be left of a target's change after ten seconds of rest: that of a time constant of seven seconds."""


def has_its_parts(entry: Entry, registry: Registry) -> None:
    """It is made without settings; name as registered, known unit, inputs, target, λ above 0."""
    objective = entry.factory({})
    ensure(isinstance(objective, Objective), f"is a {type(objective).__name__}, not a hts.contracts.Objective")
    lacking = [part for part in ("name", "unit", "inputs", "target") if part not in dir(objective)]
    ensure(not lacking, f"its class sets no {listed(lacking)}")
    ensure(objective.name == entry.name, f"calls itself '{objective.name}'")
    ensure(units.known(str(objective.unit)), units.unknown(str(objective.unit)))
    for what, channel in [("target", objective.target), *(("also_measured", c) for c in objective.also_measured)]:
        ensure(isinstance(channel, Channel), f"its {what} is a {type(channel).__name__}")
    ensure(math.prod(objective.target.shape) == 1, several_numbers(objective.target))
    names = isinstance(objective.inputs, tuple | list) and all(isinstance(one, str) for one in objective.inputs)
    ensure(
        names and bool(objective.inputs),
        f"its inputs are {objective.inputs!r}, expected names of channels, such as ('joint_torque',)",
    )
    for what in ("weights", "baseline_weights", "proxy_weights"):
        values = getattr(objective, what)
        numbers = isinstance(values, tuple | list) and all(isinstance(v, int | float) for v in values)
        ensure(numbers, f"its {what} are {values!r}, expected a tuple of numbers, such as (0.5, 1.0)")
        ensure(all(math.isfinite(v) and v > 0 for v in values), f"{what} are {tuple(values)}")
    ensure(bool(objective.weights), "weights are empty, so nothing is swept")
    registry.make_objective(entry.name)  # and all that a run refuses


def own_weights_fit_any_sensor(entry: Entry, registry: Registry) -> None:
    """weights_for gives as many finite λ of at least 0 as `weights`, whatever standard deviation the data have."""
    objective = entry.factory({})
    recordings = [walk(objective, registry, seed=seed) for seed in range(2)]
    for spread in (0.1, 10.0):
        found = tuple(objective.weights_for(spread, recordings))
        ensure(len(found) == len(objective.weights), f"weights_for gives {found}, weights are {objective.weights}")
        ensure(all(math.isfinite(one) and one >= 0 for one in found), f"weights_for gives {found}")


def wrong_weights_are_told(entry: Entry, registry: Registry) -> None:
    """Settings of λ refuse -1 and NaN in one line: below 0, more of what is bad would be rewarded."""
    for key in ("weights", "baseline_weights"):
        for wrong in (-1.0, math.nan):
            try:
                registry.make_objective(entry.name, {key: [wrong]})
            except HtsError:
                continue
            except Exception as error:
                raise PluginError(f"{key}=[{wrong:g}] ends in a traceback, {type(error).__name__}: {error}") from error
            ensure(False, f"takes {key}=[{wrong:g}]")


def channels_are_known(entry: Entry, registry: Registry) -> None:
    """Its inputs are sim channels of some installed robot, and what it measures is none of them."""
    objective, known = entry.factory({}), sim_channels(registry)
    for name in objective.inputs:
        ensure(name in known, unknown_name("channel", name, known))
    for name in (channel.name for channel in objective.real_channels):
        what = "target" if name == objective.target.name else "also_measured"
        ensure(name not in known, f"its {what} '{name}' is a sim channel already: nothing is left to be measured")


def instrument_measures_the_target(entry: Entry, registry: Registry) -> None:
    """The instrument that it names for twins is installed and gives what it measures, with that unit and shape."""
    objective = entry.factory({})
    if objective.instrument is None:
        return
    instrument = registry.make_instrument(objective.instrument, {}, Tiny())
    given = {channel.name: channel for channel in instrument.channels}
    for wanted in objective.real_channels:
        ensure(wanted.name in given, f"instrument '{objective.instrument}' gives {listed(given)}, not '{wanted.name}'")
        found = given[wanted.name]
        ensure(
            (found.unit, found.shape) == (wanted.unit, wanted.shape),
            f"'{wanted.name}' is {wanted.unit} {wanted.shape} here and {found.unit} {found.shape} in "
            f"'{objective.instrument}'",
        )


@after(instrument_measures_the_target)
def target_forgets(entry: Entry, registry: Registry) -> None:
    """What its instrument shows of the target forgets motion within seconds: trials last seconds, and policies take
    turns on one machine."""
    objective = entry.factory({})
    if objective.instrument is None or math.prod(objective.target.shape) != 1:
        return
    name = objective.target.name
    left = remembered(registry.make_instrument(objective.instrument, {}, Tiny()), name)
    ensure(
        abs(left) < MOST_REMEMBERED,
        f"its target '{name}' remembers: {left:.0%} of what 10 s of motion changed in instrument "
        f"'{objective.instrument}' is left after 10 s of rest, so a trial of seconds cannot measure it. Make what it "
        "follows the target (what a motor loses now, W, in the place of how warm it is), and keep this one in "
        "also_measured",
    )


def model_is_registered(entry: Entry, registry: Registry) -> None:
    """measurement_model() names an installed model, with settings that it takes, for its inputs and its target."""
    from hts.measurement.fit_command import new_model

    objective = entry.factory({})
    choice = objective.measurement_model()
    ensure(isinstance(choice, Named), f"measurement_model() gives a {type(choice).__name__}, not a hts.config.Named")
    new_model(objective, walk(objective, registry), registry=registry)
    try:
        entry.factory({MODEL: choice.name})
    except Exception:  # noqa: BLE001 - whatever it says: it refuses the key, as it should
        return
    ensure(
        False,
        f"takes a setting '{MODEL}' of its own; that key is the core's, which chooses the measurement model by it",
    )


def model_is_fitted_saved_and_loaded(entry: Entry, registry: Registry) -> None:
    """Its model can be fitted to recordings, twice with the same result, and read back from its file unchanged."""
    import torch

    from hts.measurement import files
    from hts.measurement.fit_command import fit_and_check

    objective = entry.factory({})
    recordings = [walk(objective, registry, seed=seed) for seed in range(3)]
    first, second = (
        fit_and_check(objective, recordings, MeasurementConfig(epochs=1), registry=registry).model for _ in range(2)
    )
    states = [{name: value.numpy() for name, value in model.tensors().items()} for model in (first, second)]
    ensure(all(same(value, states[1][name]) for name, value in states[0].items()), "fitting it twice gives two models")
    with tempfile.TemporaryDirectory() as folder:
        loaded = files.load(files.save(first, Path(folder) / "model"), registry=registry)
    inputs = torch.rand(4, loaded.signals.num_inputs, generator=torch.Generator().manual_seed(0))
    before, after = (model.step(inputs, model.initial_state(4))[0].mean for model in (first, loaded))
    ensure(bool(torch.equal(before, after)), "it predicts something else after it was saved and loaded")


def scores_each_segment(entry: Entry, registry: Registry) -> None:
    """score gives finite numbers, one per segment, the same each time, and changes no recording."""
    objective = entry.factory({})
    made_up = segments(objective, registry)
    before = _all_values(made_up)
    scores = objective.score(made_up)
    ensure(
        isinstance(scores, Mapping),
        f"score gives a {type(scores).__name__}, expected names with arrays, one number per segment",
    )
    ensure(bool(scores), "score gives nothing")
    wanted = (len(made_up),)
    for name, values in scores.items():
        ensure(np.shape(values) == wanted, f"score '{name}' has shape {np.shape(values)} for segments {wanted}")
        ensure(bool(np.isfinite(values).all()), f"score '{name}' holds numbers that are not finite (NaN or inf)")
    changed = [name for name, values in _all_values(made_up).items() if not same(values, before[name])]
    ensure(not changed, f"score changes '{listed(changed)}' of the recordings in place")
    again = objective.score(made_up)
    ensure(all(same(values, again[name]) for name, values in scores.items()), "score differs from one time to the next")


@after(scores_each_segment)
def compares_means(entry: Entry, registry: Registry) -> None:
    """compare gives a Comparison of finite single numbers, 0 between equals, and changes nothing that it is given."""
    objective = entry.factory({})
    means = _means(objective, segments(objective, registry))
    policy, reference = dict(means), dict(means)
    comparison = plain(objective, objective.compare(policy, reference))
    ensure(policy == means and reference == means, "compare changes the means that it is given in place")
    numbers = {"selection_score": comparison.selection_score, **comparison.metrics}
    for name, value in numbers.items():
        ensure(math.isfinite(value), f"'{name}' is {value} for two equal policies")
    found = comparison.improvement
    ensure(abs(found) < 1e-9, f"a policy equal to its reference improves by {found:g}")


@after(compares_means)
def score_lets_nan_through(entry: Entry, registry: Registry) -> None:
    """A NaN that was measured makes its segment's score NaN and no other's, and the improvement NaN: never a number."""
    objective = entry.factory({})
    made_up = segments(objective, registry)
    clean = objective.score(made_up)
    for recording in made_up.recordings:
        recording.channels[objective.target.name].values[made_up.start[0] + 1] = np.nan
    with np.errstate(all="ignore"):
        dirty = objective.score(made_up)
        ensure(any(not np.isfinite(values[0]) for values in dirty.values()), "score makes a number of a NaN")
        ensure(
            all(same(values[1:], clean[name][1:], 1e-6) for name, values in dirty.items()),
            "a NaN in one segment changes the score of others",
        )
        means = {name: float(np.mean(values)) for name, values in dirty.items()}
        reference = {name: float(np.mean(values)) for name, values in clean.items()}
        improvement = objective.compare(means, reference).improvement
    ensure(not math.isfinite(improvement), f"compare makes {improvement:g} of a mean that is NaN")


@after(compares_means)
def reward_and_score_agree(entry: Entry, registry: Registry) -> None:
    """What pays in training is what counts on the robot: reward and improvement rise and fall together."""
    import torch

    objective = entry.factory({})
    low, high = (_means(objective, segments(objective, registry, factor)) for factor in (0.9, 1.0))
    gain = objective.compare(low, high).improvement  # of showing less
    less, more = objective.reward(torch.tensor([-1.0, 1.0])).tolist()
    ensure(math.isfinite(gain), f"a target that is 10 % lower improves it by {gain}")
    ways = {True: "less", False: "more"}
    opposed = gain * (less - more) < 0
    ensure(not opposed, f"reward pays for {ways[less > more]} of the target, compare for {ways[gain > 0]} of it")


def reward_remembers_no_data(entry: Entry, registry: Registry) -> None:
    """weights_for changes no reward: it is not asked where λ are named, nor when a run goes on, so a reward that hung
    on it would be another one there."""
    import torch

    objective, prediction = entry.factory({}), torch.linspace(-3.0, 3.0, 13)
    before = objective.reward(prediction.clone())
    objective.weights_for(0.5, [walk(objective, registry, seed=0)])
    after = objective.reward(prediction.clone())
    ensure(torch.equal(before, after), "reward gives other numbers once weights_for was asked, of the same predictions")


def _means(objective: Objective, made_up: Segments) -> dict[str, float]:
    scores = objective.score(made_up)
    return {name: float(np.mean(values)) for name, values in scores.items()}


def _all_values(made_up: Segments) -> dict[str, np.ndarray]:
    return {name: s.values.copy() for recording in made_up.recordings for name, s in recording.channels.items()}


CHECKS = (
    has_its_parts,
    channels_are_known,
    instrument_measures_the_target,
    target_forgets,
    own_weights_fit_any_sensor,
    wrong_weights_are_told,
    model_is_registered,
    model_is_fitted_saved_and_loaded,
    scores_each_segment,
    compares_means,
    score_lets_nan_through,
)
"""Before those of the reward; `reward_and_score_agree` comes after them."""
