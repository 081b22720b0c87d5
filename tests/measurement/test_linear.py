"""`linear`: what can be said with few numbers, solved in one go."""

import numpy as np
import pytest
import torch

from hts.channels import Channel
from hts.contracts import Signals
from hts.errors import RecordingError
from hts.measurement.checks import predict
from hts.measurement.linear import Linear, LinearSettings
from hts.measurement.ridge import RIDGES, Moments, chosen, parts_left_out, penalty_of
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


def test_the_penalty_is_chosen_by_cross_validation_unless_it_is_given():
    data = [known_heat(1, seconds=12.0)]
    _, chosen = fitted(data, pooling=1.0)
    errors = {ridge: 1 - fitted(data, ridge=ridge, pooling=1.0)[1]["validation_r2"] for ridge in (1e-6, 1e-2, 10.0)}
    assert chosen["ridge"] <= 1e-2 and 1 - chosen["validation_r2"] <= 1.5 * min(errors.values()) + 1e-9
    assert fitted(data, ridge=0.5)[1]["ridge"] == 0.5


def test_noise_alone_takes_the_largest_penalty():
    r = known_heat(1)
    noise = np.random.default_rng(0).normal(size=1000)
    model, report = fitted([r.replace(channels={**r.channels, "heat": Series(HEAT, noise)})])
    assert report["ridge"] == 10.0 and report["validation_r2"] < 0.02
    assert predict(model, r).std() < 0.1


def test_the_past_is_left_alone_where_it_says_nothing():
    rng = np.random.default_rng(0)
    r = known_heat(1)
    now = (r.values("effort") * r.values("rate")).sum(1) + rng.normal(0, 0.5, 1000)
    model, report = fitted([r.replace(channels={**r.channels, "heat": Series(HEAT, now)})])
    assert report["lag_seconds"] == 0.0 and not model.weight[1:].any()


def test_joints_share_a_coefficient_where_there_is_little_data():
    # Twelve joints take power alike; 5 s with noise are too few for a coefficient of each of 60 features.
    effort, rate = (Channel(name, unit, (12,)) for name, unit in (("effort", "N*m"), ("rate", "rad/s")))

    def walk(seed, seconds):
        rng, count = np.random.default_rng(seed), round(50 * seconds)
        values = {effort: rng.normal(size=(count, 12)), rate: rng.normal(size=(count, 12))}
        power = (values[effort] * values[rate]).sum(1)
        values[HEAT] = power + rng.normal(0, power.std(), count)
        channels = {channel.name: Series(channel, value) for channel, value in values.items()}
        return known_heat(seed, seconds=seconds).replace(channels=channels), power

    (short, _), (new, truth) = walk(1, 5.0), walk(50, 60.0)
    error, found = {}, {}
    for pooling in (1.0, None):
        model = Linear(LinearSettings(pooling=pooling, lags=0), Signals((effort, rate), HEAT, 50.0))
        found[pooling] = model.fit([short])["pooling"]
        error[pooling] = float(((predict(model, new) - truth) ** 2).mean() / truth.var())
    assert found[None] > 1.0 and error[None] < 0.5 * error[1.0]


def test_weights_of_other_units_are_pooled_in_the_channels_own_unit():
    std = torch.tensor([1.0, 3.0])
    along = torch.tensor([1.0, 3.0, 0.0], dtype=torch.double)
    penalty = penalty_of(1000.0, std, [slice(0, 2)], 1)
    assert float(along @ penalty @ along) == pytest.approx(10.0 / 1000.0)  # equal coefficients: κ times less
    across = torch.tensor([3.0, -1.0, 0.0], dtype=torch.double)
    assert float(across @ penalty @ across) == pytest.approx(10.0)


def test_the_largest_penalty_within_one_standard_error_of_the_least_is_taken():
    x = torch.randn(400, 3, generator=torch.Generator().manual_seed(0), dtype=torch.double)
    y = x[:, 0] + 3.0 * torch.randn(400, generator=torch.Generator().manual_seed(1), dtype=torch.double)
    folds = []
    for start in range(0, 400, 80):
        folds.append(Moments(4))
        part = slice(start, start + 80)
        folds[-1].add(torch.cat((x[part], torch.ones(80, 1, dtype=torch.double)), 1), y[part])
    least = [chosen(folds, torch.ones(3), [], 1, (ridge,)).error for ridge in RIDGES]
    found = chosen(folds, torch.ones(3), [], 1)
    assert found.ridge >= RIDGES[least.index(min(least))] and found.error <= 1.1 * min(least)


def test_parts_left_out_are_policies_or_recordings_or_stretches():
    def parts(*policies):
        made = [known_heat(i, policy, seconds=8.0) for i, policy in enumerate(policies)]
        return parts_left_out(made, [one.num_samples for one in made], 50.0)

    assert parts(*"aabbccdd") == [[(400, fold)] for fold in (0, 0, 1, 1, 2, 2, 3, 3)]
    assert parts(*"aaaaa") == [[(400, fold)] for fold in range(5)]
    assert parts("a") == [[(100, 0), (200, 1), (300, 2), (400, 3)]]  # stretches of two seconds


@pytest.mark.parametrize("count", [2, 3, 6])
def test_what_stands_twice_in_the_list_is_left_out_with_its_twin(count):
    """A bootstrap draws recordings several times; a fold that is fitted to the twin of what it leaves out says nothing.
    The channel is so noisy that a small penalty fits the noise."""
    recordings = []
    for seed in range(count):
        one, noise = known_heat(seed, seconds=4.0), np.random.default_rng(100 + seed)
        heat = one.values("heat") + 15.0 * noise.standard_normal(one.num_samples)
        recordings.append(one.replace(channels={**one.channels, "heat": Series(HEAT, heat)}))
    _, once = fitted(recordings)
    _, twice = fitted([*recordings, *(one.replace() for one in recordings)])
    for name in ("ridge", "pooling", "lag_seconds"):
        assert twice[name] == once[name]
    assert twice["validation_r2"] == pytest.approx(once["validation_r2"], abs=0.01)


def test_an_input_that_never_varies_does_no_harm():
    r = known_heat(1)
    still = r.replace(channels={**r.channels, "rate": Series(r.channels["rate"].channel, np.ones((1000, 3)))})
    model, report = fitted([still])
    assert np.isfinite(report["validation_r2"]) and torch.isfinite(model.weight).all()


def test_a_constant_target_is_refused():
    r = known_heat(1)
    with pytest.raises(RecordingError, match="3 in all 1000 samples"):
        fitted([r.replace(channels={**r.channels, "heat": Series(HEAT, np.full(1000, 3.0))})])


@pytest.mark.parametrize("level", [1.9, 0.0])
def test_where_nothing_varies_in_what_is_left_out_there_is_no_r2(level):
    """The gauge stands still from 0.4 s on: what the lags need before is all that moves."""
    r = known_heat(1)
    heat = r.values("heat").copy()
    heat[20:] = level
    model, report = fitted([r.replace(channels={**r.channels, "heat": Series(HEAT, heat)})])
    assert report["validation_r2"] is None and torch.isfinite(model.weight).all()


def test_inputs_that_all_stand_still_are_refused():
    r = known_heat(1)
    still = {name: Series(one.channel, np.ones_like(one.values)) for name, one in r.channels.items() if name != "heat"}
    with pytest.raises(RecordingError, match="the same in all 1000 samples"):
        fitted([r.replace(channels={**still, "heat": r.channels["heat"]})])
