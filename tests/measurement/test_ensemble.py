"""`ensemble`: the mean and the spread of members that saw different samples of the recordings."""

import pytest
import torch

from hts.config import Named
from hts.contracts import ModelContext, Prediction
from hts.errors import ConfigError
from hts.measurement.ensemble import enough_parts
from hts.measurement.pessimism import pessimistic_reward
from hts.plugins import load
from hts.testing.known_signals import SIGNALS, known_heat

LINEAR = Named(name="linear", lags=4)


def make(default=LINEAR, **settings):
    return load().make_measurement_model("ensemble", settings, ModelContext(SIGNALS, default))


@pytest.fixture(scope="module", params=["linear", "lstm"])
def fitted(request):
    model = make(members=3, member={"name": request.param, **({"hidden": 8} if request.param == "lstm" else {})})
    report = model.fit([known_heat(seed, seconds=10.0) for seed in range(3)], epochs=2, seed=1)
    return model, report


def test_mean_and_spread_are_those_of_the_members_in_one_scale(fitted):
    model, _ = fitted
    data = torch.randn(2, 30, 6, generator=torch.Generator().manual_seed(0))
    found, _ = model.sequence(data)
    each = torch.stack([m.denormalise(m.sequence(data)[0].mean) for m in model.members])  # W
    torch.testing.assert_close(model.denormalise(found.mean), each.mean(0), atol=1e-4, rtol=1e-4)
    torch.testing.assert_close(found.std * model.target_std, each.std(0), atol=1e-4, rtol=1e-4)
    assert (found.std > 0).all()


def test_many_steps_at_once_are_the_single_steps_to_the_bit_also_where_episodes_end(fitted):
    model, _ = fitted
    data = torch.randn(9, 5, 6, generator=torch.Generator().manual_seed(0))
    ended = torch.zeros(9, 5, dtype=torch.bool)
    ended[3, 1] = ended[7, 0] = True
    state, expected = model.initial_state(5), []
    for inputs, end in zip(data, ended, strict=True):
        prediction, state = model.step(inputs, state)
        state = model.reset(state, end)
        expected.append(prediction)
    found, after = model.steps(data, model.initial_state(5), ended)
    assert torch.equal(found.mean, torch.stack([one.mean for one in expected]))
    assert torch.equal(found.std, torch.stack([one.std for one in expected]))
    assert torch.equal(after, state) and state.shape[:2] == (5, 3)


def test_step_by_step_and_whole_sequence_agree(fitted):
    model, _ = fitted
    data = torch.randn(4, 20, 6, generator=torch.Generator().manual_seed(0))
    whole, final = model.sequence(data)
    state = model.initial_state(4)
    for t in range(20):
        prediction, state = model.step(data[:, t], state)
    torch.testing.assert_close(prediction.mean, whole.mean[:, -1], atol=2e-5, rtol=1e-4)
    torch.testing.assert_close(prediction.std, whole.std[:, -1], atol=2e-5, rtol=1e-3)
    torch.testing.assert_close(state, final, atol=2e-5, rtol=1e-4)


def test_members_saw_different_recordings_and_the_report_has_each(fitted):
    model, report = fitted
    first, second, _ = model.members
    assert not torch.equal(first.target_mean, second.target_mean)
    assert len(report["members"]) == 3 and report["samples"] == 1500


def test_the_spread_grows_where_there_was_no_data():
    model = make(members=5)
    model.fit([known_heat(seed) for seed in range(4)], seed=1)
    near, far = (model.sequence(gain * torch.ones(1, 40, 6))[0].std[0, -1] for gain in (1.0, 20.0))
    assert far > 10 * near


def test_the_same_seed_gives_the_same_ensemble_and_another_seed_another():
    data = [known_heat(seed, seconds=6.0) for seed in range(3)]
    made = []
    for seed in (0, 0, 1):
        model = make(members=2)
        model.fit(data, seed=seed)
        made.append(model.tensors())
    assert all(torch.equal(made[0][name], made[1][name]) for name in made[0])
    assert not torch.equal(made[0]["members.0.weight"], made[2]["members.0.weight"])


def test_members_are_of_the_objectives_own_model_unless_another_is_named():
    assert {m.name for m in make().members} == {"linear"}
    assert make().settings["member"]["lags"] == 4  # written out, so that a file needs no objective
    assert {m.name for m in make(member="lstm").members} == {"lstm"}


@pytest.mark.parametrize(
    ("default", "settings", "said"),
    [
        (LINEAR, {"member": "linaer"}, "Did you mean 'linear'"),
        (LINEAR, {"member": {"hidden": 3}}, "the model's name"),
        (LINEAR, {"member": {"name": "linear", "lag": 3}}, "Did you mean 'lags'"),
        (LINEAR, {"member": "ensemble"}, "an ensemble of ensembles"),
        (Named(name="ensemble"), {}, "an ensemble of ensembles"),
        (None, {}, "say which model"),
        (LINEAR, {"members": 1}, "members"),
        (LINEAR, {"beta": -1}, "beta"),
    ],
)
def test_an_ensemble_that_cannot_be_is_one_line(default, settings, said):
    with pytest.raises(ConfigError, match=said) as caught:
        make(default, **settings)
    assert "\n" not in str(caught.value)


def test_few_recordings_are_cut_and_nothing_is_lost():
    one = enough_parts([known_heat(1, seconds=10.0)])
    assert [part.num_samples for part in one] == [83, 84, 83, 83, 84, 83]
    many = [known_heat(seed, seconds=1.0) for seed in range(7)]
    assert enough_parts(many) == many


# ------------------------------------------------------------------------------------------------- pessimism


def test_the_reward_is_that_of_the_worse_end_whichever_way_it_points():
    prediction = Prediction(torch.tensor([1.0, -2.0]), torch.tensor([0.5, 0.25]))
    cost = pessimistic_reward(lambda z: -z, prediction, 2.0)
    assert cost.tolist() == [-2.0, 1.5]  # -(1 + 2·0.5), -(-2 + 2·0.25)
    gain = pessimistic_reward(lambda z: z, prediction, 2.0)
    assert gain.tolist() == [0.0, -2.5]


def test_without_doubt_it_is_the_reward_of_the_mean_and_nan_stays_nan():
    mean = torch.tensor([1.0, float("nan")])
    assert pessimistic_reward(torch.neg, Prediction(mean), 2.0)[0] == -1.0
    assert pessimistic_reward(torch.neg, Prediction(mean, torch.ones(2)), 0.0)[0] == -1.0
    assert pessimistic_reward(torch.neg, Prediction(mean, torch.ones(2)), 1.0).isnan().tolist() == [False, True]
