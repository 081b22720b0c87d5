"""The network that predicts a measurement: one step, many at once and whole sequences are one function."""

import math

import pytest
import torch

from hts.measurement.models import MeasurementModel, MeasurementModelConfig

SMALL = MeasurementModelConfig(inputs=("effort", "rate"), target="heat", hidden=16, products=True)


def model_and_data(layers: int, products: bool, *shape: int) -> tuple[MeasurementModel, torch.Tensor]:
    """An unfitted model with the statistics of data, which are (*shape, 6)."""
    config = MeasurementModelConfig(inputs=("a", "b"), target="y", hidden=8, layers=layers, products=products)
    model = MeasurementModel(config, (3, 3), 50.0, seed=1)
    data = 4.0 + 3.0 * torch.randn(*shape, 6, generator=torch.Generator().manual_seed(0))
    model.set_normaliser(data.flatten(0, 1), data[..., 0].flatten() * 2.0)
    return model.requires_grad_(False).eval(), data


@pytest.mark.parametrize("layers", [1, 2])
@pytest.mark.parametrize("products", [False, True])
def test_step_by_step_and_whole_sequence_give_the_same_prediction(layers, products):
    model, data = model_and_data(layers, products, 5, 40)
    whole, final = model.sequence(data)
    state, steps = model.initial_state(5), []
    for t in range(40):
        prediction, state = model.step(data[:, t], state)
        steps.append(prediction)
    torch.testing.assert_close(torch.stack(steps, 1), whole.detach(), atol=2e-5, rtol=1e-4)
    torch.testing.assert_close(state, final.detach(), atol=2e-5, rtol=1e-4)
    continued, _ = model.sequence(data[:, 20:], model.sequence(data[:, :20])[1])
    torch.testing.assert_close(continued, whole[:, 20:])


@pytest.mark.parametrize("layers", [1, 2])
@pytest.mark.parametrize("products", [False, True])
def test_many_steps_at_once_are_the_single_steps_to_the_bit_also_where_episodes_end(layers, products):
    model, data = model_and_data(layers, products, 12, 5)
    ended = torch.zeros(12, 5, dtype=torch.bool)
    ended[3, 1] = ended[3, 4] = ended[7, 0] = ended[11, 2] = True
    data[3, 4] = torch.nan  # a world that ends in NaN starts clean
    state, expected = model.initial_state(5), []
    for inputs, end in zip(data, ended, strict=True):
        prediction, state = model.step(inputs, state)
        expected.append(prediction)
        state = state.masked_fill(end, 0.0)
    found, memory = model.steps(data, model.initial_state(5), ended)
    assert torch.equal(found.nan_to_num(1e9), torch.stack(expected).nan_to_num(1e9))
    assert torch.equal(memory, state) and bool(memory.isfinite().all())


def test_products_are_squares_and_place_by_place_products_of_inputs_of_one_size():
    config = MeasurementModelConfig(inputs=("a", "b", "c"), target="y", products=True)
    model = MeasurementModel(config, (2, 1, 2), 50.0)
    features = model.features(torch.tensor([1.0, 2.0, 10.0, 3.0, 4.0]))
    # inputs; a·a, a·c, b·b, c·c
    assert features.tolist() == [1, 2, 10, 3, 4, 1, 4, 3, 8, 100, 9, 16]
    assert model.num_features == 12


def test_making_a_model_does_not_touch_the_global_random_generator():
    torch.manual_seed(5)
    expected = torch.rand(1)
    torch.manual_seed(5)
    MeasurementModel(SMALL, (3, 3), 50.0, seed=9)
    assert torch.equal(torch.rand(1), expected)


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
def test_a_bad_input_makes_that_worlds_prediction_nan_and_no_other(bad):
    model = MeasurementModel(SMALL, (3, 3), 50.0).eval()
    inputs = torch.zeros(4, 6)
    inputs[2, 1] = bad
    prediction, _ = model.step(inputs, model.initial_state(4))
    assert torch.isnan(prediction).tolist() == [False, False, True, False]
