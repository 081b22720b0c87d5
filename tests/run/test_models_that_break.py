"""A measurement model that breaks where it is asked in training is one line that names it, before anything is spent."""

from __future__ import annotations

import pytest
import torch

from hts.config_loading import load_config
from hts.contracts import Prediction
from hts.errors import PluginError
from hts.plugins import load
from hts.run.ready import check_ready
from hts.testing.examples.measurement_model.model import Fading, Settings
from hts.testing.packages import kit_installed

STEP, RESET, INITIAL = Fading.step, Fading.reset, Fading.initial_state


def boom(self, inputs, state):
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
    assert str(caught.value).startswith("Measurement model 'fading': ") and "\n" not in str(caught.value)


def test_a_state_is_looked_at_by_shape_and_type_alone():
    """On the device `meta`, where asking for a number is an error, as it would be a wait on a GPU."""
    from hts.measurement.transform import MeasurementTransform
    from hts.testing.known_signals import SIGNALS, KnownHeat

    model = Fading(Settings(), SIGNALS).to("meta")
    made = MeasurementTransform.of(KnownHeat(), model)
    made.prepare(4, torch.device("meta"))
    made.evaluate(torch.zeros(4, 6, device="meta"))
    made.forget(torch.zeros(4, dtype=torch.bool, device="meta"))
