"""A measurement model that breaks where it is asked in training is one line that names it, before anything is spent."""

from __future__ import annotations

import re

import pytest
import torch

from hts.config_loading import load_config
from hts.contracts import ModelContext, Prediction
from hts.errors import PluginError
from hts.measurement import files
from hts.measurement.fit_settings import FitSettings
from hts.measurement.fitting import fit_model
from hts.measurement.linear import Linear
from hts.plugins import load
from hts.run.ready import check_ready
from hts.testing.examples.measurement_model.model import Fading, Settings
from hts.testing.known_signals import SIGNALS, KnownHeat, known_heat
from hts.testing.packages import kit_installed

STEP, RESET, INITIAL = Fading.step, Fading.reset, Fading.initial_state


def boom(self, *given):
    raise RuntimeError("boom")


def after_the_first(self, inputs, state):
    prediction, new = STEP(self, inputs, state)
    return prediction, new.double()


CHANGES = {
    "an exception": ("step", boom, r"step\(\) failed, RuntimeError: boom"),
    "no state": (
        "step",
        lambda s, i, m: (STEP(s, i, m)[0], None),
        r"step\(\) gave NoneType as state, expected a tensor",
    ),
    "another type of state": ("step", after_the_first, r"step\(\) gave a state of float64 .*, expected float32"),
    "a prediction alone": (
        "step",
        lambda s, i, m: STEP(s, i, m)[0],
        r"step\(\) gave Prediction, expected a Prediction and",
    ),
    "a tensor": (
        "step",
        lambda s, i, m: (STEP(s, i, m)[0].mean, m),
        "gave Tensor and Tensor, expected a Prediction and",
    ),
    "one number for all worlds": (
        "step",
        lambda s, i, m: (Prediction(STEP(s, i, m)[0].mean.mean()), m),
        r"gave a prediction whose mean is \(\) for inputs of \(2, \d+\); expected \(2,\)",
    ),
    "nothing after a reset": ("reset", lambda s, m, begun: None, r"reset\(\) gave NoneType as state"),
    "no memory": ("initial_state", lambda s, n: None, r"initial_state\(\) gave NoneType as state"),
    "memory of all worlds as one": (
        "initial_state",
        lambda s, n: torch.zeros(2),
        r"initial_state\(\) gave shape \(2,\) as state of 3 worlds, expected a tensor with worlds first",
    ),
    "a recording's prediction in another shape": (
        "sequence",
        lambda s, i, m=None: (Prediction(i.sum(-1)[:, :-1]), m),
        r"sequence\(\): mean is \(1, 199\) for inputs of \(1, 200, channels\), expected \(1, 200\)",
    ),
    "an exception along a recording": ("sequence", boom, r"sequence\(\) failed, RuntimeError: boom"),
    "one share for all worlds": (
        "outside",
        lambda s, i: i.mean(),
        r"outside\(\) gave \(\) for inputs of \(2, \d+\); expected \(2,\), a share for each world",
    ),
    "no share": ("outside", lambda s, i: None, r"outside\(\) gave NoneType for inputs"),
    "numbers that are no tensors": ("tensors", lambda s: {"w": 1.0}, r"tensors\(\) gave a float, expected a dict of"),
    "no tensors at all": ("tensors", lambda s: None, r"tensors\(\) gave a NoneType, expected a dict of name"),
    "tensors that fail": ("tensors", lambda s: 1 / 0, r"tensors\(\) failed, ZeroDivisionError"),
    "its own tensors refused": ("load_tensors", boom, r"load_tensors\(\) failed, RuntimeError: boom"),
    "nothing where it was moved": ("to", lambda s, d: None, r"to\(\) gave a NoneType, expected the model itself"),
    "several steps at once": ("steps", lambda s, i, m, e: (1, 2, 3), r"steps\(\) gave int and int and int, expected a"),
}


@pytest.mark.parametrize("name", CHANGES)
def test_it_is_named_and_not_the_robot(name, monkeypatch):
    method, change, said = CHANGES[name]
    monkeypatch.setattr(Fading, method, change)
    config = load_config(
        preset="smoke", objectives=["fake"], robot="tiny", world="known", overrides=["objectives.fake.model=fading"]
    )
    with kit_installed(), pytest.raises(PluginError, match=said) as caught:
        check_ready(config, load(), "mujoco")
    assert re.match(r"Measurement model 'fading'( \(from hard-to-sim-testing\))?: ", str(caught.value))
    assert "\n" not in str(caught.value)


def test_a_state_is_looked_at_by_shape_and_type_alone():
    """On the device `meta`, where asking for a number is an error, as it would be a wait on a GPU."""
    from hts.measurement.transform import MeasurementTransform

    model = Fading(Settings(), SIGNALS).to("meta")
    made = MeasurementTransform.of(KnownHeat(), model)
    made.prepare(4, torch.device("meta"))
    made.evaluate(torch.zeros(4, 6, device="meta"))
    made.forget(torch.zeros(4, dtype=torch.bool, device="meta"))


def ready_said() -> str:
    """What is said before a run whose model is `fading`."""
    config = load_config(
        preset="smoke", objectives=["fake"], robot="tiny", world="known", overrides=["objectives.fake.model=fading"]
    )
    with kit_installed(), pytest.raises(PluginError) as caught:
        check_ready(config, load())
    return str(caught.value)


def test_a_fit_that_does_not_take_what_it_is_given_is_told_before_any_data_are_collected(monkeypatch):
    monkeypatch.setattr(Fading, "fit", lambda self, recordings: {})
    said = ready_said()
    assert said.startswith("Measurement model 'fading' (from hard-to-sim-testing): fit() does not take what it will be")
    assert "expected" in said.lower() and "seed, epochs, max_seconds, progress, warm_start" in said


def test_settings_that_are_no_property_are_told_before_any_data_are_collected(monkeypatch):
    monkeypatch.setattr(Fading, "settings", lambda self: {})
    assert "its `settings` is a method, expected a dict" in ready_said()


def test_a_fit_that_leaves_a_model_of_nan_is_told_by_the_fit_where_nothing_is_held_out():
    fitted = Fading.fit

    class Lost(Fading):
        def fit(self, recordings, **how):
            report = fitted(self, recordings, **how)
            self.load_tensors({name: value * float("nan") for name, value in self.tensors().items()})
            return report

    model = Lost(Settings(), SIGNALS)
    model.name = "lost"
    with pytest.raises(PluginError, match=r"^Measurement model 'lost': sequence\(\): mean is not finite at sample 0"):
        fit_model(model, [known_heat(1)], FitSettings(), None)


def test_a_model_on_disk_that_its_class_does_not_take_is_named(monkeypatch, tmp_path):
    model = load().make_measurement_model("linear", {}, ModelContext(SIGNALS))
    path = files.save(model, tmp_path / "model")
    monkeypatch.setattr(Linear, "load_tensors", boom)
    with pytest.raises(PluginError, match=r"^Measurement model 'linear': load_tensors\(\) failed, RuntimeError: boom"):
        files.load(path)
    monkeypatch.setattr(Linear, "tensors", lambda self: {"weight": [1.0]})
    with pytest.raises(PluginError, match=r"tensors\(\) gave a list, expected a dict of name -> torch.Tensor"):
        files.save(model, tmp_path / "other")
    assert not (tmp_path / "other.safetensors").exists()
