"""`linear`: what can be said with few numbers, solved in one go."""

import numpy as np
import pytest
import torch

from hts.errors import RecordingError
from hts.measurement.checks import predict
from hts.measurement.linear import Linear, LinearSettings
from hts.measurement.scoring import r2
from hts.recordings.recording import Series
from hts.testing.known_signals import HEAT, SIGNALS, known_heat


def fitted(recordings, **settings) -> tuple[Linear, dict]:
    model = Linear(LinearSettings(**settings), SIGNALS)
    return model, model.fit(recordings)


def test_a_delayed_and_averaged_product_is_found_exactly_when_its_lags_are_given():
    # heat is a mean of the products 2 to 6 samples ago: with every sample of 0.2 s as a lag nothing is left over.
    model, report = fitted([known_heat(1), known_heat(2)], lag_seconds=0.2, lags=10)
    new = known_heat(50, "stranger", gait=1.3)
    assert r2(new.values("heat")[50:], predict(model, new)[50:]) > 0.9999
    assert report["stopped"] == "solved" and report["validation_r2"] > 0.9999
    weights = (model.weight / model.feature_std)[:, :] * model.target_std
    product = weights[:, 6 + 3 : 6 + 6]  # features: 6 inputs, effort², effort·rate, rate²
    assert product[2:7].numpy() == pytest.approx(2.0 / 5.0, abs=0.01)
    assert product[[0, 1, 7, 8, 9, 10]].abs().max() < 0.01


def test_without_products_a_product_cannot_be_found():
    _, report = fitted([known_heat(1), known_heat(2)], products=False)
    assert report["validation_r2"] < 0.5


def test_step_by_step_and_whole_sequence_give_the_same_prediction_also_from_a_state():
    model, _ = fitted([known_heat(1)])
    data = torch.randn(5, 60, 6, generator=torch.Generator().manual_seed(0))
    whole, final = model.sequence(data)
    state, found = model.initial_state(5), []
    for t in range(60):
        prediction, state = model.step(data[:, t], state)
        found.append(prediction.mean)
    torch.testing.assert_close(torch.stack(found, 1), whole.mean, atol=2e-5, rtol=1e-4)
    torch.testing.assert_close(state, final, atol=2e-5, rtol=1e-4)
    continued, _ = model.sequence(data[:, 25:], model.sequence(data[:, :25])[1])
    torch.testing.assert_close(continued.mean, whole.mean[:, 25:], atol=2e-5, rtol=1e-4)


def test_a_model_without_lags_has_no_memory():
    model, _ = fitted([known_heat(1)], lag_seconds=0.0)
    assert model.initial_state(3).shape == (3, 0)
    prediction, state = model.step(torch.ones(3, 6), model.initial_state(3))
    assert prediction.mean.shape == (3,) and state.shape == (3, 0)


def test_the_penalty_is_the_best_on_the_ends_of_the_recordings_unless_it_is_given():
    data = [known_heat(1, seconds=6.0)]
    _, chosen = fitted(data)
    errors = {ridge: 1 - fitted(data, ridge=ridge)[1]["validation_r2"] for ridge in (1e-6, 1e-2, 10.0)}
    assert 1 - chosen["validation_r2"] <= min(errors.values()) + 1e-9


def test_an_input_that_never_varies_does_no_harm():
    r = known_heat(1)
    still = r.replace(channels={**r.channels, "rate": Series(r.channels["rate"].channel, np.ones((1000, 3)))})
    model, report = fitted([still])
    assert np.isfinite(report["validation_r2"]) and torch.isfinite(model.weight).all()


def test_a_constant_target_is_refused():
    r = known_heat(1)
    with pytest.raises(RecordingError, match="3 in all 1000 samples"):
        fitted([r.replace(channels={**r.channels, "heat": Series(HEAT, np.full(1000, 3.0))})])
