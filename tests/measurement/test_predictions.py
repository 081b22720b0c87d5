"""A model that gives no prediction is named, with the fault, wherever its prediction is scored."""

from __future__ import annotations

import pytest
import torch

from hts.errors import PluginError
from hts.measurement.checks import predict, predict_with_spread
from hts.measurement.linear import Linear, LinearSettings
from hts.testing.known_signals import SIGNALS
from hts.testing.known_signals import known_heat as recording


def model(change):
    """A fitted model whose predictions are changed."""

    class Changed(Linear):
        def sequence(self, inputs, state=None):
            found, state = super().sequence(inputs, state)
            return change(found), state

    made = Changed(LinearSettings(), SIGNALS)
    Linear.fit(made, [recording(1), recording(2)])
    return made


def mean(function):
    return lambda found: found._replace(mean=function(found.mean))


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (
            mean(lambda value: value[..., None]),
            r"mean is \(1, \d+, 1\) for inputs of \(1, \d+, channels\), expected \(1,",
        ),
        (
            mean(lambda value: torch.where(torch.arange(value.shape[1]) == 7, torch.nan, value)),
            "not finite at sample 7",
        ),
        (mean(lambda value: value.tolist()), "mean is list"),
        (lambda found: found.mean, "gives Tensor and Tensor, expected a Prediction and the state"),
        (lambda found: found._replace(std=found.mean[0]), r"std is \(\d+,\)"),
        (lambda found: found._replace(std=-torch.ones_like(found.mean)), "std is -1 at its least, expected a"),
    ],
)
def test_no_prediction_is_no_score(change, said):
    with pytest.raises(PluginError, match=rf"^Measurement model 'Changed': sequence\(\).*{said}"):
        predict(model(change), recording(3))


def test_a_model_may_be_sure_of_what_it_predicts():
    """A standard deviation of 0 is none below 0."""
    sure = predict_with_spread(model(lambda found: found._replace(std=torch.zeros_like(found.mean))), recording(3))[1]
    assert sure is not None and not sure.any()


def test_a_sound_one_is_scored():
    assert predict(model(lambda found: found), recording(3)).ndim == 1
