"""A reward or a channel that does not fit a measurement model is one line, in a script of one's own too."""

from __future__ import annotations

import pytest
import torch

from hts.channels import Channel
from hts.contracts import ModelContext, Signals
from hts.errors import PluginError, SimulationError
from hts.measurement.reward import reward_of
from hts.measurement.transform import MeasurementTransform, ProxyTransform
from hts.plugins import load
from hts.testing.examples.objective.objective import Fake

HEAT = Channel("motor_heat", "W")


def raises(prediction):
    raise KeyError("heat")


BROKEN = {
    "one for all": (lambda z: -z.mean(), r"gave shape \(\) for a prediction of shape \(.*\); expected the same shape"),
    "nothing": (lambda z: None, "gave NoneType for a prediction"),
    "numpy": (lambda z: -z.numpy(), "gave ndarray for a prediction"),
    "whole numbers": (lambda z: (z > 0).int(), "gave numbers of torch.int32, expected torch.float32"),
    "an exception": (raises, "failed, KeyError: 'heat'"),
}


def transform(reward=torch.neg, **sizes: int) -> MeasurementTransform:
    """Of `linear`, unfitted, for channels of so many numbers."""
    inputs = tuple(Channel(name, "1", (size,)) for name, size in (sizes or {"torque": 2, "speed": 1}).items())
    model = load().make_measurement_model("linear", {}, ModelContext(Signals(inputs, HEAT, 20.0)))
    return MeasurementTransform(model, reward, "heat")


def channels(**sizes: int) -> dict[str, torch.Tensor]:
    """Of two candidates in three worlds."""
    return {name: torch.ones(2, 3, size) for name, size in sizes.items()}


@pytest.mark.parametrize("name", BROKEN)
def test_a_broken_reward_is_named_with_its_objective_step_by_step_and_for_a_batch(name):
    reward, said = BROKEN[name]
    made = transform(reward)
    recorded = made.record(channels(torque=2, speed=1))
    made.prepare(6, recorded.device)
    steps = torch.stack((recorded, recorded)), torch.zeros(2, 6, dtype=torch.bool)
    for ask in (lambda: made.evaluate(recorded), lambda: made.forward_sequence(*steps)):
        with pytest.raises(PluginError, match=said) as caught:
            ask()
        assert str(caught.value).startswith("Objective 'heat': reward()") and "\n" not in str(caught.value)


@pytest.mark.parametrize("name", BROKEN)
def test_and_so_it_is_where_a_stand_in_is_rewarded(name, monkeypatch):
    reward, said = BROKEN[name]
    monkeypatch.setattr(Fake, "reward", lambda self, prediction: reward(prediction))
    with pytest.raises(PluginError, match=said):
        ProxyTransform(Fake()).evaluate(torch.ones(6, 1))


def test_a_sound_reward_is_given_back_whatever_its_numbers():
    given = torch.tensor([1.0, float("nan")])
    assert reward_of("heat", torch.neg, given)[0] == -1.0
    assert reward_of("heat", torch.neg, torch.ones(2, device="meta")).shape == (2,)  # where no number can be looked at


def test_channels_of_other_sizes_do_not_take_each_others_place():
    """Two torques and a speed are as many numbers as a torque and two speeds."""
    with pytest.raises(SimulationError) as caught:
        transform().record(channels(torque=1, speed=2))
    assert str(caught.value) == (
        "Measurement model 'linear' was made for 2 numbers of 'torque' in each world, the env writes 1. Fit it to "
        "recordings of this machine, or write the channel as they have it."
    )


def test_a_channel_of_single_numbers_may_have_a_dimension_for_them_or_none():
    made = transform(torque=1, speed=1)
    with_dimension = made.record(channels(torque=1, speed=1))
    assert torch.equal(made.record({"torque": torch.ones(2, 3), "speed": torch.ones(2, 3, 1)}), with_dimension)


def test_a_channel_that_the_env_does_not_write_is_told_by_whoever_collects():
    with pytest.raises(SimulationError, match=r"^Measurement model 'linear': No channel of the env named 'speed'"):
        transform().record(channels(torque=2))
