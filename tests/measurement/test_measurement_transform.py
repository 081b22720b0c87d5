"""The measurement model inside an env: what it writes, remembers and forgets."""

import math
from dataclasses import replace

import pytest
import torch
from tensordict import TensorDict
from torchrl.data import Binary, Composite, Unbounded
from torchrl.envs import EnvBase, TransformedEnv
from torchrl.envs.utils import check_env_specs

from hts.channels import Channel
from hts.contracts import Prediction, Signals
from hts.errors import SimulationError
from hts.measurement.lstm import LSTM, LSTMSettings
from hts.measurement.transform import MeasurementTransform, ProxyTransform

SIGNALS = Signals((Channel("effort", "N*m", (3,)), Channel("rate", "rad/s", (3,))), Channel("heat", "W"), 50.0)


class Cool:
    """As much of an objective as the transforms want: reward less of `heat`."""

    name, inputs, target = "cool", ("effort", "rate"), Channel("heat", "W")
    proxy_in_physics_steps = False

    def reward(self, prediction):
        return -prediction

    def proxy(self, channels):
        return (channels["effort"] * channels["rate"]).sum(-1)


class FakeEnv(EnvBase):
    """[P, N] worlds whose effort counts their steps; world (0, 1) is over after 3 steps."""

    def __init__(self, candidates=2, worlds=3):
        super().__init__(batch_size=torch.Size([candidates, worlds]))
        shape = self.batch_size
        channels = Composite(effort=Unbounded((*shape, 3)), rate=Unbounded((*shape, 3)), shape=shape)
        self.observation_spec = Composite(observation=Unbounded((*shape, 1)), channels=channels, shape=shape)
        self.action_spec = Unbounded((*shape, 3))
        self.reward_spec = Unbounded((*shape, 1))
        flag = Binary(1, (*shape, 1), dtype=torch.bool)
        self.done_spec = Composite(done=flag.clone(), terminated=flag.clone(), truncated=flag.clone(), shape=shape)
        self.count = torch.zeros(*shape, 1)

    def _set_seed(self, seed):
        pass

    def _out(self, action):
        flags = {name: torch.zeros_like(self.count, dtype=torch.bool) for name in ("done", "terminated", "truncated")}
        channels = TensorDict({"effort": self.count.expand(-1, -1, 3) + 0.0, "rate": action}, self.batch_size)
        return TensorDict({"observation": self.count + 0.0, "channels": channels, **flags}, self.batch_size)

    def _reset(self, tensordict=None):
        mask = None if tensordict is None else tensordict.get("_reset", None)
        self.count = torch.zeros_like(self.count) if mask is None else self.count * ~mask
        return self._out(torch.zeros(*self.batch_size, 3))

    def _step(self, tensordict):
        self.count = self.count + 1
        out = self._out(tensordict["action"])
        out["reward"] = torch.zeros_like(self.count)
        over = torch.zeros_like(self.count, dtype=torch.bool)
        over[0, 1:2] = self.count[0, 1:2] >= 3
        out["terminated"], out["done"] = over, over.clone()
        return out


def fake_env(model, candidates=2, worlds=3):
    return TransformedEnv(FakeEnv(candidates, worlds), MeasurementTransform.of(Cool(), model))


@pytest.fixture
def model():
    """Unfitted, with statistics of its own."""
    made = LSTM(LSTMSettings(hidden=16), SIGNALS, seed=3)
    data = torch.randn(200, 6, generator=torch.Generator().manual_seed(0))
    made.set_statistics(data, 5.0 + 2.0 * data[:, 0])
    return made


def test_an_env_with_the_model_keeps_its_specs(model):
    check_env_specs(fake_env(model))
    check_env_specs(TransformedEnv(FakeEnv(), ProxyTransform(Cool())))


def test_the_transform_predicts_what_the_model_predicts_and_rewards_less(model):
    env = fake_env(model)
    rollout = env.rollout(3, break_when_any_done=False)
    data = torch.cat((rollout["next", "channels", "effort"], rollout["next", "channels", "rate"]), -1)
    expected, _ = model.sequence(data.flatten(0, 1))
    measured = rollout["next", "measured", "heat"]
    torch.testing.assert_close(measured, expected.mean.view(2, 3, 3, 1), atol=1e-5, rtol=1e-4)
    assert torch.equal(rollout["next", "real_reward", "cool"], -measured)
    assert (rollout["measured", "heat"][:, :, 0] == 0).all()  # nothing measured before the first step


def test_a_world_that_begins_again_forgets_and_the_others_do_not(model):
    env = fake_env(model)
    rollout = env.rollout(6, policy=lambda td: td.set("action", torch.ones(2, 3, 3)), break_when_any_done=False)
    measured = rollout["next", "measured", "heat"][..., 0]
    torch.testing.assert_close(measured[0, 1, 3:], measured[0, 1, :3])
    assert not torch.allclose(measured[0, 0, 3:], measured[0, 0, :3])
    torch.testing.assert_close(measured[0, 0], measured[1, 2])


def test_a_world_beside_others_is_predicted_as_if_alone(model):
    def ones(td):
        return td.set("action", torch.ones(*td.batch_size, 3))

    crowd = fake_env(model, 2, 3).rollout(3, ones)["next", "measured", "heat"]
    alone = fake_env(model, 1, 1).rollout(3, ones)["next", "measured", "heat"]
    torch.testing.assert_close(crowd[1, 2], alone[0, 0])


def test_nan_stays_nan_until_the_world_begins_again(model):
    env = fake_env(model)
    td = env.reset()
    for step in range(4):
        td["action"] = torch.full((2, 3, 3), math.nan if step == 0 else 1.0)
        td, following = env.step_and_maybe_reset(td)
        broken = torch.isnan(td["next", "real_reward", "cool"])
        assert broken.sum() == (6 if step < 3 else 5)  # (0, 1) began again after step 3
        td = following


def test_memory_is_part_of_the_state_and_resumes_exactly(model):
    def ones(td):
        return td.set("action", torch.ones(*td.batch_size, 3))

    env = fake_env(model)
    env.rollout(2, ones)
    saved = {name: value.clone() for name, value in env.state_dict().items()}
    assert sum(value.numel() for value in saved.values()) == 2 * 16 * 6  # the memory alone, not the weights
    other = fake_env(model)
    other.load_state_dict(saved)
    channels = TensorDict({"effort": torch.ones(2, 3, 3), "rate": torch.ones(2, 3, 3)}, [2, 3])
    steps = [
        e.transform._step(TensorDict({}, [2, 3]), TensorDict({"channels": channels}, [2, 3])) for e in (env, other)
    ]
    assert torch.equal(steps[0]["measured", "heat"], steps[1]["measured", "heat"])
    fresh = fake_env(model)
    fresh.load_state_dict(fake_env(model).state_dict())  # nothing measured yet: nothing to load


def test_inputs_outside_the_data_are_counted(model):
    low, high = model.input_low.clone(), model.input_high.clone()
    inputs = torch.stack((low, high, high + 1.0, torch.full_like(low, math.nan)))
    inputs[2, :3] = 0.0
    assert model.outside(inputs).tolist() == [0.0, 0.0, 0.5, 1.0]
    rollout = fake_env(model).rollout(3, break_when_any_done=False)
    assert rollout["next", "outside", "heat"].shape == (2, 3, 3, 1)


def test_the_stand_in_as_reward_is_minus_the_stand_in():
    env = TransformedEnv(FakeEnv(), ProxyTransform(Cool()))
    rollout = env.rollout(2, lambda td: td.set("action", torch.full((2, 3, 3), 2.0)))
    assert rollout["next", "real_reward", "cool"][0, 0, :, 0].tolist() == [-6.0, -12.0]


def test_a_channel_the_env_does_not_write_is_named(model):
    inputs = SIGNALS.inputs[0], Channel("rates", "rad/s", (3,))
    model.signals = replace(SIGNALS, inputs=inputs)
    env = TransformedEnv(FakeEnv(), MeasurementTransform.of(Cool(), model))
    with pytest.raises(SimulationError, match="'rates'. Did you mean 'rate'"):
        _ = env.observation_spec


class Unsure(LSTM):
    """The same mean, and a spread of 0.5 standard deviations that the reward looks at twice."""

    pessimism = 2.0

    def step(self, inputs, state):
        (mean, _), state = super().step(inputs, state)
        return Prediction(mean, torch.full_like(mean, 0.5)), state

    def steps(self, inputs, state, ended):
        (mean, _), state = super().steps(inputs, state, ended)
        return Prediction(mean, torch.full_like(mean, 0.5)), state


def test_doubt_lowers_the_reward_and_leaves_the_prediction(model):
    unsure = Unsure(model.config, SIGNALS)
    unsure.load_tensors(model.tensors())
    rollout = fake_env(unsure).rollout(3, break_when_any_done=False)
    measured = rollout["next", "measured", "heat"]
    torch.testing.assert_close(rollout["next", "real_reward", "cool"], -(measured + 2.0 * 0.5))
    transform = MeasurementTransform.of(Cool(), unsure)
    inputs = torch.cat((rollout["next", "channels", "effort"], rollout["next", "channels", "rate"]), -1)
    kept = inputs.flatten(0, 1).transpose(0, 1).contiguous()
    transform.prepare(kept.shape[1], kept.device)
    found = transform.forward_sequence(kept, torch.zeros(kept.shape[:2], dtype=torch.bool))
    torch.testing.assert_close(
        found["real_reward", "cool"], rollout["next", "real_reward", "cool"].flatten(0, 1).transpose(0, 1)
    )


def test_a_memory_that_an_earlier_version_saved_worlds_last_is_taken_over(model):
    env = fake_env(model)
    env.rollout(2, lambda td: td.set("action", torch.ones(*td.batch_size, 3)))
    (key,) = [name for name in env.state_dict() if name.endswith("memory")]
    now = env.state_dict()[key]
    before = {**env.state_dict(), key: now.movedim(0, -1).contiguous()}
    assert before[key].shape == (1, 2, 16, 6)
    other = fake_env(model)
    other.load_state_dict(before)
    assert torch.equal(other.state_dict()[key], now)
