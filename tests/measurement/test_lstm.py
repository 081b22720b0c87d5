"""The network that predicts a measurement: one step, many at once and whole sequences are one function."""

import math

import pytest
import torch

from hts.channels import Channel
from hts.contracts import Signals
from hts.measurement.lstm import LSTM, LSTMSettings, worlds_last
from hts.measurement.lstm_fit import _search
from hts.recordings.recording import Series
from hts.testing.known_signals import SIGNALS, known_heat

SMALL = LSTMSettings(hidden=16, products=True)
HEAT = Signals((Channel("effort", "N*m", (3,)), Channel("rate", "rad/s", (3,))), Channel("heat", "W"), 50.0)


def model_and_data(layers: int, products: bool, *shape: int) -> tuple[LSTM, torch.Tensor]:
    """An unfitted model with the statistics of data, which are (*shape, 6)."""
    model = LSTM(LSTMSettings(hidden=8, layers=layers, products=products), HEAT, seed=1)
    data = 4.0 + 3.0 * torch.randn(*shape, 6, generator=torch.Generator().manual_seed(0))
    model.set_statistics(data.flatten(0, 1), data[..., 0].flatten() * 2.0)
    return model, data


@pytest.mark.parametrize("layers", [1, 2])
@pytest.mark.parametrize("products", [False, True])
def test_step_by_step_and_whole_sequence_give_the_same_prediction(layers, products):
    model, data = model_and_data(layers, products, 5, 40)
    whole, final = model.sequence(data)
    state, steps = model.initial_state(5), []
    for t in range(40):
        prediction, state = model.step(data[:, t], state)
        steps.append(prediction.mean)
    torch.testing.assert_close(torch.stack(steps, 1), whole.mean, atol=2e-5, rtol=1e-4)
    torch.testing.assert_close(state, final, atol=2e-5, rtol=1e-4)
    continued, _ = model.sequence(data[:, 20:], model.sequence(data[:, :20])[1])
    torch.testing.assert_close(continued.mean, whole.mean[:, 20:])


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
        expected.append(prediction.mean)
        state = model.reset(state, end)
    found, memory = model.steps(data, model.initial_state(5), ended)
    assert torch.equal(found.mean.nan_to_num(1e9), torch.stack(expected).nan_to_num(1e9))
    assert torch.equal(memory, state) and bool(memory.isfinite().all())


def test_products_are_squares_and_place_by_place_products_of_inputs_of_one_size():
    inputs = Channel("a", "1", (2,)), Channel("b", "1"), Channel("c", "1", (2,))
    model = LSTM(LSTMSettings(products=True), Signals(inputs, Channel("y", "1"), 50.0))
    features = model.features(torch.tensor([1.0, 2.0, 10.0, 3.0, 4.0]))
    # inputs; a·a, a·c, b·b, c·c
    assert features.tolist() == [1, 2, 10, 3, 4, 1, 4, 3, 8, 100, 9, 16]
    assert model.num_features == 12


def test_making_a_model_does_not_touch_the_global_random_generator():
    torch.manual_seed(5)
    expected = torch.rand(1)
    torch.manual_seed(5)
    LSTM(SMALL, HEAT, seed=9)
    assert torch.equal(torch.rand(1), expected)


@pytest.mark.parametrize("level", [1.9, 1.25, 0.0])
def test_an_end_in_which_the_robot_stands_is_fitted_to_and_has_no_r2(level):
    """The last tenth chooses the epoch; nothing varies in it."""
    r = known_heat(1)
    heat = r.values("heat").copy()
    heat[880:] = level
    report = LSTM(LSTMSettings(hidden=4), HEAT).fit(
        [r.replace(channels={**r.channels, "heat": Series(r.channels["heat"].channel, heat)})], epochs=2
    )
    assert report["validation_r2"] is None and report["best_epoch"] >= 1
    assert 0.1 < report["curve"][0]["training"] < 3.0  # a mean square: 1 is what the mean level alone leaves


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
def test_a_bad_input_makes_that_worlds_prediction_nan_and_no_other(bad):
    model = LSTM(SMALL, HEAT)
    inputs = torch.zeros(4, 6)
    inputs[2, 1] = bad
    prediction, _ = model.step(inputs, model.initial_state(4))
    assert torch.isnan(prediction.mean).tolist() == [False, False, True, False]


def test_a_state_that_is_laid_out_worlds_first_gives_the_same_bits_and_no_world_is_copied_otherwise():
    model, data = model_and_data(2, True, 1, 5)
    _, state = model.step(data[0], model.initial_state(5))
    packed = state.contiguous()
    assert packed.stride() != state.stride()
    assert torch.equal(model.step(data[0], packed)[0].mean, model.step(data[0], state)[0].mean)
    assert worlds_last(state).data_ptr() == state.data_ptr()  # a view, nothing moved


def test_what_begins_anew_is_empty_and_the_other_worlds_keep_their_bits():
    model, data = model_and_data(1, False, 1, 5)
    _, state = model.step(data[0], model.initial_state(5))
    after = model.reset(state, torch.tensor([False, True, False, False, False]))
    assert torch.equal(after[1], model.initial_state(1)[0])
    assert torch.equal(after[[0, 2, 3, 4]], state[[0, 2, 3, 4]])


class Told:
    """Passes over nothing whose errors are told; the model's weight is the number of the last pass."""

    validation = None

    def __init__(self, *errors: float) -> None:
        self.model, self.errors, self.count = torch.nn.Linear(1, 1, bias=False), errors, 0

    def epoch(self) -> float:
        self.count += 1
        with torch.no_grad():
            self.model.weight.fill_(float(self.count))
        return self.errors[self.count - 1]


@pytest.mark.parametrize(
    ("epochs", "patience", "until", "passes", "stopped", "best"),
    [
        (20, 3, math.inf, 6, "patience", 3),  # the third was the best, and three after it are not better
        (20, 4, math.inf, 8, "epochs", 7),  # the seventh comes before it is out of patience
        (5, 9, math.inf, 5, "epochs", 3),
        (20, 9, -math.inf, 1, "time", 1),
    ],
)
def test_a_fit_ends_when_nothing_got_better_for_so_long_and_keeps_the_best(
    epochs, patience, until, passes, stopped, best
):
    told = Told(5.0, 4.0, 2.0, 2.5, 2.0, 2.2, 1.0, 1.5)
    found = _search(told, min(epochs, 8), patience, until, None)
    assert (len(found.curve), found.stopped, found.best_epoch) == (passes, stopped, best)
    assert float(found.best["weight"]) == best and found.best_error == told.errors[best - 1]


def test_inputs_of_another_width_are_refused_and_not_stretched():
    model = LSTM(LSTMSettings(hidden=8), SIGNALS)
    with pytest.raises(
        ValueError, match=r"shape \(2, 5, 1\); expected \d+ numbers in the last dimension, side by side: "
    ):
        model.sequence(torch.zeros(2, 5, 1))
